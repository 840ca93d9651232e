"""Applied forces on nodes: constant, ramp and release, or any time table."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.read import Values, rises
from dropper_jax.model import Effect, Kinematics
from dropper_jax.scene import SceneData


@component
class NodalForce(Effect):
    """Force `F_i(t) = s(t) force_i` on chosen nodes.

    `s(t)` is 1 (constant), `min(max((t - start)/rise, 0), 1)` until `release` and 0 after it (ramp; thesis (E.1)-(E.3)
    is `rise = M g / 0.094 s`), or read from a table `time`, `scale` (linear between the rows, held outside).

    Schemes evaluate s at their own instants (the middle of the step by default). Equal steps move a `release` inside a
    step to the end or the start of that step, an error of first order in the step: use a step that divides `release`.
    Steps that follow an accuracy end there.
    """

    name = "nodal_force"
    single_line = True
    constant = True
    force_n: Array = parameter("force on each named node", unit="N", shape="vectors")
    start: Array | None = parameter("when the ramp starts", unit="s", low=0.0, default=None)
    rise: Array | None = parameter("time from zero to the full force", unit="s", above=0.0, default=None)
    release: Array | None = parameter("when the force is released", unit="s", low=0.0, default=None)
    time: Array | None = parameter("times of the table", unit="s", shape="table", default=None)
    scale: Array | None = parameter("factor at those times", unit="-", shape="table", default=None)
    nodes: tuple[int, ...] = option(
        "node numbers, counted from 1 at the node next to the first point", type=tuple, default=()
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        links = scene.lines[0].links
        nodes = values["nodes"]
        for node in nodes:
            if not 1 <= node <= links:
                raise SceneError(f"effects.nodal_force.nodes: {node} is not a node of the line; allowed: 1 to {links}")
        forces = len(values["force_n"])
        if len(nodes) != forces:
            raise SceneError(
                f"effects.nodal_force.force_n: {forces} forces for {len(nodes)} nodes; give one 3-vector per node"
            )
        given = {key for key, value in values.items() if value is not None}
        table = given & {"time", "scale"}
        if len(table) == 1:
            raise SceneError("effects.nodal_force: `time` and `scale` belong together, one of them is missing")
        if not table:
            return
        if len(values["time"]) != len(values["scale"]) or not rises(values["time"], 2):
            raise SceneError("effects.nodal_force.time: needs at least 2 increasing times, as many as `scale`")
        if given & {"start", "rise", "release"}:
            raise SceneError("effects.nodal_force: a table excludes `start`, `rise` and `release`; give one of the two")

    def factor(self, t: Array) -> Array:
        """s(t), dimensionless."""
        if self.time is not None and self.scale is not None:
            return jnp.interp(t, self.time, self.scale)
        begin = 0.0 if self.start is None else self.start
        if self.rise is None:
            s = jnp.where(t >= begin, 1.0, 0.0)
        else:
            s = jnp.clip((t - begin) / self.rise, 0.0, 1.0)
        if self.release is None:
            return s
        return jnp.where(t < self.release, s, 0.0)

    @property
    def corners(self) -> Array | None:
        if self.time is not None:
            return self.time
        found = [jnp.zeros((), self.force_n.dtype) if self.start is None else self.start]
        if self.rise is not None:
            found.append(found[0] + self.rise)
        if self.release is not None:
            found.append(self.release)
        return jnp.stack(found)

    def force(self, k: Kinematics) -> Array:
        index = np.array(self.nodes) - 1
        movable = index < k.free  # a force on a fixed node has no effect
        return scatter_add(index[movable], self.factor(k.t) * self.force_n[np.flatnonzero(movable)], k.free)
