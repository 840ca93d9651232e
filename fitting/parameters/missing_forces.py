"""Forces that a scene lacks, each of size zero: the directions along which `law_score_tests` tests a fit.

A model with them moves exactly as without them. Only derivatives by their sizes see the forces: they cost nothing in
the steps themselves, and once per step in its derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.bending import Bending
from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Effect, Ends, Kinematics, Model
from dropper_jax.model.slots import Force
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.targets import CAMERA, MissingForce

#: Relative rate of two links [rad/s] below which the dry friction between them fades: its sign would be noise.
SLIDING_RATE = 0.02
#: Names and units of the forces, in the order of their sizes.
FORCE_UNITS = {
    "linear": "kg/s",
    "quadratic": "kg/m",
    "viscous": "N m s/rad",
    "dry": "N m",
    "springs": "N m^2",
    "added_mass": "kg/kg",
}


def missing_forces(model: Model) -> list[Parameter]:
    """The sizes of all forces as parameters, each 0."""
    kinds = [kind for kind in FORCE_UNITS if kind != "springs" or model.line.links > 1]
    return [Parameter(f"missing.{kind}", MissingForce(kind), 0.0, unit=FORCE_UNITS[kind]) for kind in kinds]


def tested_parameters(model: Model, parameters: Sequence[Parameter]) -> list[Parameter]:
    """Sizes of all candidates, which the programs of a fit with these parameters know too."""
    found = missing_forces(model)
    if all(p.name != CAMERA for p in parameters):
        found += resolve(model, [CAMERA])
    return found


def add_missing_forces(model: Model, parameters: Sequence[Parameter], values: Array) -> Model:
    """The model with the missing forces among the parameters, if there are any."""
    sizes = {p.where.field: values[i] for i, p in enumerate(parameters) if isinstance(p.where, MissingForce)}
    if not sizes:
        return model
    effect = MissingForces(sizes=jnp.stack([sizes.get(kind, jnp.zeros(())) for kind in FORCE_UNITS]))
    return replace(model, effects=(*model.effects, effect))


@component
class MissingForces(Effect):
    """`sum of c_i F_i` at c = 0, with F_i of unit size:

    drag on nodes            `-v` and `-|v| v`
    friction in all joints   torques `-w` and `-w/|w|`, w the relative rate of two links
    springs in inner joints  bending stiffness of 1 N m^2
    added mass               minus all other forces: a mass that grows by dc moves as under forces smaller by dc

    As the sizes are zero, no force couples nodes in the equations of a step: any solver supports them.
    """

    name: ClassVar[str] = "missing_forces"
    sizes: Array = parameter("size of every force", unit="-", shape="table")

    def force(self, k: Kinematics) -> Array:
        model = replace(k.model, effects=tuple(e for e in k.model.effects if e is not self))
        return _force_at_zero(self.sizes, model, k.r, k.v, k.t, k.ends)


@jax.custom_jvp
def _force_at_zero(sizes: Array, model: Model, r: Array, v: Array, t: Array, ends: Ends) -> Array:
    return jnp.zeros_like(r)


def _derivative(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """At size zero only the sizes move the force."""
    nothing = jnp.zeros_like(primals[2])
    change = tangents[0]
    if isinstance(change, SymbolicZero):
        return nothing, nothing
    return nothing, jnp.sum(change[:, None, None] * unit_forces(*primals[1:]), axis=0)


_force_at_zero.defjvp(_derivative, symbolic_zeros=True)


def unit_forces(model: Model, r: Array, v: Array, t: Array, ends: Ends) -> Array:
    """Nodal forces (kinds, nodes, 3) of unit size at one instant."""
    k = Kinematics(model, r, v, t, ends)
    friction = JointFriction(viscous=jnp.ones(()))
    rates = friction.relative_rates(k)
    slides = rates / jnp.sqrt(jnp.sum(rates**2, axis=1, keepdims=True) + SLIDING_RATE**2)
    others = sum((effect.force(k) for effect in model.effects_with(Force)), jnp.zeros_like(r))
    found = {
        "linear": -v,
        "quadratic": -safe_norm(v)[:, None] * v,
        "viscous": friction.torque_force(k, -rates),
        "dry": friction.torque_force(k, -slides),
        "springs": Bending(EI=jnp.ones(())).force(k),
        "added_mass": -others,
    }
    return jnp.stack([found[kind] for kind in FORCE_UNITS])
