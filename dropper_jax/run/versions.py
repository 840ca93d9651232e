"""Versions of the packages on which a result depends."""

from __future__ import annotations

import platform
from importlib import metadata

import jax


def versions() -> dict[str, str]:
    """Versions of JAX, NumPy, Python and this package, and the device of JAX."""
    found = {name: metadata.version(name) for name in ("jax", "jaxlib", "numpy")}
    try:
        found["dropper-jax"] = metadata.version("dropper-jax")
    except metadata.PackageNotFoundError:
        found["dropper-jax"] = "not installed"
    return {**found, "python": platform.python_version(), "backend": jax.default_backend()}
