"""PI control of the step length (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2).

The next step follows from the errors e of this step and e0 of the last accepted one, relative to what is allowed, for
errors of order q in the step:

    h' = 0.9 e^(-0.7/q) e0^(0.4/q) h  after an accepted step,    0.9 e^(-1/q) h  after a rejected step
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

#: Fraction of the predicted length that is taken, and exponents of both errors times the order.
SAFETY = 0.9
NOW = 0.7
BEFORE = 0.4


def step_ratio(error: jax.Array, before: jax.Array, order: int, accepted: jax.Array) -> jax.Array:
    """Length of the next step over that of this one, not bounded.

    Args:
        error, before: relative errors of this step and of the last accepted one, positive.
        order: of the errors in the length of a step.
        accepted: whether this step is.
    """
    onward = error ** (-NOW / order) * before ** (BEFORE / order)
    again = error ** (-1.0 / order)
    return SAFETY * jnp.where(accepted, onward, again)
