"""Prescribed points that move as recorded, each along its own path."""

from __future__ import annotations

from dataclasses import field, replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array
from dropper_jax.base.read import Values, rises
from dropper_jax.effects.end_motion import interpolate_quintic
from dropper_jax.model import Effect
from dropper_jax.scene import SceneData

#: Steps between rows over those of the same rows read time by time, above which rows count as given in that order.
MIXED_UP_STEPS = 2.0


@component
class RecordedMotion(Effect):
    """Positions of prescribed points over time, as from cameras or a vessel's log: a table of positions for each point.

    Quintics between the rows have the slopes and curvatures of a parabola through three rows (as `end_motion`), so that
    velocity and acceleration are continuous. Before and after the table the points rest. `positions` are the rows of
    the first point, then those of the second, and so on: (points * k, 3) for k times.
    """

    name = "recorded_motion"
    time: Array = parameter("times of the rows", unit="s", shape="table")
    positions: Array = parameter("point after point", unit="m", shape="vectors")
    home: Array = field(kw_only=True)  # positions of the points in the scene (points, 3) [m]
    points: tuple[str, ...] = option("names of the points that move", type=list, default=())

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        path = f"effects.{cls.name}"
        points = values["points"]
        for i, name in enumerate(points):
            scene.check_fixed(name, f"{path}.points.{i}")
            if name in points[:i]:
                raise SceneError(f"{path}.points.{i}: {name!r} is a duplicate point; allowed: each point once")
        if not points:
            raise SceneError(
                f"{path}.points: is empty; allowed: names of fixed points: {', '.join(scene.fixed_points)}"
            )
        if not rises(values["time"], 2):
            raise SceneError(f"{path}.time: needs at least 2 increasing times")
        rows = len(values["positions"])
        needed = len(values["time"]) * len(points)
        if rows != needed:
            raise SceneError(f"{path}.positions: has {rows} rows; allowed: {needed}, one per point and time")
        if _given_by_time(values["positions"], _homes(points, scene)):
            raise SceneError(
                f"{path}.positions: start with one row for each point; allowed: all rows of the first point, then "
                "those of the second, and so on"
            )

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        return cls(**values, home=as_array(_homes(values["points"], scene)))

    def moves(self, name: str) -> bool:
        return name in self.points

    def motion_of(self, name: str) -> Effect:
        i = self.points.index(name)
        own = self.positions.reshape(len(self.points), -1, 3)[i]
        return replace(self, points=(name,), home=self.home[i : i + 1], positions=own)

    def displace(self, t: Array) -> Array:
        """Displacement (3,) [m] of the first point from its position in the scene at time t [s]."""
        return interpolate_quintic(t, self.time, self.positions[: self.time.shape[0]]) - self.home[0]

    @property
    def kinks(self) -> Array | None:
        return self.time[jnp.array([0, -1])]

    @property
    def corners(self) -> Array | None:
        """All rows, at which the third derivative jumps."""
        return self.time


def _homes(points: tuple[str, ...], scene: SceneData) -> np.ndarray:
    """Positions of these points in the scene (points, 3) [m]."""
    return np.array([scene.point(name).position for name in points])


def _given_by_time(rows: np.ndarray, homes: np.ndarray) -> bool:
    """Whether rows look as if each time had those of all points: read so, paths are smoother and start closer to
    home."""
    by_point = rows.reshape(len(homes), -1, 3)
    by_time = rows.reshape(-1, len(homes), 3).swapaxes(0, 1)
    closer = np.linalg.norm(by_time[:, 0] - homes) < np.linalg.norm(by_point[:, 0] - homes)
    steps = np.linalg.norm(np.diff(by_point, axis=1))
    return bool(closer and steps > MIXED_UP_STEPS * np.linalg.norm(np.diff(by_time, axis=1)))
