"""Accelerometers and gyroscopes on links.

An accelerometer at the position s [m] of a link shows the specific force in its own axes,

    f = a - g,      a = d^2/dt^2 (r_1 + s d/|d|),      d = r_2 - r_1,      g = (0, 0, -gravity)

`along` is d/|d|, `side` the y axis made perpendicular to it, and `across` = side x along, in which the link's angle
from the horizontal grows (downwards for a link along +x). A sensor mounted turned by an angle has axes turned by it
about side. A gyroscope shows the rate about side, which is that of the link's angle from the horizontal.

Derivatives are central differences of fourth order of the saved motion, with errors (w h)^4/90 of an acceleration and
(w h)^4/30 of a rate for a motion of angular frequency w saved at intervals h; cubics extrapolate them to the ends.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import safe_norm
from dropper_jax.base.read import Table
from fitting.channels.channel import Channel, Given, OnLink, SavedMotion
from fitting.channels.entries import optional_number, read_axes
from fitting.channels.position import find_link, share_of_link

#: Axes of an accelerometer, by name.
AXES = ("along", "across", "side")
#: Weights of central differences of fourth order, of the rows two before to two after.
FIRST_DIFFERENCE = (1 / 12, -8 / 12, 0.0, 8 / 12, -1 / 12)
SECOND_DIFFERENCE = (-1 / 12, 16 / 12, -30 / 12, 16 / 12, -1 / 12)


@dataclass(frozen=True)
class Inertial(OnLink):
    """A sensor that feels how its link moves: the motion is differentiated."""

    margin: ClassVar[int] = 2

    def link_direction(self, motion: SavedMotion) -> Array:
        """Unit vectors (S, 3) along the link."""
        d = self.links(motion)
        return d / safe_norm(d)[:, None]

    def side(self, along: Array) -> Array:
        """Unit vectors (S, 3) perpendicular to the link, nearest to the y axis."""
        y = jnp.array([0.0, 1.0, 0.0])
        across = y - along[:, 1:2] * along
        return across / safe_norm(across)[:, None]


@dataclass(frozen=True)
class Accelerometer(Inertial):
    """Specific force [m/s^2] at a position [m] of a link, in axes turned by an angle [rad]."""

    kind: ClassVar[str] = "accelerometer"
    measures: ClassVar[str] = "m/s^2"
    scalar: ClassVar[bool] = False
    KEYS: ClassVar[tuple[str, ...]] = ("axes", "position", "turn")
    mounting: ClassVar[dict[str, str]] = {"position": "m", "turn": "rad"}

    axes: tuple[int, ...] = (0, 1)
    position: float | Array = 0.0
    turn: float | Array = 0.0

    @classmethod
    def sensor_fields(cls, given: Given) -> Table:
        table = given.table
        path = given.path
        axes = read_axes(table, path, AXES, AXES[: len(given.columns)], given.columns)
        line, link = find_link(given.scene, table, path)
        length = float(line.spec.length[link])
        if "at" not in table:
            position = optional_number(table, path, "position", 0.5 * length, low=0.0, high=length)
        elif "position" in table:
            raise SceneError(f"{path}.position: given twice, by `at` too; allowed: one of them")
        else:
            position = share_of_link(line, link, table["at"]) * length
        turn = optional_number(table, path, "turn", 0.0)
        return {"axes": axes, "position": position, "turn": turn, **super().sensor_fields(given)}

    def mounted(self, position: Array, turn: Array) -> Channel:
        return replace(self, position=position, turn=turn)

    def see(self, motion: SavedMotion) -> Array:
        along = self.link_direction(motion)
        mount = motion.nodes[:, self.first] + self.position * along
        inner = along[self.margin : -self.margin]
        force = differences(mount, SECOND_DIFFERENCE) / motion.spacing**2 + jnp.array([0.0, 0.0, 1.0]) * motion.gravity
        side = self.side(inner)
        axes = jnp.stack([inner, jnp.cross(side, inner), side])
        first, second, third = jnp.sum(force * axes, axis=2)
        c = jnp.cos(self.turn)
        s = jnp.sin(self.turn)
        turned = (c * first + s * second, c * second - s * first, third)
        return jnp.stack([turned[i] for i in self.axes], axis=1)


@dataclass(frozen=True)
class Gyro(Inertial):
    """Rate [rad/s] of a link's angle from the horizontal, positive downwards."""

    kind: ClassVar[str] = "gyro"
    measures: ClassVar[str] = "rad/s"

    def see(self, motion: SavedMotion) -> Array:
        along = self.link_direction(motion)
        inner = along[self.margin : -self.margin]
        rate = differences(along, FIRST_DIFFERENCE) / motion.spacing
        return jnp.sum(self.side(inner) * jnp.cross(inner, rate), axis=1, keepdims=True)


def differences(rows: Array, weights: tuple[float, ...]) -> Array:
    """Derivatives in units of the interval: sums (S - 4, m) of five neighbouring rows (S, m) with these weights."""
    count = len(rows) - len(weights) + 1
    return sum(weight * rows[i : i + count] for i, weight in enumerate(weights))
