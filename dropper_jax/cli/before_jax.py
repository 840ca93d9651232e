"""What the command line asks of JAX, which reads it when it starts: so before it is imported."""

from __future__ import annotations

import gc
import os

from dropper_jax.base.one_kernel import one_kernel

#: `off` in one of these disables it; the second else names the folder, the user's own if `on`.
ONE_KERNEL, COMPILE_CACHE, KEEP_TRACES = "DROPPER_ONE_KERNEL", "DROPPER_COMPILE_CACHE", "DROPPER_KEEP_TRACES"
OFF, ON = "off", "on"
#: XLA's own messages, such as "Very slow compile? ... file a bug", are for its developers: only fatal ones are shown.
XLA_LOG, FATAL = "TF_CPP_MIN_LOG_LEVEL", "3"
#: Objects made between two searches for circles of them: tracing makes millions that live on, and Python (700) takes a
#: tenth of its time to look through them.
SELDOM = 100_000, 50, 100


def prepare() -> None:
    """Runs as one kernel each, and compiled programs kept for the next start, unless the user says otherwise."""
    gc.set_threshold(*SELDOM)
    os.environ.setdefault(XLA_LOG, FATAL)
    if os.environ.get(ONE_KERNEL) != OFF:
        one_kernel()
    os.environ.setdefault(COMPILE_CACHE, ON)
    os.environ.setdefault(KEEP_TRACES, ON)
