"""Explicit Runge-Kutta schemes of high order for rigid lines of point masses, with an error estimate.

    k_i = f(t + c_i h, y + h sum_j a_ij k_j),    y1 = P(y + h sum_i b_i k_i),    error = h sum_i e_i k_i

y contains positions, velocities and the work done. f is the motion with reduced index (`moving`). P projects
positions and velocities back onto the lengths of the links (`on_links`); without it these drift and errors
grow. Stable while h b/m stays below `stable`, b/m the rate at which damping would stop a node.

A rigid line of point masses as an ordinary differential equation: tensions from zero acceleration of link lengths.

    M a = F(r, v, t) + G' T,    d . d'' + |d'|^2 = 0 of every link

With u = d/L the tensions follow from one symmetric tridiagonal system with a row per link (index reduction):

    (G M^-1 G') T = u . (difference of F/m over the link, of prescribed points their acceleration) + |d'|^2/L

Lengths and their rates are then invariants of the motion, from which a scheme drifts by its error. `on_links` restores
both, each by the smallest change in the mass metric.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.tridiagonal import cyclic_reduction
from dropper_jax.base.numerics import components, dot
from dropper_jax.model import Kinematics, Model, State, book_works, work_names
from dropper_jax.model.model import MOVING_ENDS
from dropper_jax.residual import Explicit, point_masses_only
from dropper_jax.solvers.condensed import ConstraintMatrix


class Moving(NamedTuple):
    """One instant: accelerations (nodes, 3) [m/s^2], tensions (n,) [N], powers (w,) [W] in the order of
    `work_names`."""

    acceleration: jax.Array
    tension: jax.Array
    power: jax.Array


def moving(model: Model, r: jax.Array, v: jax.Array, t: jax.Array, track: bool) -> Moving:
    """Accelerations and tensions of the line at one instant, and powers (empty unless `track`)."""
    k = model.instant(r, v, t)
    unit, inverse = k.links / model.line.length[:, None], 1.0 / model.node_mass
    loose = model.force(k) * inverse[:, None]
    ends = model.end_acceleration(t) if model.moving else None
    rate = k.link_velocities
    rhs = dot(unit, model.geometry.differences(loose, ends)) + dot(rate, rate) / model.line.length
    tension = _solve_multipliers(unit, inverse, rhs)
    power = _powers(model, k, tension[:, None] * unit) if track and work_names(model) else jnp.zeros(0, r.dtype)
    return Moving(loose + model.tension_force(tension, unit) * inverse[:, None], tension, power)


def on_links(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions after one Newton correction of the lengths, and velocities (nodes, 3) that stretch no link there."""
    ends, length, inverse = model.ends(t), model.line.length, 1.0 / model.node_mass
    unit = model.links(r, ends) / length[:, None]
    gap = 0.5 * length * (dot(unit, unit) - 1.0)
    r = r + model.tension_force(_solve_multipliers(unit, inverse, gap), unit) * inverse[:, None]
    return r, v + _impact_change(model, r, v, t)[0]


