"""Angles of links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.base.read import read_text
from fitting.channels.channel import Channel, Context, SavedMotion
from fitting.channels.place import Where, line_of, link_of

#: Definitions of an angle: in the x-z plane from the horizontal, positive downwards; in that plane from straight down,
#: positive towards +x; from +x towards +y.
ANGLES = ("horizontal", "down", "azimuth")


@dataclass(frozen=True)
class Angle(Channel):
    """Angle of a link's direction d: `atan2(-d_z, d_x)`, `atan2(d_x, -d_z)` or `atan2(d_y, d_x)` [rad]."""

    kind: ClassVar[str] = "angle"
    measures: ClassVar[str] = "rad"
    turns: ClassVar[bool] = True
    KEYS: ClassVar[tuple[str, ...]] = ("zero",)

    first: int = 0
    second: int = 1
    zero: str = "horizontal"

    @classmethod
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        zero = read_text(table.get("zero", "horizontal"), f"{context.path}.zero", ANGLES)
        line = line_of(context.scene, where.line, context.path)
        link = link_of(context.scene, where, context.path) - line.links.start
        return cls(**common, first=int(line.nodes[link]), second=int(line.nodes[link + 1]), zero=zero)

    def see(self, motion: SavedMotion) -> jax.Array:
        d = motion.nodes[:, self.second] - motion.nodes[:, self.first]
        pairs = {"horizontal": (-d[:, 2], d[:, 0]), "down": (d[:, 0], -d[:, 2]), "azimuth": (d[:, 1], d[:, 0])}
        up, along = pairs[self.zero]
        flat = (up == 0) & (along == 0)  # a link seen end on has no angle: derivatives stay finite
        angle = jnp.arctan2(jnp.where(flat, 0.0, up), jnp.where(flat, 1.0, along))
        turns = jax.lax.stop_gradient(jnp.unwrap(angle) - angle)
        return (angle + turns)[:, None]
