"""Settings of JAX for the command line. JAX reads them when it is imported, so they are set before."""

from __future__ import annotations

import gc
import os

#: `off` in one of these disables it; other values of the first are the folder, `on` is that of the user.
COMPILE_CACHE, KEEP_TRACES, QUICK, ON = (
    "DROPPER_COMPILE_CACHE",
    "DROPPER_KEEP_TRACES",
    "DROPPER_QUICK_COMPILATION",
    "on",
)
#: XLA's own messages, such as "Very slow compile? ... file a bug", are for its developers: only fatal ones are shown.
XLA_LOG, FATAL = "TF_CPP_MIN_LOG_LEVEL", "3"
#: Allocations between two garbage collections: tracing makes millions of lasting objects, and with Python's default
#: (700)
#: the collector takes 10 % of the time.
SELDOM = 100_000, 50, 100


def prepare() -> None:
    """Cache programs for the next start, and compile short runs quickly, unless the user disables it."""
    gc.set_threshold(*SELDOM)
    os.environ.setdefault(XLA_LOG, FATAL)
    os.environ.setdefault(COMPILE_CACHE, ON)
    os.environ.setdefault(KEEP_TRACES, ON)
    os.environ.setdefault(QUICK, ON)
