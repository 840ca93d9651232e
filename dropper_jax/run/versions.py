"""Versions of what a result depends on."""

from __future__ import annotations

import platform
from importlib import metadata

import jax


def versions() -> dict[str, str]:
    """Of JAX, NumPy, Python and this package, and what JAX computes on."""
    found = {name: metadata.version(name) for name in ("jax", "jaxlib", "numpy")}
    try:
        found["dropper-jax"] = metadata.version("dropper-jax")
    except metadata.PackageNotFoundError:
        found["dropper-jax"] = "not installed"
    return {**found, "python": platform.python_version(), "backend": jax.default_backend()}
