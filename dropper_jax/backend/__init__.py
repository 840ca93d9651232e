"""What depends on the inside of JAX and XLA, each behind a function with a plain fallback.

`DROPPER_BACKEND=plain` runs everything by the fallbacks: `jax.jit` with the compiler's own options, without programs on
disk.
"""

import os

#: Environment variable, and its value for the fallbacks.
VARIABLE = "DROPPER_BACKEND"
PLAIN = "plain"
#: Whether this process stores its compiled programs in the user's folder; to be set before `backend.programs` is
#: imported, which imports JAX.
stores_programs = False


def is_plain() -> bool:
    """Whether only the fallbacks are used."""
    return os.environ.get(VARIABLE) == PLAIN
