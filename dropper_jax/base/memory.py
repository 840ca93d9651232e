"""Memory of this machine: how much is left, for what is known to need some before it begins."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

#: What memory groups say of themselves (version 2, then 1): limit and use.
GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available_memory() -> int | None:
    """Bytes that this process may still take, the limits of its group included; None where the system does not tell."""
    found = []
    with suppress(OSError, ValueError, IndexError):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        found.append(1024 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable")))
    for limit, use in GROUPS:
        with suppress(OSError, ValueError):
            found.append(int(Path(limit).read_text(encoding="ascii")) - int(Path(use).read_text(encoding="ascii")))
    with suppress(ImportError, OSError, ValueError):
        found += _own_limits()
    if not found:
        with suppress(OSError, ValueError, AttributeError):
            found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(min(found), 0) if found else None


def _own_limits() -> list[int]:
    """What `ulimit -v` leaves."""
    import resource  # noqa: PLC0415 - not on Windows

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return []
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    return [limit - pages * os.sysconf("SC_PAGE_SIZE")]


def in_words(size: float) -> str:
    """A number of bytes for people, such as `3.4 GB`."""
    for unit, power in (("kB", 1e3), ("MB", 1e6), ("GB", 1e9), ("TB", 1e12)):
        if size < 999.5 * power:
            return f"{size / power:.3g} {unit}"
    return f"{size / 1e12:.3g} TB"
