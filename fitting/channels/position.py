"""Positions of nodes and points in space, and depths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import read_list, read_text
from fitting.channels.channel import Channel, Context, SavedMotion
from fitting.channels.place import Node, Where, node_of

AXES = ("x", "y", "z")


def position_at(nodes: jax.Array, node: Node) -> jax.Array:
    """Position of the sensor (times, 3) [m]."""
    first = nodes[:, node.first]
    return first if node.share == 0 else first + node.share * (nodes[:, node.second] - first)


@dataclass(frozen=True)
class Position(Channel):
    """Coordinates [m] of a node, one column for each of `axes`."""

    kind: ClassVar[str] = "position"
    measures: ClassVar[str] = "m"
    KEYS: ClassVar[tuple[str, ...]] = ("axes",)

    node: Node = Node(0, 0, 0.0)
    axes: tuple[int, ...] = (0, 1, 2)

    @classmethod
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        path = f"{context.path}.axes"
        names = read_list(table.get("axes", list(AXES)), path, None, "a list of x, y, z")
        axes = tuple(AXES.index(read_text(name, f"{path}.{i}", AXES)) for i, name in enumerate(names))
        if len(common["columns"]) != len(axes):
            raise SceneError(
                f"{context.path}.columns: {len(common['columns'])} columns for {len(axes)} axes; allowed: one per axis"
            )
        return cls(**common, node=node_of(context.scene, where, context.path), axes=axes)

    def see(self, motion: SavedMotion) -> jax.Array:
        return position_at(motion.nodes, self.node)[:, list(self.axes)]


@dataclass(frozen=True)
class Depth(Channel):
    """Depth `-z` [m] below the mean surface, as measured by a pressure sensor averaged over a wave."""

    kind: ClassVar[str] = "depth"
    measures: ClassVar[str] = "m"

    node: Node = Node(0, 0, 0.0)

    @classmethod
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        return cls(**common, node=node_of(context.scene, where, context.path))

    def see(self, motion: SavedMotion) -> jax.Array:
        return -position_at(motion.nodes, self.node)[:, 2:]