def apply_jump(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Velocities (nodes, 3) after prescribed points take their velocities at t, and impulses in the links (n, 3) [N
    s]."""
    change, impulse = _impact_change(model, r, v, t)
    return v + change, impulse


def _impact_change(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    ends, inverse = model.ends(t), 1.0 / model.node_mass
    unit = model.links(r, ends) / model.line.length[:, None]
    impulse = _solve_multipliers(unit, inverse, dot(unit, model.rates(v, ends)))
    return model.tension_force(impulse, unit) * inverse[:, None], impulse[:, None] * unit


def _solve_multipliers(unit: jax.Array, inverse: jax.Array, rhs: jax.Array) -> jax.Array:
    """y of `(G M^-1 G') y = rhs`, the rows of G the vectors `unit` (n, 3); `inverse` are 1/m of the free nodes."""
    return cyclic_reduction(*ConstraintMatrix.of(inverse, components(unit), components(unit)), rhs)


def _powers(model: Model, k: Kinematics, force: jax.Array) -> jax.Array:
    forces = {name: jnp.sum(force * k.v) for name, force in model.working_forces(k).items()}
    return book_works(model, forces, model.end_powers(force, k.ends, k))


class Knot(NamedTuple):
    """An instant at which a step ends: time, y = (positions, velocities, work) and its rate, flat, and tensions (n,)
    [N]."""

    t: jax.Array
    y: jax.Array
    rate: jax.Array
    tension: jax.Array


@dataclass(frozen=True)
class ProjectedRungeKutta(Explicit):
    """A tableau; the last stage, at the end of the step, is the first of the next one."""

    #: Rows of the tableau below the first stage, each (i,), and the weights (s,).
    a: ClassVar[tuple[tuple[float, ...], ...]]
    b: ClassVar[tuple[float, ...]]
    #: Weights of the error estimates, each (s,), or (s + 1,) with the rate at the end of the step.
    errors: ClassVar[tuple[tuple[float, ...], ...]]
    #: Knots for interpolation of a motion: the error of (positions, velocities, accelerations) is of order 6 in the
    #: step for two knots, of order 9 for three.
    knots: ClassVar[int]
    controls_error = True
    #: h b/m above which damping makes the scheme unstable.
    stable: ClassVar[float]
    #: Error of a step in positions [m] and velocities [m/s], unless a run specifies another.
    tolerance: ClassVar[float] = 1e-6

    @property
    def evaluations(self) -> int:
        return len(self.b)

    def refuse(self, model: Model) -> str | None:
        if model.geometry.branched:
            return "it runs single lines only; use energy_momentum, theta_midpoint"
        if model.line.failures is not None:
            return "it has no links that break; use energy_momentum"
        if model.initial_internal_state():
            return "it does not support effects with internal state; use energy_momentum"
        if model.laws:
            return f"effect {model.laws[0].name!r} brings a set-valued law, which is not smooth; use energy_momentum"
        return point_masses_only(model)

    def begin(self, model: Model, s: State) -> State:
        return replace(s, v=apply_jump(model, s.r, s.v, time_just_after(s.t))[0])

    def advance(self, model: Model, s: State, h: jax.Array) -> State:
        """One step of a given length."""
        track = bool(s.work.size)
        return at_knot(s, self.attempt(model, self.start(model, s, track), h, track)[0])

    def start(self, model: Model, s: State, track: bool) -> Knot:
        """The knot at which a run starts, or continues after a jump."""
        return self.knot(model, s.t, _flat(s.r, s.v, s.work), track)

    def knot(self, model: Model, t: jax.Array, y: jax.Array, track: bool) -> Knot:
        """The knot of y at t, with the rate of the motion after t."""
        return Knot(t, y, *_rate(model, time_just_after(t), y, track))

    def attempt(self, model: Model, knot: Knot, h: jax.Array, track: bool) -> tuple[Knot, jax.Array]:
        """The knot one step later, and estimates (k, 2, nodes, 3) of the error of positions and velocities."""
        stages, dtype = len(self.b), knot.y.dtype
        table, errors = np.zeros((stages + 1, stages + 1)), np.zeros((len(self.errors), stages + 1))
        for i, row in enumerate((*self.a, self.b), start=1):
            table[i, : len(row)] = row
        for i, row in enumerate(self.errors):
            errors[i, : len(row)] = row
        # the last time is beyond the end of the step, at which it is cut
        rows, times = jnp.asarray(table, dtype), jnp.asarray([*table.sum(axis=1)[:stages], 2.0], dtype)
        low, high = time_just_after(knot.t), time_just_after(knot.t + h, -1.0)

        def end(y: jax.Array) -> jax.Array:
            r, v, work = split_row(model, y)
            return _flat(*on_links(model, r, v, high), work)

        def stage(i: jax.Array, carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            slopes = carry[0]
            y = knot.y + h * _combine_slopes(jax.lax.dynamic_index_in_dim(rows, i, keepdims=False), slopes)
            y = jax.lax.cond(i == stages, end, lambda y: y, y)
            # a jump at the start of the step has already happened, one at its end happens after it
            rate, tension = _rate(model, jnp.clip(knot.t + times[i] * h, low, high), y, track)
            return jax.lax.dynamic_update_index_in_dim(slopes, rate, i, axis=0), y, tension

        # A loop, not twelve successive stages: XLA would fuse each stage into all that use it and recompute it for
        # every one (1.8 times as slow, and 20 s to compile). The last round is the end of the step.
        rest = jnp.zeros((stages, *knot.y.shape), dtype)
        first = jnp.concatenate([knot.rate[None], rest]), knot.y, knot.tension
        slopes, y, tension = jax.lax.fori_loop(1, stages + 1, stage, first)
        size = 6 * model.free_nodes
        known = jax.lax.stop_gradient(slopes[:, :size])
        guesses = [h * _combine_slopes(jnp.asarray(e, dtype), known).reshape(2, -1, 3) for e in errors]
        return Knot(knot.t + h, y, slopes[stages], tension), jnp.stack(guesses)

    def estimate(self, errors: jax.Array, v: jax.Array, tolerance: jax.Array) -> jax.Array:
        """Error of a step divided by the allowed error.

        RMS of positions over `tolerance` [m] and of velocities over the same [m/s], relative to speeds above 1 m/s. For
        two estimates `E5^2/(E5^2 + 0.01 E3^2)^(1/2)`.
        """
        size = tolerance * jnp.stack([jnp.ones_like(v), 1.0 + jnp.abs(v)])
        squares = jnp.mean(jnp.square(errors / size), axis=(1, 2, 3))
        if len(squares) == 1:
            return jnp.sqrt(squares[0])
        return squares[0] / jnp.sqrt(squares[0] + 0.01 * squares[1] + jnp.finfo(v.dtype).tiny)

    def after_jump(self, model: Model, knot: Knot, track: bool) -> Knot:
        """The same instant after its jumps; the impulse of prescribed points is recorded."""
        r, v, work = split_row(model, knot.y)
        if model.moving:
            v, impulse = apply_jump(model, r, v, time_just_after(knot.t))
            before, after = (model.ends(time_just_after(knot.t, side)) for side in (-1.0, 1.0))
            mean = before._replace(velocities=0.5 * (before.velocities + after.velocities))
            if track:
                work = work + book_works(model, {MOVING_ENDS: model.end_powers(impulse, mean)[MOVING_ENDS]})
        return self.knot(model, knot.t, _flat(r, v, work), track)


def time_just_after(t: jax.Array, side: float = 1.0) -> jax.Array:
    """An instant just after t (before it with side -1): a quantity that jumps at t has its value on that side."""
    return t + 8.0 * side * jnp.finfo(t.dtype).eps * jnp.maximum(jnp.abs(t), 1.0)


def at_knot(s: State, knot: Knot) -> State:
    """The state at a knot; `s` is any state of the run."""
    size = s.r.size
    r, v, work = jnp.split(knot.y, (size, 2 * size))
    a = knot.rate[size : 2 * size].reshape(s.r.shape)
    r, v = r.reshape(s.r.shape), v.reshape(s.r.shape)
    return replace(s, r=r, v=v, t=knot.t, tension=knot.tension, acceleration=a, work=work, angles=None)


def _rate(model: Model, t: jax.Array, y: jax.Array, track: bool) -> tuple[jax.Array, jax.Array]:
    r, v, _ = split_row(model, y)
    now = moving(model, r, v, t, track)
    return _flat(v, now.acceleration, now.power), now.tension


def _flat(*parts: jax.Array) -> jax.Array:
    return jnp.concatenate([part.ravel() for part in parts])


def split_row(model: Model, y: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Positions and velocities (..., nodes, 3), and work (..., w), of y."""
    nodes = model.free_nodes
    r, v, work = jnp.split(y, (3 * nodes, 6 * nodes), axis=-1)
    return r.reshape(*y.shape[:-1], nodes, 3), v.reshape(*y.shape[:-1], nodes, 3), work


def _combine_slopes(weights: jax.Array, slopes: jax.Array) -> jax.Array:
    """The weighted sum of slopes (s, k) with weights (s,), not as a matrix product, which may call a library."""
    return jnp.sum(weights[:, None] * slopes, axis=0)


def state_between(model: Model, knots: tuple[Knot, ...], known: jax.Array, t: jax.Array) -> jax.Array:
    """y at a time t between the last two knots."""
    size = 3 * model.free_nodes
    unit = knots[-1].t - knots[-2].t
    times = jnp.stack([(knot.t - knots[-1].t) / unit for knot in knots])
    x = (t - knots[-1].t) / unit
    (position, speed), (work, _) = (_weights(times, x, known, n) for n in (3, 2))
    y, rate = jnp.stack([k.y for k in knots]), jnp.stack([k.rate for k in knots])
    r, v, a = y[:, :size], rate[:, :size], rate[:, size : 2 * size]
    scaled = jnp.concatenate([r, unit * v, unit**2 * a])
    w, p = y[:, 2 * size :], rate[:, 2 * size :]
    # sums, not matrix products: a library call would prevent one kernel
    found = [
        _combine_slopes(position, scaled),
        _combine_slopes(speed, scaled) / unit,
        _combine_slopes(work, jnp.concatenate([w, unit * p])),
    ]
    return jnp.concatenate(found)


def _weights(times: jax.Array, x: jax.Array, known: jax.Array, derivatives: int) -> tuple[jax.Array, jax.Array]:
    """Weights at x of values and derivatives at `times` (m,) in a polynomial through them, and their rates.

    Ordered by derivative, (derivatives m,). With fewer than m - 1 known steps, through the last two times.
    """
    two = jnp.concatenate([jnp.zeros(len(times) - 2), jnp.ones(2)]).astype(times.dtype)
    all_ = jnp.ones_like(two)

    def at(x: jax.Array) -> jax.Array:
        pair = _hermite(times, x, two, derivatives)
        if len(times) == 2:
            return pair
        return jnp.where(known >= len(times) - 1, _hermite(times, x, all_, derivatives), pair)

    return jax.jvp(at, (x,), (jnp.ones_like(x),))


def _hermite(times: jax.Array, x: jax.Array, used: jax.Array, derivatives: int) -> jax.Array:
    """Hermite's basis at x: with Lagrange's L_i, L_i^n times the series of L_i^-n in x - t_i, for n derivatives.

    `used` (m,) is 0 for times that are left out.
    """
    u = x - times
    apart = times[:, None] - times[None, :]
    others = used[None, :] * (1.0 - jnp.eye(len(times), dtype=times.dtype))
    inverse = others / jnp.where(apart == 0.0, 1.0, apart)
    lagrange = used * jnp.prod(jnp.where(others > 0.0, u[None, :] * inverse, 1.0), axis=1)
    slope = jnp.sum(inverse, axis=1)
    if derivatives == 2:
        return jnp.concatenate([lagrange**2 * (1.0 - 2.0 * slope * u), lagrange**2 * u])
    cube, bend = lagrange**3, slope**2 - jnp.sum(inverse**2, axis=1)
    value = 1.0 - 3.0 * slope * u + (6.0 * slope**2 - 1.5 * bend) * u**2
    return jnp.concatenate([cube * value, cube * u * (1.0 - 3.0 * slope * u), 0.5 * cube * u**2])
