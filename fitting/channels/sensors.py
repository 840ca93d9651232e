"""Sensors and cameras of a channels file: `[[channel]]`, `[[camera]]`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.read import Table, Values, check_keys, read_list, read_number, read_rows, read_table, read_text
from fitting.channels.channel import AtNode, Channel, Given, OnLink, SavedMotion
from fitting.channels.data import CameraSpec
from fitting.channels.entries import optional_number, read_axes, read_name, read_vector, require_value
from fitting.channels.position import ends_at, find_link


@dataclass(frozen=True)
class Tension(Channel):
    """Tension [N] of a link, or the magnitude `|sum of T d/|d||` of the force of all lines that end at a point.

    Attributes:
        ends: of each line that ends at the point its node there, the next one, and the link between.
        link: its number, where there are no ends.
    """

    kind: ClassVar[str] = "tension"
    measures: ClassVar[str] = "N"
    of_tension: ClassVar[bool] = True

    ends: tuple[tuple[int, int, int], ...] = ()
    link: int = 0

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        if "point" not in given.table:
            line, link = find_link(given.scene, given.table, given.path)
            return {"link": line.links.start + link}
        ends = ends_at(given.scene, read_text(given.table["point"], f"{given.path}.point"), given.path)
        if len(ends) > 1:
            return {"ends": ends}
        return {"link": ends[0][2]}

    def see(self, motion: SavedMotion) -> Array:
        if not self.ends:
            return motion.tension[:, self.link, None]
        total = 0.0
        for node, inner, link in self.ends:
            d = motion.middle[:, inner] - motion.middle[:, node]
            total = total + (motion.tension[:, link] / safe_norm(d))[:, None] * d
        return safe_norm(total)[:, None]


def projection(position: np.ndarray, look_at: np.ndarray, focal: float, centre: np.ndarray) -> np.ndarray:
    """The matrix P (3, 4) of an upright pinhole camera: `(u w, v w, w) = P (x, y, z, 1)`, v downwards.

    Args:
        position, look_at: (3,) [m].
        focal: [px].
        centre: point of the picture (2,) [px] that shows `look_at`.
    """
    ahead = look_at - position
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    turn = np.stack([right, np.cross(ahead, right), ahead])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    inner = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    return inner @ np.column_stack([turn, -turn @ position])


@dataclass(frozen=True)
class Pixel(AtNode):
    """Position (u, v) [px] of a node in the picture of a pinhole camera of projection P; NaN behind it (w <= 0)."""

    kind: ClassVar[str] = "pixel"
    measures: ClassVar[str] = "px"
    scalar: ClassVar[bool] = False
    without_value: ClassVar[str] = "its point is behind its camera (move the camera; with `projection` v is downwards)"

    matrix: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        require_value(given.table, given.path, "camera", "the name of a [[camera]]")
        if len(given.columns) != 2:
            raise SceneError(f"{given.path}.columns: {len(given.columns)} columns; allowed: 2, u and v")
        return {"matrix": given.projections[given.common["camera"]], **super().sensor_fields(given)}

    def see(self, motion: SavedMotion) -> Array:
        matrix = np.array(self.matrix)
        seen = self.positions(motion) @ matrix[:, :3].T + matrix[:, 3]
        depth = seen[:, 2:]
        in_front = depth > 0
        return jnp.where(in_front, seen[:, :2] / jnp.where(in_front, depth, 1.0), jnp.nan)


#: Definitions of an angle: in the x-z plane from the horizontal, positive downwards; in that plane from straight down,
#: positive towards +x; from +x towards +y.
ANGLES = ("horizontal", "down", "azimuth")


@dataclass(frozen=True)
class Angle(OnLink):
    """Angle of a link's direction d: `atan2(-d_z, d_x)`, `atan2(d_x, -d_z)` or `atan2(d_y, d_x)` [rad]."""

    kind: ClassVar[str] = "angle"
    measures: ClassVar[str] = "rad"
    turns: ClassVar[bool] = True
    KEYS: ClassVar[tuple[str, ...]] = ("zero",)

    zero: str = "horizontal"

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        zero = read_text(given.table.get("zero", "horizontal"), f"{given.path}.zero", ANGLES)
        return {"zero": zero, **super().sensor_fields(given)}

    def see(self, motion: SavedMotion) -> Array:
        d = self.links(motion)
        pairs = {"horizontal": (-d[:, 2], d[:, 0]), "down": (d[:, 0], -d[:, 2]), "azimuth": (d[:, 1], d[:, 0])}
        up, along = pairs[self.zero]
        flat = (up == 0) & (along == 0)  # a link seen end on has no angle: derivatives stay finite
        angle = jnp.arctan2(jnp.where(flat, 0.0, up), jnp.where(flat, 1.0, along))
        turns = jax.lax.stop_gradient(jnp.unwrap(angle) - angle)
        return (angle + turns)[:, None]


AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Position(AtNode):
    """Coordinates [m] of a node, one column for each of `axes`."""

    kind: ClassVar[str] = "position"
    measures: ClassVar[str] = "m"
    scalar: ClassVar[bool] = False
    KEYS: ClassVar[tuple[str, ...]] = ("axes",)

    axes: tuple[int, ...] = (0, 1, 2)

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        axes = read_axes(given.table, given.path, AXES, AXES, given.columns)
        return {"axes": axes, **super().sensor_fields(given)}

    def see(self, motion: SavedMotion) -> Array:
        return self.positions(motion)[:, list(self.axes)]


@dataclass(frozen=True)
class Depth(AtNode):
    """Depth `-z` [m] below the mean surface, as measured by a pressure sensor averaged over a wave."""

    kind: ClassVar[str] = "depth"
    measures: ClassVar[str] = "m"

    def see(self, motion: SavedMotion) -> Array:
        return -self.positions(motion)[:, 2:]


def read_camera(table: Values, path: str) -> CameraSpec:
    """A `[[camera]]`, given by its projection, or by its position, the point that it looks at and its focal length.

    A projection may have either sign: that with a positive determinant of its first three columns has w > 0 in front of
    the camera (Hartley and Zisserman, Multiple View Geometry, 2nd edition, (6.15)), if v is downwards.

    Raises:
        SceneError: an unknown or missing key, or a camera that looks straight up or down.
    """
    keys = ("name", "position", "look_at", "focal", "centre", "projection", "delay", "rate")
    check_keys(read_table(table, path), keys, path)
    if "projection" in table:
        rows = read_list(table["projection"], f"{path}.projection", 3, "3 rows of 4 numbers")
        matrix = read_rows(rows, f"{path}.projection", {"unit": "-"}, 4, "4 numbers")
        if np.linalg.det(matrix[:, :3]) < 0:
            matrix = -matrix
    else:
        position = read_vector(table, path, "position", 3)
        look_at = read_vector(table, path, "look_at", 3)
        ahead = look_at - position
        if np.hypot(ahead[0], ahead[1]) < 1e-9:
            raise SceneError(f"{path}.look_at: directly above or below the camera. Use another point, or `projection`")
        limits = {"unit": "px", "above": 0.0}
        focal = read_number(require_value(table, path, "focal", "focal length [px]"), f"{path}.focal", limits)
        matrix = projection(position, look_at, focal, read_vector(table, path, "centre", 2))
    return CameraSpec(
        read_name(table, path),
        tuple(map(tuple, matrix.tolist())),
        optional_number(table, path, "delay", 0.0),
        optional_number(table, path, "rate", 1.0, above=0.0),
    )
