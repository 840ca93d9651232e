"""The pose next to a pose, as a function with derivatives by the implicit function theorem.

    F(theta, r) = 0,    dr = K^-1 F_theta dtheta,    K = -F_r        (theta: model and loads)

Of bodies and of lines that stretch. Newton with the exact K, shortened where a correction overshoots, in a compiled
loop; derivatives from one linear solve
at its end, forward and reverse (see `statics.tangent`). O(n): for farms of thousands of nodes.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.model import Model, State
from dropper_jax.statics.bodies import BodyMoves
from dropper_jax.statics.rest_problem import force_scale
from dropper_jax.statics.system import TOLERANCE, corrected, moves_of, rounding
from dropper_jax.statics.tangent import Linear, NodeMoves, solve_linear

#: Corrections until a pose counts as not found, and such as are always done: the last of them ends at rounding.
CORRECTIONS, ALWAYS = 100, 2


def settled(model: Model, near: State, loads: jax.Array, there: bool = False) -> State:
    """The pose next to `near`, differentiable; its places are NaN where there is none.

    With `there` it is `near` itself, which is not looked at again: only its derivatives are new.
    """
    near = jax.lax.stop_gradient(near)
    moves, held = moves_of(model), moves_of(jax.lax.stop_gradient(model))
    limit = jnp.maximum(TOLERANCE, rounding(held.model)) * force_scale(held.model)

    def find(rows: Linear, x: jax.Array) -> jax.Array:
        return x if there else _newton(held, rows, x, limit)

    x = jax.lax.custom_root(partial(moves.rows, near, loads), moves.none, find, partial(solve_linear, moves.tangent))
    return moves.moved(near, loads, x)


def _newton(moves: NodeMoves | BodyMoves, rows_of: Linear, x: jax.Array, limit: jax.Array) -> jax.Array:
    def unfinished(carry: tuple[Any, ...]) -> jax.Array:
        _, size, _, count = carry
        # a NaN compares false: iterating cannot mend it
        return ((size > limit) & (count < CORRECTIONS)) | (count < ALWAYS)

    def correct(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        x, _, kappa, count = carry
        return *corrected(moves, rows_of, x, kappa), count + 1

    start = x, jnp.full((), jnp.inf, x.dtype), moves.tangent.kappa, jnp.zeros((), jnp.int32)
    x, size, _, _ = jax.lax.while_loop(unfinished, correct, start)
    return jnp.where(size <= limit, x, jnp.nan)
