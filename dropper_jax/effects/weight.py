"""Weight of the line, in air or as an explicit weight in water."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import upright
from dropper_jax.model import Effect, Kinematics, Line


@component
class Weight(Effect):
    """Weight `F = -w z` on each node.

    In air `w = m g`. In water give `wet_weight` [N] per link. Neither source has buoyancy in its equations (erratum: 14
    kg/m at 0.05 m diameter would be 7130 kg/m^3), so it is never guessed. A link's weight acts at its centre of mass,
    which lies on the link, so that distributing it to the two nodes is exact.
    """

    name = "weight"
    constant = True
    gravity: Array = parameter(
        "acceleration of gravity, by default that of the sea", unit="m/s^2", low=0.0, default=GRAVITY
    )
    wet_weight: Array | None = parameter("weight in water per link", unit="N", shape="link", default=None)

    def per_link(self, line: Line) -> Array:
        """Weight of each link (n,) [N]."""
        if self.wet_weight is None:
            return self.gravity * line.mass
        return self.wet_weight * jnp.ones_like(line.mass)

    def weights(self, k: Kinematics) -> Array:
        """Weight of each free node (nodes,) [N]."""
        return k.line.node_share(self.per_link(k.line))

    def force(self, k: Kinematics) -> Array:
        return upright(-self.weights(k))

    def potential(self, k: Kinematics) -> Array:
        return jnp.sum(self.weights(k) * k.r[:, 2])
