"""Tensions of links, and the force of lines on a point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax

from dropper_jax.base.numerics import safe_norm
from fitting.channels.channel import Channel, Context, SavedMotion
from fitting.channels.place import Where, ends_at, link_of


@dataclass(frozen=True)
class Tension(Channel):
    """Tension [N] of a link, or the magnitude `|sum of T d/|d||` of the force of all lines that end at a point."""

    kind: ClassVar[str] = "tension"
    measures: ClassVar[str] = "N"
    of_tension: ClassVar[bool] = True

    ends: tuple[tuple[int, int, int], ...] = ()
    link: int = 0

    @classmethod
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        if where.point is None:
            return cls(**common, link=link_of(context.scene, where, context.path))
        ends = ends_at(context.scene, where.point, context.path)
        if len(ends) == 1:
            return cls(**common, link=ends[0][2])
        return cls(**common, ends=ends)

    def see(self, motion: SavedMotion) -> jax.Array:
        if not self.ends:
            return motion.tension[:, self.link, None]
        total = 0.0
        for node, inner, link in self.ends:
            d = motion.middle[:, inner] - motion.middle[:, node]
            total = total + (motion.tension[:, link] / safe_norm(d))[:, None] * d
        return safe_norm(total)[:, None]
