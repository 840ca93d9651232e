"""A clamp that turns: the direction of a line at a fixed point, prescribed in time."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.base.read import Values, rises
from dropper_jax.effects.bending import Bending, link_at_point
from dropper_jax.effects.end_motion import interpolate_quintic
from dropper_jax.model import Effect, Kinematics, ModelView, sum_of_pieces
from dropper_jax.scene import SceneData

#: Maximum difference of a unit vector's or quaternion's length from 1.
UNIT_TOLERANCE = 1e-3
#: Maximum turn from one row of the table to the next [rad]: the path between rows farther apart is ambiguous.
MAX_TURN = np.pi / 3


@component
class ClampMotion(Effect):
    """Bending moment between the end link of a line and a clamp whose direction w turns in time.

    With q the direction of the link as it leaves the point, l its length, EI that of `bending`, the moment is that of

        EI/l |q - w(t)|^2,

    as of a point that `bending` clamps. It is a force from outside: its work, elastic energy included, is recorded
    as `clamp_motion`. Between the rows w follows quintics, as `end_motion` does, which may move the point as well.
    Before and after the table the clamp rests. Second order in the link length.
    """

    name = "clamp_motion"
    reach = 1
    needs = ("bending",)
    time: Array = parameter("times of the table", unit="s", shape="table")
    direction: Array | None = parameter(
        "direction (unit vector) in which the line leaves the point, at those times",
        unit="-",
        shape="vectors",
        default=None,
    )
    quaternion: Array | None = parameter(
        "turn of the clamp at those times, w, x, y, z of each row in one list", unit="-", shape="table", default=None
    )
    along: Array | None = parameter(
        "direction of the line in the frame that the quaternions turn", unit="-", shape="vector", default=None
    )
    point: str = option("name of the fixed point where the line is clamped", type=str, default="")

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        path = "effects.clamp_motion.point"
        scene.check_line_end(values["point"], path)
        if values["point"] in scene.effects["bending"]["clamped"]:
            raise SceneError(f"{path}: {values['point']!r} is in effects.bending.clamped too; allowed: one of the two")
        if not rises(values["time"], 2):
            raise SceneError("effects.clamp_motion.time: needs at least 2 increasing times, one per direction")
        _check_directions(values)

    @property
    def corners(self) -> Array:
        return self.time

    @property
    def directions(self) -> Array:
        """Directions (k, 3) of the table, from vectors or quaternions."""
        if self.quaternion is not None and self.along is not None:
            return rotate(self.quaternion.reshape(-1, 4), self.along)
        return jnp.asarray(self.direction)

    def leaving(self, t: Array) -> Array:
        """Direction (3,) in which the line leaves the point at time t [s]."""
        found = interpolate_quintic(t, self.time, self.directions)
        return found / safe_norm(found)

    force = sum_of_pieces

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        """The point and the other node of the link there (1, 2)."""
        graph = model.geometry
        link, leaves = link_at_point(model, self.point)
        nodes = [graph.first[link], graph.last[link]]
        return np.array([nodes if leaves else nodes[::-1]])

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        link, _ = link_at_point(k.model, self.point)
        bending = k.model.effects_with(Bending)[0]
        stiffness = k.line.axial.zero_broken(bending.EI / k.line.length)[link]
        direction = self.leaving(k.t)

        def energy(r: Array) -> Array:
            away = r[:, 1] - r[:, 0]
            bent = away / safe_norm(away)[:, None] - direction
            return stiffness * jnp.sum(dot(bent, bent))

        return -jax.grad(energy)(r)


def rotate(quaternion: Array, vector: Array) -> Array:
    """The direction of a vector v (3,), rotated by quaternions (k, 4), w first: `v + 2 s x (s x v + w v)` (k, 3), s
    their vector part. Printed quaternions are unit ones to rounding only, so their length is divided out."""
    quaternion = quaternion / jnp.sqrt(jnp.sum(quaternion**2, axis=1, keepdims=True))
    w = quaternion[:, :1]
    s = quaternion[:, 1:]
    unit = vector / safe_norm(vector)
    return unit + 2.0 * jnp.cross(s, jnp.cross(s, unit) + w * unit)


def _check_directions(values: Values) -> None:
    """Reject tables of another length, rows that are not unit vectors or quaternions, and directions that jump."""
    quaternion = values["quaternion"]
    by_quaternion = quaternion is not None
    if by_quaternion == (values["direction"] is not None) or by_quaternion != (values["along"] is not None):
        raise SceneError("effects.clamp_motion: give either `direction`, or `quaternion` and `along`")
    if by_quaternion:
        path = "effects.clamp_motion.quaternion"
        if len(quaternion) % 4:
            raise SceneError(f"{path}: has {len(quaternion)} numbers; allowed: 4 per time, w, x, y, z of each row")
        table = quaternion.reshape(-1, 4)
    else:
        path = "effects.clamp_motion.direction"
        table = values["direction"]
    rows = len(values["time"])
    if len(table) != rows:
        raise SceneError(f"{path}: has {len(table)} rows; allowed: {rows}, one per time")
    sizes = np.linalg.norm(table, axis=1)
    wrong = np.flatnonzero(np.abs(sizes - 1.0) > UNIT_TOLERANCE)
    if wrong.size:
        raise SceneError(
            f"{path}.{wrong[0]}: has the length {sizes[wrong[0]]:.4g}; allowed: 1, within {UNIT_TOLERANCE:g}"
        )
    directions = table
    if by_quaternion:
        if not np.any(values["along"]):
            raise SceneError(f"effects.clamp_motion.along: {list(values['along'])} has no direction")
        directions = np.asarray(rotate(jnp.asarray(table), jnp.asarray(values["along"])))
    cosines = np.sum(directions[1:] * directions[:-1], axis=1)
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    worst = np.argmax(turns)
    if turns[worst] > MAX_TURN:
        raise SceneError(
            f"{path}.{worst + 1}: jumps by {np.degrees(turns[worst]):.3g} degrees from the row before; allowed: "
            f"{np.degrees(MAX_TURN):.3g}. Use more rows"
        )
