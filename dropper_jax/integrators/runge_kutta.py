"""Explicit Runge-Kutta schemes, each a tableau, for lines that stretch, and the rates of change at one instant."""

from __future__ import annotations

import itertools
import operator
from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.numerics import local_jacobian
from dropper_jax.model import (
    AddedMass,
    Kinematics,
    Model,
    State,
    Works,
    book_works,
    end_powers,
    non_conservative_forces,
    turning_work_name,
)
from dropper_jax.residual import Explicit
from dropper_jax.solvers.elimination import apply, inverse

#: Rates of positions (nodes, 3) [m/s], of velocities (nodes, 3) [m/s^2], and powers (k,) [W].
Rates = tuple[Array, Array, Array]


def rates(model: Model, r: Array, v: Array, t: Array, track: bool) -> tuple[Rates, Array]:
    """(r', v', work') and the tensions (n,) [N] at one instant; without `track` no powers."""
    model = model.with_lengths(t)
    k = model.instant(r, v, t)
    tension = model.tension_by_law(k)
    laws = {law.name: law.law_force(k, law.at(k)) for law in model.laws}
    force = model.force(k) + model.tension_force(tension, k.tangents) + sum(laws.values())
    a = accelerations(model, k, force, t)
    works = {name: jnp.sum(force * v) for name, force in laws.items()}
    if track:
        power = powers(model, k, tension, a, works)
    else:
        power = jnp.zeros(0, r.dtype)
    return (v, a, power), tension


def accelerations(model: Model, k: Kinematics, force: Array, t: Array) -> Array:
    """Accelerations (nodes, 3) [m/s^2] under nodal forces (nodes, 3) [N]; not where `couples_inertia`."""
    line = model.line
    if model.effects_with(AddedMass):  # each node has its own mass matrix
        blocks = local_jacobian(lambda a: model.inertia(k, a), jnp.zeros_like(force))
        return apply(inverse(blocks), force)
    diagonal = model.node_mass
    if not line.compound:
        return force / diagonal[:, None]
    if model.has_moving_ends:
        force = force - model.nodal_inertia(jnp.zeros_like(force), model.end_acceleration(t))
    off = line.blocks()[1][1 : model.free_nodes]
    zero = jnp.zeros_like(diagonal[:1])
    return solve_tridiagonal(jnp.concatenate([zero, off]), diagonal, jnp.concatenate([off, zero]), force)


def powers(model: Model, k: Kinematics, tension: Array, a: Array, laws: Works | None = None) -> Array:
    """Power (k,) [W] in the order of `work_names`; `laws` are those of set-valued laws."""
    line = model.line
    forces = {name: jnp.sum(force * k.v) for name, force in non_conservative_forces(model, k).items()}
    turned = {turning_work_name(e): _turning(model, e, k, a) for e in model.effects_with(AddedMass)}
    axial = line.axial.powers(k.links, k.link_velocities, tension, line.length)
    ends = end_powers(model, tension[:, None] * k.tangents, k.ends, k)
    return book_works(model, forces, laws or {}, turned, axial, ends)


def _turning(model: Model, effect: AddedMass, k: Kinematics, a: Array) -> Array:
    """Power [W] that added mass gains by turning: rate of its kinetic energy minus the power of its inertia."""

    def energy(r: Array, v: Array, t: Array) -> Array:
        return effect.kinetic(model.kinematics(r, v, t))

    return jax.jvp(energy, (k.r, k.v, k.t), (k.v, a, jnp.ones_like(k.t)))[1] - jnp.sum(k.v * effect.inertia(k, a))


def combine(model: Model, s: State, h: Array, slope: Rates) -> State:
    """The state after moving from s along the combined slope."""
    r, v, work = (now + h * rate for now, rate in zip((s.r, s.v, s.work), slope, strict=True))
    k = model.kinematics(r, v, s.t + h)
    tension = model.with_lengths(k.t).tension_by_law(k)
    own = s.own
    if own:
        own = model.advance_internal_state(model.kinematics(s.r, s.v, s.t), k, tension, h)
    return replace(s, r=r, v=v, tension=tension, t=s.t + h, acceleration=slope[1], work=work, own=own, angles=None)


@dataclass(frozen=True)
class RungeKutta(Explicit):
    """`k_i = f(t + c_i h, y + h sum_j a_ij k_j)`, `y1 = y + h sum_i b_i k_i`, with `c_i = sum_j a_ij`.

    Stable only for steps well below the axial period of the stiffest link.
    """

    #: Rows of the tableau below the first stage, each (i,), and the weights (s,).
    a: ClassVar[tuple[tuple[float, ...], ...]]
    b: ClassVar[tuple[float, ...]]

    @property
    def evaluations(self) -> int:
        return len(self.b)

    def advance(self, model: Model, s: State, h: Array) -> State:
        track = bool(s.work.size)
        slopes = [rates(model, s.r, s.v, s.t, track)[0]]
        for row in self.a:
            dr, dv, _ = _weigh_slopes(row, slopes)
            slopes.append(rates(model, s.r + h * dr, s.v + h * dv, s.t + sum(row) * h, track)[0])
        return combine(model, s, h, _weigh_slopes(self.b, slopes))


def _weigh_slopes(weights: tuple[float, ...], slopes: list[Rates]) -> Rates:
    """The weighted sum of slopes; zero weights are skipped."""
    factors = [weight for weight in weights if weight]
    used = itertools.compress(slopes, weights)
    return jax.tree.map(lambda *k: sum(map(operator.mul, factors, k)), *used)
