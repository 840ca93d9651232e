"""A rigid line of point masses as an ordinary differential equation: tensions from zero acceleration of link lengths.

    M a = F(r, v, t) + G' T,    d . d'' + |d'|^2 = 0 of every link

With u = d/L the tensions follow from one symmetric tridiagonal system with a row per link (index reduction):

    (G M^-1 G') T = u . (difference of F/m over the link, of prescribed points their acceleration) + |d'|^2/L

Lengths and their rates are then invariants of the motion, from which a scheme drifts by its error. `on_links` restores
both, each by the smallest change in the mass metric.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.backend.tridiagonal import cyclic_reduction
from dropper_jax.base.numerics import dot
from dropper_jax.model import Kinematics, Model, book_works, work_names


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
    tension = _solve_multipliers(model, unit, inverse, rhs)
    power = _powers(model, k, tension[:, None] * unit) if track and work_names(model) else jnp.zeros(0, r.dtype)
    return Moving(loose + model.tension_force(tension, unit) * inverse[:, None], tension, power)


def on_links(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions after one Newton correction of the lengths, and velocities (nodes, 3) that stretch no link there."""
    ends, length, inverse = model.ends(t), model.line.length, 1.0 / model.node_mass
    unit = model.links(r, ends) / length[:, None]
    gap = 0.5 * length * (dot(unit, unit) - 1.0)
    r = r + model.tension_force(_solve_multipliers(model, unit, inverse, gap), unit) * inverse[:, None]
    return r, v + _impact_change(model, r, v, t)[0]


def apply_jump(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Velocities (nodes, 3) after prescribed points take their velocities at t, and impulses in the links (n, 3) [N
    s]."""
    change, impulse = _impact_change(model, r, v, t)
    return v + change, impulse


def _impact_change(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    ends, inverse = model.ends(t), 1.0 / model.node_mass
    unit = model.links(r, ends) / model.line.length[:, None]
    impulse = _solve_multipliers(model, unit, inverse, dot(unit, model.rates(v, ends)))
    return model.tension_force(impulse, unit) * inverse[:, None], impulse[:, None] * unit


def _solve_multipliers(model: Model, unit: jax.Array, inverse: jax.Array, rhs: jax.Array) -> jax.Array:
    """y of `(G M^-1 G') y = rhs`, the rows of G the vectors `unit` (n, 3); `inverse` are 1/m of the free nodes."""
    zero = jnp.zeros_like(inverse[:1])
    held = [zero] if model.end_held else []
    near = jnp.concatenate([zero, inverse])[: model.line.links]
    far = jnp.concatenate([inverse, *held])
    off = -dot(unit[:-1], unit[1:]) * near[1:]
    diagonal = (near + far) * dot(unit, unit)
    return cyclic_reduction(jnp.concatenate([zero, off]), diagonal, jnp.concatenate([off, zero]), rhs)


def _powers(model: Model, k: Kinematics, force: jax.Array) -> jax.Array:
    forces = {name: jnp.sum(force * k.v) for name, force in model.working_forces(k).items()}
    return book_works(model, forces, model.end_powers(force, k.ends, k))
