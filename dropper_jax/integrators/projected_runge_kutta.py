"""Explicit Runge-Kutta schemes of high order for rigid lines of point masses, with an error estimate.

    k_i = f(t + c_i h, y + h sum_j a_ij k_j),    y1 = P(y + h sum_i b_i k_i),    error = h sum_i e_i k_i

y contains positions, velocities and the work done. Stable while h b/m stays below `stable`, b/m the rate at which
damping stops a node. f is the motion of the line as an ordinary differential equation (`solve_motion`): its tensions
are those of lengths that do not accelerate,

    M a = F(r, v, t) + G' T,    d . d'' + |d'|^2 = 0 of every link

With u = d/L they follow from one symmetric tridiagonal system with a row per link (index reduction):

    (G M^-1 G') T = u . (difference of F/m over the link, of prescribed points their acceleration) + |d'|^2/L

Lengths and their rates are then invariants of the motion, from which a scheme drifts by its error. The projection P
(`project_on_links`) restores both, each by the smallest change in the mass metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree

from dropper_jax.base.numerics import dot, time_just_after
from dropper_jax.integrators.runge_kutta import powers
from dropper_jax.model import MOVING_ENDS, Model, State, book_works, end_powers
from dropper_jax.residual import Embedded, point_masses_only
from dropper_jax.solvers.condensed import solve_multipliers


class Instant(NamedTuple):
    """One instant: accelerations (nodes, 3) [m/s^2], tensions (n,) [N], powers (w,) [W] in the order of
    `work_names`."""

    acceleration: Array
    tension: Array
    power: Array


def solve_motion(model: Model, r: Array, v: Array, t: Array, track: bool) -> Instant:
    """Accelerations and tensions of the line at one instant, and powers (empty unless `track`)."""
    k = model.instant(r, v, t)
    unit = k.links / model.line.length[:, None]
    inverse = 1.0 / model.node_mass
    loose = model.force(k) * inverse[:, None]
    rate = k.link_velocities
    rhs = dot(unit, model.geometry.differences(loose, model.end_acceleration(t))) + dot(rate, rate) / model.line.length
    tension = solve_multipliers(unit, inverse, rhs)
    a = loose + model.tension_force(tension, unit) * inverse[:, None]
    if track:
        power = powers(model, k, tension, a)
    else:
        power = jnp.zeros(0, r.dtype)
    return Instant(a, tension, power)


def project_on_links(model: Model, r: Array, v: Array, t: Array) -> tuple[Array, Array]:
    """Positions after one Newton correction of the lengths, and velocities (nodes, 3) that stretch no link there."""
    length = model.line.length
    inverse = 1.0 / model.node_mass
    unit = model.links(r, model.ends(t)) / length[:, None]
    gap = 0.5 * length * (dot(unit, unit) - 1.0)
    r = r + model.tension_force(solve_multipliers(unit, inverse, gap), unit) * inverse[:, None]
    return r, apply_jump(model, r, v, t)[0]


def apply_jump(model: Model, r: Array, v: Array, t: Array) -> tuple[Array, Array]:
    """Velocities (nodes, 3) after prescribed points take their velocities at t, and impulses in the links (n, 3) [N
    s]."""
    ends = model.ends(t)
    inverse = 1.0 / model.node_mass
    unit = model.links(r, ends) / model.line.length[:, None]
    impulse = solve_multipliers(unit, inverse, dot(unit, model.link_rates(v, ends)))
    return v + model.tension_force(impulse, unit) * inverse[:, None], impulse[:, None] * unit


@dataclass(frozen=True)
class ProjectedRungeKutta(Embedded):
    """A tableau; the last stage is at the end of the step."""

    #: Rows of the tableau below the first stage, each (i,), and the weights (s,).
    a: ClassVar[tuple[tuple[float, ...], ...]]
    b: ClassVar[tuple[float, ...]]
    #: Weights of the error estimates, each (s,), or (s + 1,) with the rate at the end of the step.
    errors: ClassVar[tuple[tuple[float, ...], ...]]

    @property
    def evaluations(self) -> int:
        return len(self.b) + 1

    def refuse(self, model: Model) -> str | None:
        if not model.geometry.is_path:
            return "it runs single lines only; use energy_momentum, theta_midpoint"
        if model.line.failures is not None:
            return "it has no links that break; use energy_momentum"
        if model.initial_internal_state():
            return "it does not support effects with internal state; use energy_momentum"
        if model.laws:
            return f"effect {model.laws[0].name!r} brings a set-valued law, which is not smooth; use energy_momentum"
        return point_masses_only(model)

    def begin(self, model: Model, s: State) -> State:
        t = time_just_after(s.t)
        v = apply_jump(model, s.r, s.v, t)[0]
        now = solve_motion(model, s.r, v, t, False)
        return replace(s, v=v, acceleration=now.acceleration, tension=now.tension)

    def advance_with_error(self, model: Model, s: State, h: Array, tolerance: Array) -> tuple[State, Array]:
        track = bool(s.work.size)
        if model.has_moving_ends:
            s = _after_jump(model, s, track)
        stages = len(self.b)
        table = _fill_rows([(), *self.a, self.b], stages + 1)
        dtype = s.r.dtype
        rows = jnp.asarray(table, dtype)
        # the last time is beyond the end of the step, at which it is cut
        times = jnp.asarray([*table.sum(axis=1)[:stages], 2.0], dtype)
        low = time_just_after(s.t)
        high = time_just_after(s.t + h, -1.0)
        start, split = ravel_pytree((s.r, s.v, s.work))

        def end(y: Array) -> Array:
            r, v, work = split(y)
            return ravel_pytree((*project_on_links(model, r, v, high), work))[0]

        def stage(i: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
            slopes = carry[0]
            y = start + h * _combine_slopes(jax.lax.dynamic_index_in_dim(rows, i, keepdims=False), slopes)
            y = jax.lax.cond(i == stages, end, lambda y: y, y)
            # a jump at the start of the step has already happened, one at its end happens after it
            r, v, _ = split(y)
            now = solve_motion(model, r, v, jnp.clip(s.t + times[i] * h, low, high), track)
            rate, _ = ravel_pytree((v, now.acceleration, now.power))
            return jax.lax.dynamic_update_index_in_dim(slopes, rate, i, axis=0), y, now.tension

        # A loop, not twelve successive stages: XLA would fuse each stage into all that use it and recompute it for
        # every one (1.8 times as slow, and 20 s to compile). The last round is the end of the step.
        empty = jnp.zeros((stages + 1, *start.shape), dtype), start, s.tension
        slopes, y, tension = jax.lax.fori_loop(0, stages + 1, stage, empty)
        r, v, work = split(y)
        _, acceleration, _ = split(slopes[stages])
        s1 = replace(s, r=r, v=v, t=s.t + h, tension=tension, acceleration=acceleration, work=work, angles=None)
        return s1, self._relative_error(slopes[:, : 2 * r.size], s.v, h, tolerance)

    def _relative_error(self, slopes: Array, v: Array, h: Array, tolerance: Array) -> Array:
        """Error of a step h [s] divided by the allowed error; without derivatives.

        RMS of positions over `tolerance` [m] and of velocities over the same [m/s], relative to speeds above 1 m/s. For
        two estimates `E5^2/(E5^2 + 0.01 E3^2)^(1/2)`.

        Args:
            slopes: rates of positions and velocities (s + 1, 6 nodes) of the stages.
            v: velocities (nodes, 3) [m/s] at the start.
        """
        known, v = jax.lax.stop_gradient((slopes, v))
        weights = jnp.asarray(_fill_rows(self.errors, len(slopes)), v.dtype)
        errors = jnp.stack([h * _combine_slopes(own, known).reshape(2, -1, 3) for own in weights])
        size = tolerance * jnp.stack([jnp.ones_like(v), 1.0 + jnp.abs(v)])
        squares = jnp.mean(jnp.square(errors / size), axis=(1, 2, 3))
        if len(squares) == 1:
            return jnp.sqrt(squares[0])
        return squares[0] / jnp.sqrt(squares[0] + 0.01 * squares[1] + jnp.finfo(v.dtype).tiny)


def _fill_rows(rows: Sequence[Sequence[float]], size: int) -> np.ndarray:
    """Rows of unequal length with zeros at their ends (rows, size)."""
    return np.array([np.pad(row, (0, size - len(row))) for row in rows])


def _after_jump(model: Model, s: State, track: bool) -> State:
    """The state after prescribed points took their velocities at its time; their impulse is recorded."""
    v, impulse = apply_jump(model, s.r, s.v, time_just_after(s.t))
    before = model.ends(time_just_after(s.t, -1.0))
    after = model.ends(time_just_after(s.t))
    if not track or before.velocities is None or after.velocities is None:
        return replace(s, v=v)
    mean = before._replace(velocities=0.5 * (before.velocities + after.velocities))
    work = s.work + book_works(model, {MOVING_ENDS: end_powers(model, impulse, mean)[MOVING_ENDS]})
    return replace(s, v=v, work=work)


def _combine_slopes(weights: Array, slopes: Array) -> Array:
    """The weighted sum (k,) of slopes (s, k) with weights (s,), not as a matrix product, which may call a library."""
    return jnp.sum(weights[:, None] * slopes, axis=0)
