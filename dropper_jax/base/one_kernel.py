"""A run as one kernel on the CPU: the XLA compiler option for it, and whether it is in force.

XLA launches the fused operations of a step, some 50 of them, one by one. The launches take longer than the operations.
A loop below a size limit in bytes becomes a single function instead, if nothing inside it calls a library (LAPACK),
scatters or sorts. In JAX 0.12 runs of up to about 100 links are below that limit; in earlier versions the limit is
almost zero. The option removes the limit.

The option is read once, when the first array is created, and holds for the whole process. The command line therefore
sets it, and a program that uses the library calls `one_kernel` if required. On other devices it has no effect.
"""

from __future__ import annotations

import os
import sys

LIMIT = "xla_cpu_small_while_loop_byte_threshold"
FLAG = "--xla_backend_extra_options"
BYTES = 1_000_000_000_000
OPTION = f"{LIMIT}={BYTES}"


def one_kernel() -> bool:
    """Compile the runs of this process to one CPU kernel each where possible: two to five times faster.

    Sets `XLA_FLAGS` for this process and its child processes. Call it before the first array is created.

    Returns:
        Whether runs are compiled this way from now on: False if JAX has already started.
    """
    if in_force():
        return True
    if _devices_started():
        return False
    os.environ["XLA_FLAGS"] = with_option(os.environ.get("XLA_FLAGS", ""))
    return True


def with_option(flags: str) -> str:
    """XLA's flags with the option first, because flags after a word without dashes are not read."""
    words = flags.split()
    for i, word in enumerate(words):
        if word.startswith(f"{FLAG}="):
            return " ".join([f"{word},{OPTION}", *words[:i], *words[i + 1 :]])
    return " ".join([f"{FLAG}={OPTION}", *words])


def in_force() -> bool:
    """Whether the option is at a position where XLA reads it."""
    for word in os.environ.get("XLA_FLAGS", "").split():
        if not word.startswith("--"):
            return False
        if word.startswith(f"{FLAG}="):
            return OPTION in word.removeprefix(f"{FLAG}=").split(",")
    return False


def _devices_started() -> bool:
    """Whether JAX has started its devices, after which it ignores new options."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    is_started = getattr(bridge, "backends_are_initialized", None)
    return bool(is_started()) if is_started else False
