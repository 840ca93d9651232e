"""Positions of nodes in the picture of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.channels.channel import Channel, Context, SavedMotion
from fitting.channels.place import Node, Where, node_of
from fitting.channels.position import position_at


def projection(position: np.ndarray, look_at: np.ndarray, focal: float, centre: np.ndarray) -> np.ndarray:
    """The matrix P (3, 4) of an upright pinhole camera: `(u w, v w, w) = P (x, y, z, 1)`, v downwards.

    Args:
        position, look_at: (3,) [m].
        focal: [px].
        centre: point of the picture (2,) [px] that shows `look_at`.
    """
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    down = np.cross(ahead, right)
    turn = np.stack([right, down, ahead])
    inner = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    return inner @ np.column_stack([turn, -turn @ position])


@dataclass(frozen=True)
class Pixel(Channel):
    """Position (u, v) [px] of a node in the picture of a pinhole camera of projection P."""

    kind: ClassVar[str] = "pixel"
    measures: ClassVar[str] = "px"

    node: Node = Node(0, 0, 0.0)
    matrix: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def make(cls, common: Mapping[str, Any], table: Mapping[str, Any], where: Where, context: Context) -> Channel:
        if common["camera"] is None:
            raise SceneError(f"{context.path}.camera: missing; needed: the name of a [[camera]]")
        if len(common["columns"]) != 2:
            raise SceneError(f"{context.path}.columns: {len(common['columns'])} columns; allowed: 2, u and v")
        matrix = context.projections[common["camera"]]
        return cls(**common, node=node_of(context.scene, where, context.path), matrix=matrix)

    def see(self, motion: SavedMotion) -> jax.Array:
        position = position_at(motion.nodes, self.node)
        matrix = np.array(self.matrix)
        seen_at = position @ matrix[:, :3].T + matrix[:, 3]
        return seen_at[:, :2] / jnp.where(seen_at[:, 2:] == 0, 1.0, seen_at[:, 2:])
