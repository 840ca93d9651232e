"""Rigid bodies of a run as shapes in space, for pictures and the page."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dropper_jax.run.simulate import Solution
from dropper_jax.scene.body import BodySpec, rotation

#: Number of corners of a circle.
SIDES = 28


class Shape(NamedTuple):
    """A cylinder of a body between two positions in its axes [m], or a sphere with two equal positions."""

    body: int
    start: tuple[float, ...]
    end: tuple[float, ...]
    diameter: float

    def rings(self) -> np.ndarray:
        """Circles (rings, SIDES, 3) [m] in the body's axes whose hull is the shape."""
        start, end = np.array(self.start), np.array(self.end)
        along = end - start
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        side = np.eye(3)[int(np.argmin(np.abs(along)))]
        one = np.cross(along, side)
        one /= np.linalg.norm(one)
        other = np.cross(along, one)
        angle = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)[:, None]
        circle = 0.5 * self.diameter * (np.cos(angle) * one + np.sin(angle) * other)
        if length > 0.0:
            return np.stack([start + circle, end + circle])
        tilt = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SIDES // 2 + 1)
        return np.stack([start + np.cos(t) * circle + 0.5 * self.diameter * np.sin(t) * along for t in tilt])


class Bodies(NamedTuple):
    """Rigid bodies of a run: shapes, reference points (k, bodies, 3) [m], roll, pitch and yaw (k, bodies, 3) [rad]."""

    names: tuple[str, ...]
    shapes: tuple[Shape, ...]
    position: np.ndarray
    attitude: np.ndarray

    def rings(self, index: int) -> list[np.ndarray]:
        """Rings of each shape in the scene [m] at a sample."""
        found = []
        for shape in self.shapes:
            axes = rotation(self.attitude[index, shape.body])
            found.append(self.position[index, shape.body] + shape.rings() @ axes.T)
        return found

    def outlines(self, index: int, project: Callable[[np.ndarray], np.ndarray]) -> list[np.ndarray]:
        """Outline (corners, 2) of each shape in a projection of positions (n, 3) to (n, 2)."""
        found = []
        for rings in self.rings(index):
            points = project(rings.reshape(-1, 3))
            try:
                found.append(points[ConvexHull(points).vertices])
            except QhullError:  # edge on
                found.append(points)
        return found

    def extent_points(self) -> np.ndarray:
        """Ends and widths of all shapes over the run (n, 3) [m], for limits of pictures."""
        some = np.unique(np.linspace(0, len(self.position) - 1, 200).astype(int))
        return np.concatenate([ring.reshape(-1, 3)[::7] for i in some for ring in self.rings(i)])


def bodies_of(solution: Solution, last: int) -> Bodies | None:
    """The rigid bodies of a run up to a sample; None without any."""
    specs: tuple[BodySpec, ...] = getattr(solution.scene, "bodies", ())
    if not specs or solution.body_position is None:
        return None
    shapes = [
        Shape(i, tuple(c.start), tuple(c.end), float(c.diameter))
        for i, body in enumerate(specs)
        for c in body.cylinders
    ]
    shapes += [
        Shape(i, tuple(s.centre), tuple(s.centre), float(s.diameter))
        for i, body in enumerate(specs)
        for s in body.spheres
    ]
    position, attitude = (np.asarray(a, float)[:last] for a in (solution.body_position, solution.body_attitude))
    return Bodies(tuple(body.name for body in specs), tuple(shapes), position, attitude)
