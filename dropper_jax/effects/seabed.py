"""The seabed: a vertical spring and damper under every node, flat or over a grid of depths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.model import ContactArea, Effect, Kinematics
from dropper_jax.scene import SceneData


@component
class Seabed(Effect):
    """Contact force `N = A max(0, k p1 + c (p1 - p0)/h)` upwards, p the depth of a node below the bed (0 above it).

    `A = D L` is the plan area of the node's halves of its links, as in MoorDyn. The law stands at the end of the step
    (p1), so that it only ever takes energy, and the damper counts what is pressed in only: it neither sticks nor jumps
    where a node touches down. Where `bed_x`, `bed_y` and `bed_depth` are given the bed is that grid, bilinear between.
    """

    name: ClassVar[str] = "seabed"
    stiffness: jax.Array = parameter("contact stiffness", unit="Pa/m", low=0.0, open_low=True, default=3e6)
    damping: jax.Array = parameter("contact damping", unit="Pa s/m", low=0.0, default=3e5)
    depth: jax.Array | None = parameter("depth of a flat bed", unit="m", low=0.0, open_low=True, optional=True)
    bed_x: jax.Array | None = parameter("x of the grid of depths", unit="m", shape="table", optional=True)
    bed_y: jax.Array | None = parameter("y of the grid of depths", unit="m", shape="table", optional=True)
    bed_depth: jax.Array | None = parameter(
        "depths of the grid, x by x (all y of the first x first)", unit="m", shape="table", optional=True
    )

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: SceneData) -> None:
        grid = [values[key] is not None for key in ("bed_x", "bed_y", "bed_depth")]
        if any(grid) and not all(grid):
            raise SceneError("effects.seabed: `bed_x`, `bed_y` and `bed_depth` belong together, one of them is missing")
        if all(grid):
            wanted = len(values["bed_x"]) * len(values["bed_y"])
            if len(values["bed_depth"]) != wanted:
                raise SceneError(
                    f"effects.seabed.bed_depth: has {len(values['bed_depth'])} entries; allowed: {wanted}, x by x"
                )
            for key in ("bed_x", "bed_y"):
                if len(values[key]) < 2 or np.any(np.diff(values[key]) <= 0):
                    raise SceneError(f"effects.seabed.{key}: needs at least 2 increasing numbers")
        elif values["depth"] is None and scene.sea is None:
            raise SceneError("effects.seabed.depth: missing; needed: the depth of the bed, or a [sea] that has one")
        if any(line.diameter is None for line in scene.lines):
            raise SceneError("line.diameter: missing; effects.seabed needs the diameter of every line [m]")

    @classmethod
    def build(cls, values: Mapping[str, Any], scene: SceneData) -> Effect:
        values = dict(values)
        if values["depth"] is None and values["bed_x"] is None:
            values["depth"] = scene.sea.depth
        return cls(**values)

    def bed(self, r: jax.Array) -> jax.Array:
        """Height z of the bed (nodes,) [m] under places r (nodes, 3)."""
        if self.bed_x is None:
            return -self.depth * jnp.ones_like(r[:, 2])
        grid = self.bed_depth.reshape(self.bed_x.shape[0], self.bed_y.shape[0])
        i, a = _cell(self.bed_x, r[:, 0])
        j, b = _cell(self.bed_y, r[:, 1])
        low = (1 - b) * grid[i, j] + b * grid[i, j + 1]
        high = (1 - b) * grid[i + 1, j] + b * grid[i + 1, j + 1]
        return -((1 - a) * low + a * high)

    def normal(self, k: Kinematics) -> jax.Array:
        """Contact force (nodes,) [N], never negative."""
        area = k.line.node_share(k.line.diameter * k.line.length)
        area = sum((e.contact_area(k.model) for e in k.model.having(ContactArea)), area)
        bed = self.bed(k.r)
        if k.h is None:
            return area * self.stiffness * jnp.maximum(bed - k.r[:, 2], 0.0)
        half = 0.5 * k.h * k.v[:, 2]
        before = jnp.maximum(bed - (k.r[:, 2] - half), 0.0)
        after = jnp.maximum(bed - (k.r[:, 2] + half), 0.0)
        return area * jnp.maximum(self.stiffness * after + self.damping * (after - before) / k.h, 0.0)

    def force(self, k: Kinematics) -> jax.Array:
        return jnp.zeros_like(k.r).at[:, 2].set(self.normal(k))


def _cell(knots: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cell of each x and where in it, 0 to 1; the edge values go on outside."""
    x = jnp.clip(x, knots[0], knots[-1])
    i = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, knots.shape[0] - 2)
    return i, (x - knots[i]) / (knots[i + 1] - knots[i])
