"""The pose next to a pose, of lines that stretch, as a function with derivatives by the implicit function theorem.

    F(theta, r) = 0,    dr = K^-1 F_theta dtheta,    K = -F_r        (theta: model and loads)

Newton with the exact K, shortened where a correction overshoots, in a compiled loop; derivatives from one linear solve
at its end, forward and reverse (see `statics.tangent`). O(n): for farms of thousands of nodes.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.model import Model, State, state
from dropper_jax.solvers.elimination import solve
from dropper_jax.statics.rest_problem import SMALLEST, force_scale, soft_scale, unbalanced_at
from dropper_jax.statics.system import FALL, KEEP, OVERSHOOT, REACH, RISE, TOLERANCE, rounding
from dropper_jax.statics.tangent import Linear, Tangent

#: Corrections until a pose counts as not found, and such as are always done: the last of them ends at rounding.
CORRECTIONS, ALWAYS = 100, 2
#: Least share of a correction that is tried.
LEAST_SHARE = 2.0**-13
#: Kappa, over the weight of a link per its length, from which it rises where a correction was cut short.
FIRST = 1e-2


def settled(model: Model, near: State, loads: jax.Array, there: bool = False) -> State:
    """The pose next to `near`, differentiable; its places are NaN where there is none.

    With `there` it is `near` itself, which is not looked at again: only its derivatives are new.
    """
    near = jax.lax.stop_gradient(near)
    tangent = Tangent.of(model)
    held = jax.lax.stop_gradient(model)
    limit = jnp.maximum(TOLERANCE, rounding(held)) * force_scale(held)
    reach = REACH * jnp.mean(held.line.length)
    soft = soft_scale(held)

    def find(rows: Linear, x: jax.Array) -> jax.Array:
        return x if there else _newton(tangent, rows, x, limit, reach, soft)

    rows = lambda x: unbalanced_at(model, near, loads, x)[0]  # noqa: E731
    x = jax.lax.custom_root(rows, jnp.zeros_like(near.r), find, tangent.solve)
    return state(model, near.r + x, tension=unbalanced_at(model, near, loads, x)[1], t=near.t)


def _newton(
    tangent: Tangent, rows_of: Linear, x: jax.Array, limit: jax.Array, reach: jax.Array, soft: jax.Array
) -> jax.Array:
    floor = SMALLEST * soft

    def unfinished(carry: tuple[Any, ...]) -> jax.Array:
        _, size, _, count = carry
        # a NaN compares false: iterating cannot mend it
        return ((size > limit) & (count < CORRECTIONS)) | (count < ALWAYS)

    def correct(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        x, _, kappa, count = carry
        rows, linear = jax.linearize(rows_of, x)
        dx = -solve(tangent.factor(linear, kappa, x.dtype), rows)
        dx = dx * jnp.minimum(1.0, reach / jnp.maximum(jnp.max(jnp.sqrt(jnp.sum(dx * dx, axis=1))), 1e-300))
        allowed = OVERSHOOT * jnp.sum(rows * dx)

        def overshoots(trial: tuple[jax.Array, ...]) -> jax.Array:
            share, along, _ = trial
            return ~(along >= allowed) & (share > LEAST_SHARE)

        def shorter(trial: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            share = 0.5 * trial[0]
            after = rows_of(x + share * dx)
            return share, -jnp.sum(after * dx), jnp.max(jnp.abs(after))

        # the whole correction is the first that is tried: the rows stand in the program once
        never = jnp.full((), -jnp.inf, x.dtype)
        share, _, size = jax.lax.while_loop(overshoots, shorter, (jnp.full((), 2.0, x.dtype), never, -never))
        harder = jnp.maximum(RISE * kappa, FIRST * soft)
        kappa = jnp.where(share == 1.0, FALL * kappa, jnp.where(share >= 0.25, KEEP * kappa, harder))
        return x + share * dx, size, jnp.maximum(kappa, floor), count + 1

    start = x, jnp.full((), jnp.inf, x.dtype), floor, jnp.zeros((), jnp.int32)
    x, size, _, _ = jax.lax.while_loop(unfinished, correct, start)
    return jnp.where(size <= limit, x, jnp.nan)
