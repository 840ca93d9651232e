"""Divergence of neighbouring motions: the exact tangent map of the step, and the largest Lyapunov exponent."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.dtypes import float0

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State
from dropper_jax.residual import GRAVITY_SCALE, Stepper
from dropper_jax.stepping.halving import advance_over
from dropper_jax.stepping.observe import consistent_velocity
from dropper_jax.stepping.progress import begin


class Lyapunov(NamedTuple):
    """Divergence of neighbouring motions.

    Attributes:
        exponent: largest Lyapunov exponent over the second half of the run, scalar [1/s].
        growth: logarithm of the size of the perturbation over its first size, after each step (steps,) [-].
        converged: whether every step was solved, scalar.
    """

    exponent: Array
    growth: Array
    converged: Array


@cached_jit(static=("stepper", "steps"))
def lyapunov(model: Model, s: State, stepper: Stepper, dt: float | Array, steps: int) -> Lyapunov:
    """Follow one perturbation through the exact tangent map of the step, scaled back to size one after each.

        w_k = DS(s_k) w_{k-1} / |w_{k-1}|,    growth_k = sum_{i <= k} log |w_i|,    exponent: slope of its second half

    with `|w|^2 = sum (|dr|^2 / L^2 + |dv|^2 / (g L)) `, L the mean link length. The perturbation starts as a velocity
    that keeps the links' lengths: the same call gives the same numbers.

    Args:
        model, s: as for `integrate`; s is the start.
        stepper: from `make_stepper`.
        dt: time step [s].
        steps: number of steps, at least 2.

    Returns:
        `Lyapunov(exponent, growth, converged)`. The exponent of a short run is a mean growth rate, not yet the limit.

    Raises:
        ValueError: fewer than 2 steps, which have no second half.

    Source: Benettin, Galgani, Giorgilli, Strelcyn, Meccanica 15 (1980) 9-20.
    """
    if steps < 2:
        raise ValueError(f"steps: {steps}; allowed: 2 or more")
    dt = jnp.asarray(dt, model.dtype)
    carry = begin(stepper, model, s).state
    dv = unit_perturbation(model, s)
    tangent = jax.jvp(lambda v: begin(stepper, model, replace(s, v=v)).state, (s.v,), (dv,))[1]

    def one(carry: tuple[State, State], _: None) -> tuple[tuple[State, State], tuple[Array, Array]]:
        s, ds = carry

        def advance(s: State) -> tuple[State, Array]:
            taken = advance_over(stepper, model, s, dt)
            return taken.state, taken.failed

        s, ds, failed = jax.jvp(advance, (s,), (ds,), has_aux=True)
        size = perturbation_size(model, ds.r, ds.v)
        return (s, _only_motion(ds, size)), (jnp.log(size), failed)

    _, (logs, bad) = jax.lax.scan(one, (carry, tangent), None, length=steps)
    growth = jnp.cumsum(logs)
    half = steps // 2
    return Lyapunov((growth[-1] - growth[half - 1]) / ((steps - half) * dt), growth, ~jnp.any(bad))


@cached_jit()
def unit_perturbation(model: Model, s: State) -> Array:
    """A random velocity (nodes, 3) [m/s] of size 1, the same at every call, that does not stretch rigid links."""
    v = jax.random.normal(jax.random.key(0), s.v.shape, model.dtype)
    dv = jax.jvp(lambda x: consistent_velocity(model, replace(s, v=x)), (jnp.zeros_like(s.v),), (v,))[1]
    return dv / perturbation_size(model, jnp.zeros_like(dv), dv)


def perturbation_size(model: Model, dr: Array, dv: Array) -> Array:
    """Size |w| [-] of a perturbation, as above."""
    length = jnp.mean(model.line.length)
    square = jnp.sum(dr * dr) / length**2 + jnp.sum(dv * dv) / (GRAVITY_SCALE * length)
    return jnp.sqrt(jnp.maximum(square, jnp.finfo(model.dtype).tiny))


def _only_motion(ds: State, size: Array) -> State:
    """The scaled perturbation, without bookkeeping and time."""

    def scale_leaf(x: Array) -> Array:
        if getattr(x, "dtype", None) == float0:
            return x
        return x / size

    ds = jax.tree.map(scale_leaf, ds)
    return replace(ds, work=jnp.zeros_like(ds.work), t=jnp.zeros_like(ds.t))
