"""Facts about this machine: its free memory and cores, and the versions of the packages on which a result depends."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from importlib import metadata
from pathlib import Path

#: Files in which control groups (version 2, then 1) report their limit and use.
GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available_memory() -> int:
    """Bytes that this process may still allocate, within the limits of its control group and of `ulimit -v`."""
    import psutil  # noqa: PLC0415 - 20 ms that starting does not need

    found = [psutil.virtual_memory().available]
    for limit, use in GROUPS:
        with suppress(OSError, ValueError):
            found.append(int(Path(limit).read_text(encoding="ascii")) - int(Path(use).read_text(encoding="ascii")))
    with suppress(AttributeError, OSError):  # only Linux has limits per process here
        process = psutil.Process()
        limit = process.rlimit(psutil.RLIMIT_AS)[0]
        if limit != psutil.RLIM_INFINITY:
            found.append(limit - process.memory_info().vms)
    return max(min(found), 0)


def available_cores() -> int:
    """Number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_words(size: float) -> str:
    """A readable number of bytes, such as `3.4 GB`."""
    for unit in ("kB", "MB", "GB"):
        size /= 1e3
        if size < 999.5:
            return f"{size:.3g} {unit}"
    return f"{size / 1e3:.3g} TB"


def versions() -> dict[str, str]:
    """Versions of JAX, NumPy, Python and this package, and the device of JAX."""
    import jax  # noqa: PLC0415 - 0.5 s that starting does not need

    found = {name: metadata.version(name) for name in ("jax", "jaxlib", "numpy")}
    found["dropper-jax"] = installed_version("dropper-jax") or "not installed"
    return found | {"python": platform.python_version(), "backend": jax.default_backend()}


def installed_version(package: str) -> str | None:
    """The version of a package; None if it is not installed."""
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(package)
    return None
