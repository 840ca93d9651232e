"""Dry friction on the seabed: Coulomb friction with true sticking, or laws that grow with speed."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot
from dropper_jax.base.read import Values
from dropper_jax.effects.joint_friction import row_sizes
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Kinematics, Law, Line
from dropper_jax.scene import SceneData

#: Speed below which a node at the start of a step counts as at rest [m/s]: rounding, not creep.
AT_REST = 1e-10


@component
class SeabedFriction(Law):
    """Coulomb friction `|z| <= mu N` on nodes on the seabed, in its plane: mu is static at rest, kinetic in motion.

    The friction z (nodes, 2) [N] is an unknown of the step, determined by `z = P(z - rho v_mid)`, P the projection on
    the disc of radius mu N and rho the node's mass over the step (its value does not change the solutions). A node
    slides against its mid-step velocity with |z| = mu N, or stays exactly at rest. A node that stayed has zero velocity
    at the end of the step: friction takes the oscillation that the midpoint rule would leave.

    (The paper's (19) is the same law, with the resultant of all other forces in place of the unknown.)

    `law = "regularised"` is Coulomb's law without sticking, as in codes with explicit schemes: `|z| = mu N` above
    `speed`, proportional to |v| below it. Nodes that should rest creep at less than `speed`. Explicit schemes support
    it.

    `law = "moordyn"` is MoorDyn's: against the velocity v along the seabed, `|z| = mu c |v|` up to the limit, with
    `damping` c its FricDamp [N s/m]. A node that starts the step with `mu c |v|` above the static limit has the kinetic
    one. c applies per node and does not depend on weight: where the contact force is N the limit is reached at the
    speed N/c.
    """

    name = "seabed_friction"
    node_local = True
    needs = ("seabed",)
    kinetic: Array = parameter("kinetic coefficient of friction", unit="-", low=0.0)
    static: Array | None = parameter("static coefficient of friction", unit="-", low=0.0, default=None)
    damping: Array = parameter(
        "MoorDyn's FricDamp: friction per speed and coefficient, of each node", unit="N s/m", low=0.0, default=200.0
    )
    speed: Array = parameter("speed at which regularised friction reaches mu N", unit="m/s", above=0.0, default=0.01)
    law: str = option(
        "Coulomb's law with sticking; regularised or MoorDyn's: both creep, and explicit schemes support them",
        choices=("coulomb", "regularised", "moordyn"),
        default="coulomb",
    )
    statics: str = option(
        "friction in static equilibrium: none, or that of lines pulled outward from their first point",
        choices=("none", "outward"),
        default="none",
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        path = "effects.seabed_friction"
        law = values["law"]
        static = values["static"]
        kinetic = values["kinetic"]
        if "joint_friction" in scene.effects:
            raise SceneError(f"{path}: cannot be combined with [effects.joint_friction]; allowed: one of them")
        if static is not None and static < kinetic:
            raise SceneError(f"{path}.static: {static:g} is out of range; allowed: at least `kinetic`, {kinetic:g}")
        if law != "coulomb" and values["statics"] != "none":
            raise SceneError(f"{path}.statics: 'outward' is friction at rest, which law {law!r} lacks; allowed: 'none'")
        if law == "regularised" and static is not None:
            raise SceneError(
                f"{path}.static: law 'regularised' has no friction at rest; allowed: laws 'coulomb', 'moordyn', or no "
                "`static`"
            )

    @property
    def of_state(self) -> bool:
        return self.law != "coulomb"

    @property
    def components(self) -> int:
        return 2

    def law_force(self, k: Kinematics, z: Array) -> Array:
        first, second = _find_seabed(k).tangents(k.r)
        return z[:, :1] * first + z[:, 1:] * second

    def prepare(self, k: Kinematics) -> Array | None:
        """Which nodes (nodes, 1) have the kinetic limit; k has the velocities of the start of the step."""
        if self.static is None:
            return None
        speed = row_sizes(_along_bed(k, k.v))
        if self.law == "moordyn":
            return self.kinetic * self.damping * speed > self.static * _normal(k)
        return speed > AT_REST

    def _limit(self, k: Kinematics) -> Array:
        """Maximum friction (nodes, 1) [N]."""
        coefficient = self.kinetic
        if self.static is not None:
            coefficient = jnp.where(k.prepared(self), self.kinetic, self.static)
        return coefficient * _normal(k)

    def _trial(self, k: Kinematics, z: Array, h: Array) -> Array:
        """`p = z - rho v_mid` (nodes, 2) [N], or proportional to `-v_mid`."""
        if self.of_state:
            return self._creep(k)
        return z - (k.model.node_mass / h)[:, None] * _along_bed(k, k.v)

    def _creep(self, k: Kinematics) -> Array:
        """Friction (nodes, 2) [N] of a law that grows with speed, before its limit."""
        if self.law == "moordyn":
            rate = self.damping
        else:
            rate = _normal(k) / self.speed
        return -self.kinetic * rate * _along_bed(k, k.v)

    def law_residual(self, k: Kinematics, z: Array, h: Array, easing: Array | None = None) -> Array:
        return z - _clip_to_limit(self._trial(k, z, h), self._limit(k))

    def at(self, k: Kinematics) -> Array:
        return _clip_to_limit(self._creep(k), self._limit(k))

    def admissible(self, z: Array) -> Array:
        return z  # the bound is the contact force, which is an unknown of the step too

    def stop(self, k: Kinematics, v1: Array, z: Array, h: Array) -> Array:
        if self.of_state:
            return v1
        limit = self._limit(k)
        stuck = (row_sizes(self._trial(k, z, h)) <= limit) & (limit > 0.0)
        return v1 - jnp.where(stuck, self.law_force(k, _along_bed(k, v1)), 0.0)

    def law_scale(self, line: Line, h: Array) -> Array:
        """Scale of the force rows [N]: that of the contact forces, which have the same rounding."""
        return jnp.mean(line.mass) * jnp.maximum(GRAVITY, jnp.mean(line.length) / h**2)


def _clip_to_limit(p: Array, limit: Array) -> Array:
    """p, or its direction at the limit."""
    size = row_sizes(p)
    return jnp.where(size <= limit, p, limit * p / size)


def _find_seabed(k: Kinematics) -> Seabed:
    return k.model.effects_with(Seabed)[0]


def _normal(k: Kinematics) -> Array:
    """Contact force (nodes, 1) [N]."""
    return _find_seabed(k).normal(k)[:, None]


def _along_bed(k: Kinematics, v: Array) -> Array:
    """Components (nodes, 2) of vectors (nodes, 3) along the seabed."""
    return jnp.stack([dot(v, tangent) for tangent in _find_seabed(k).tangents(k.r)], axis=-1)
