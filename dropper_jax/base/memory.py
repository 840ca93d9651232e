"""Free memory of this machine, for checks before a run whose memory needs are known."""

from __future__ import annotations

from contextlib import suppress
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


def in_words(size: float) -> str:
    """A readable number of bytes, such as `3.4 GB`."""
    for unit, power in (("kB", 1e3), ("MB", 1e6), ("GB", 1e9), ("TB", 1e12)):
        if size < 999.5 * power:
            return f"{size / power:.3g} {unit}"
    return f"{size / 1e12:.3g} TB"
