"""Bending stiffness of lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import dot
from dropper_jax.model import Effect, Kinematics
from dropper_jax.scene import SceneData


@component
class Bending(Effect):
    """Bending moment `EI kappa` at every joint inside a line, kappa the change of direction per length.

    Energy `sum of EI/(2 l) |q_(j+1) - q_j|^2`, q the links' directions and l the mean of two neighbouring links; the
    nodal forces are minus its gradient. Second order in the length of links. Lines are pinned at their points and do
    not resist torsion; a link that has parted bends nothing.
    """

    name: ClassVar[str] = "bending"
    reach: ClassVar[int] = 2
    parts: ClassVar[bool] = True
    EI: jax.Array = parameter("bending stiffness", unit="N m^2", shape="link", low=0.0)

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: SceneData) -> None:
        if all(line.links < 2 for line in scene.lines):
            raise SceneError("effects.bending: needs a line of at least 2 links; allowed: leave it out")

    def potential(self, k: Kinematics) -> jax.Array:
        return self._energy(k, k.r)

    def force(self, k: Kinematics) -> jax.Array:
        return -jax.grad(lambda r: self._energy(k, r))(k.r)

    def _energy(self, k: Kinematics, r: jax.Array) -> jax.Array:
        links = k.model.links(r, k.ends)
        directions = links / jnp.sqrt(dot(links, links) + 1e-30)[:, None]
        first = k.model.geometry.before
        stiffness = jnp.broadcast_to(self.EI, k.line.length.shape)
        length = 0.5 * (k.line.length[first] + k.line.length[first + 1])
        bend = directions[first + 1] - directions[first]
        each = 0.25 * (stiffness[first] + stiffness[first + 1]) / length * dot(bend, bend)
        intact = k.line.axial.intact
        return jnp.sum(each if intact is None else intact[first] * intact[first + 1] * each)
