"""Rigid bodies of pictures: their cylinders and spheres as shapes in space, and their outlines."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dropper_jax.scene.body import rotation

#: Number of corners of a circle.
SIDES = 28


class Shape(NamedTuple):
    """A cylinder of a body between two positions in its axes [m], or a sphere with two equal positions."""

    body: int
    start: np.ndarray
    end: np.ndarray
    diameter: float

    def rings(self) -> np.ndarray:
        """Circles (rings, SIDES, 3) [m] in the body's axes whose hull is the shape."""
        start = self.start
        along = self.end - start
        length = np.linalg.norm(along)
        radius = 0.5 * self.diameter
        axis = np.array([0.0, 0.0, 1.0])
        if length > 0.0:
            axis = along / length
        one = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        one /= np.linalg.norm(one)
        angle = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)[:, None]
        circle = radius * (np.cos(angle) * one + np.sin(angle) * np.cross(axis, one))
        if length > 0.0:
            return start + np.stack([circle, circle + along])
        tilt = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SIDES // 2 + 1)[:, None, None]
        return start + np.cos(tilt) * circle + radius * np.sin(tilt) * axis


class Bodies(NamedTuple):
    """Rigid bodies of a run: shapes, reference points (k, bodies, 3) [m], roll, pitch and yaw (k, bodies, 3) [rad]."""

    names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    position: np.ndarray
    attitude: np.ndarray

    def rings(self, index: int) -> list[np.ndarray]:
        """Rings of each shape in the scene [m] at a sample."""
        axes = list(map(rotation, self.attitude[index]))
        return [self.position[index, shape.body] + shape.rings() @ axes[shape.body].T for shape in self.shapes]

    def outlines(self, index: int, project: Callable[[np.ndarray], np.ndarray]) -> list[np.ndarray]:
        """Outline (corners, 2) of each shape in a projection of positions (n, 3) to (n, 2)."""
        return [_outline(project(rings.reshape(-1, 3))) for rings in self.rings(index)]

    def extent_points(self) -> np.ndarray:
        """Ends and widths of all shapes over the run (n, 3) [m], for limits of pictures."""
        some = np.unique(np.linspace(0, len(self.position) - 1, 200).astype(int))
        return np.concatenate([ring.reshape(-1, 3)[::7] for i in some for ring in self.rings(i)])


def _outline(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull of points (n, 2)."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # edge on
        return points
