"""What the explicit Runge-Kutta schemes share: rates of change of an elastic line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax.lax.linalg import tridiagonal_solve

from dropper_jax.axial import Rope
from dropper_jax.base.numerics import inverse3, safe_norm
from dropper_jax.model.effect import Effect, has
from dropper_jax.model.kinematics import Kinematics
from dropper_jax.model.model import Model
from dropper_jax.model.state import State
from dropper_jax.residual.problem import Integrator, node_blocks


@dataclass(frozen=True)
class RungeKutta(Integrator):
    """An explicit scheme: stable only for steps well below the axial period of the stiffest link."""

    implicit: ClassVar[bool] = False

    def refuse(self, model: Model) -> str | None:
        if not model.line.axial.elastic:
            return "explicit schemes need tensions that follow from lengths, but the links are rigid; set axial.law"
        if couples_inertia(model):
            return "added mass couples neighbouring nodes here; use energy_momentum"
        return super().refuse(model)


def couples_inertia(model: Model) -> bool:
    """Whether added mass couples neighbouring nodes, so that accelerations need more than each node's own mass."""
    added = [e for e in model.effects if has(e, "inertia")]
    return bool(added) and (model.line.compound or any(e.reach > 0 for e in added))


Rates = tuple[jax.Array, jax.Array, jax.Array]


def rates(model: Model, r: jax.Array, v: jax.Array, t: jax.Array, track: bool) -> tuple[Rates, jax.Array]:
    """(r', v', work') and the tensions (n,) [N] at one instant."""
    line = model.line
    k = model.kinematics(r, v, t)
    k = model.kinematics(r, v, t, k.ends, prepared=model.prepare(k))
    tension = line.axial.tension(k.links, k.link_velocities, line.length)
    force = model.force(k) + model.pull(tension, k.tangents)
    a = accelerations(model, k, force, t)
    power = powers(model, k, tension, a) if track else jnp.zeros(0, r.dtype)
    return (v, a, power), tension


def accelerations(model: Model, k: Kinematics, force: jax.Array, t: jax.Array) -> jax.Array:
    """Accelerations (nodes, 3) [m/s^2] under nodal forces (nodes, 3) [N]; not where `couples_inertia`."""
    line, free = model.line, model.free_nodes
    if any(has(e, "inertia") for e in model.effects):  # each node has a mass matrix of its own
        blocks = node_blocks(lambda a: model.inertia(k, a), free, force.dtype)
        return jnp.sum(inverse3(blocks) * force[:, None, :], axis=-1)
    diagonal = model.node_mass
    if not line.compound:
        return force / diagonal[:, None]
    if model.moving:
        moved = jax.jvp(lambda time: model.ends(time)[2:], (t,), (jnp.ones_like(t),))[1]
        start, end = moved[0], moved[1] if model.end_held else None
        force = force - line.inertia_force(jnp.zeros_like(force), start, end, model.end_held)
    off = line.blocks()[1][1:free]
    zero = jnp.zeros_like(diagonal[:1])
    return tridiagonal_solve(jnp.concatenate([zero, off]), diagonal, jnp.concatenate([off, zero]), force)


def powers(model: Model, k: Kinematics, tension: jax.Array, a: jax.Array) -> jax.Array:
    """Power (k,) [W] of what `work_names` lists."""
    line = model.line
    effects = [e for e in model.effects if has(e, "force") and not has(e, "potential")]
    powers = [jnp.sum(e.force(k) * k.v) for e in effects]
    powers += [_turning(model, e, k, a) for e in model.effects if has(e, "kinetic")]
    if line.axial.damping is not None:
        stretching = jnp.sum(k.links * k.link_velocities, axis=-1) / safe_norm(k.links)
        damper = line.axial.kept(line.axial.damping / line.length * stretching)
        if isinstance(line.axial, Rope):
            damper = tension - line.axial.kept(line.axial.spring(safe_norm(k.links), line.length))
        powers.append(-jnp.sum(damper * stretching))
    if isinstance(line.axial, Rope):
        powers.append(jnp.zeros((), k.r.dtype))  # an explicit scheme has no law at the end of a step
    if model.moving:
        powers.append(model.end_power(tension[:, None] * k.tangents, k.ends))
    return jnp.stack(powers)


def _turning(model: Model, effect: Effect, k: Kinematics, a: jax.Array) -> jax.Array:
    """What added mass gains by turning [W]: rate of its kinetic energy less the power of its inertia."""

    def energy(r: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        return effect.kinetic(model.kinematics(r, v, t))

    rate = jax.jvp(energy, (k.r, k.v, k.t), (k.v, a, jnp.ones_like(k.t)))[1]
    return rate - jnp.sum(k.v * effect.inertia(k, a))


def combine(model: Model, s: State, h: jax.Array, slope: Rates) -> State:
    """The state after moving from s along the combined slope."""
    r, v, work = (now + h * rate for now, rate in zip((s.r, s.v, s.work), slope, strict=True))
    k = model.kinematics(r, v, s.t + h)
    tension = model.line.axial.tension(k.links, k.link_velocities, model.line.length)
    return State(r=r, v=v, tension=tension, t=s.t + h, acceleration=slope[1], law=s.law, work=work)
