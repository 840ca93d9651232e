"""A run as one kernel on the CPU: the option of XLA's compiler that makes it, and whether it is in force.

XLA launches the fused operations of a step one by one, some 50 of them, which takes longer than they do. A loop below a
limit of bytes becomes one function instead, where nothing inside it calls a library (LAPACK), scatters or sorts. JAX
0.12 has a limit that runs of about 100 links keep; before, it is next to nothing. The option lifts it.

It is read once, when the first array is made, and holds for the whole process: so the command line sets it, and a
program that uses the library calls `one_kernel` if it wants it. On other devices it changes nothing.
"""

from __future__ import annotations

import os
import sys

LIMIT = "xla_cpu_small_while_loop_byte_threshold"
FLAG = "--xla_backend_extra_options"
BYTES = 1_000_000_000_000
OPTION = f"{LIMIT}={BYTES}"


def one_kernel() -> bool:
    """Have the runs of this process compiled to one CPU kernel each, where they can be: two to five times faster.

    Sets `XLA_FLAGS` for this process and those it starts; to be called before the first array is made.

    Returns:
        Whether runs are compiled so from here on: False where JAX has begun already.
    """
    if in_force():
        return True
    if _devices_started():
        return False
    os.environ["XLA_FLAGS"] = with_option(os.environ.get("XLA_FLAGS", ""))
    return True


def with_option(flags: str) -> str:
    """XLA's flags with the option, first: what comes after a word without dashes is not read."""
    words = flags.split()
    for i, word in enumerate(words):
        if word.startswith(f"{FLAG}="):
            return " ".join([f"{word},{OPTION}", *words[:i], *words[i + 1 :]])
    return " ".join([f"{FLAG}={OPTION}", *words])


def in_force() -> bool:
    """Whether the option stands where XLA reads it."""
    for word in os.environ.get("XLA_FLAGS", "").split():
        if not word.startswith("--"):
            return False
        if word.startswith(f"{FLAG}="):
            return OPTION in word.removeprefix(f"{FLAG}=").split(",")
    return False


def _devices_started() -> bool:
    """Whether JAX has started its devices, after which options are not read any more."""
    bridge = sys.modules.get("jax._src.xla_bridge")
    is_started = getattr(bridge, "backends_are_initialized", None)
    return bool(is_started()) if is_started else False
