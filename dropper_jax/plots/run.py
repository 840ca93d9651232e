"""The data of a solution for pictures: valid samples, links and nodes that move, bodies as shapes in space."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import surface_over
from dropper_jax.plots import view
from dropper_jax.run.samples import Samples
from dropper_jax.run.variables import ARRAYS, SOME
from dropper_jax.scene import WholeLine, whole_lines
from dropper_jax.scene.body import rotation
from dropper_jax.scene.slices import first_nodes, point_nodes

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


#: Limits of rounding: angles [rad]; tensions relative to the maximum; displacements relative to the size of the scene.
ANGLE_ROUNDING = 1e-7
TENSION_ROUNDING = 1e-6
TRAVEL_ROUNDING = 1e-7


def swing(run: Run) -> np.ndarray:
    """Rotation of each link (n,) [rad]: the range of the components of its direction, which does not depend on its
    angles."""
    return np.ptp(directions(run), axis=0).max(axis=-1)


def directions(run: Run) -> np.ndarray:
    """Unit vector (k, n, 3) of each link."""
    links = run.positions[:, run.first + 1] - run.positions[:, run.first]
    length = np.linalg.norm(links, axis=-1, keepdims=True)
    return links / np.where(length > 0, length, 1.0)


def travel(run: Run) -> np.ndarray:
    """Displacement of each node (nodes,) [m]: the longest side of the box around its path."""
    return np.ptp(run.positions, axis=0).max(axis=-1)


def anything_moves(run: Run) -> bool:
    """Whether any node moves by more than rounding."""
    return bool(travel(run).max() > TRAVEL_ROUNDING * max(view.size(run.positions[:1]), 1e-300))


def chosen_links(run: Run, most: int) -> np.ndarray:
    """Links that have a panel, at most `most`, in order: evenly spaced in a single line; of many lines the links that
    move most."""
    size = swing(run)
    moving = np.flatnonzero(size > ANGLE_ROUNDING)
    if len(run.written_lines) == 1 or len(moving) <= most:
        return moving[np.unique(np.linspace(0, len(moving) - 1, min(len(moving), most)).round().astype(int))]
    best = np.array([line.links.start + int(np.argmax(size[line.links])) for line in run.written_lines])
    order = np.argsort(-size[best], kind="stable")[:most]
    return np.sort(best[order][size[best[order]] > ANGLE_ROUNDING])


def changing(columns: Iterable[np.ndarray], least: float) -> np.ndarray:
    """Which of n series (k, n) change by more than their limit in any of the columns (n,)."""
    with np.errstate(invalid="ignore"):
        return np.any([np.nan_to_num(np.ptp(values, axis=0)) > least for values in columns], axis=0)


class Float(NamedTuple):
    """An upright buoy: the node of its point, diameter and height [m], height of the point above its base [m]."""

    node: int
    diameter: float
    height: float
    attachment: float


class Run(Samples):
    """The samples of a solution that pictures show: k samples, all but the tension finite, and what they are drawn
    with."""

    @property
    def min_tension(self) -> np.ndarray:
        """(k, n) [N]; over the steps since the previous sample if not every step is saved, else the tension itself."""
        if self.tension_min is None:
            return self.tension
        return self.tension_min

    @property
    def max_tension(self) -> np.ndarray:
        """The same of the maximum."""
        if self.tension_max is None:
            return self.tension
        return self.tension_max

    @cached_property
    def point_names(self) -> dict[str, int]:
        """Nodes of the points by name."""
        return point_nodes(self.scene)

    @cached_property
    def fixed_nodes(self) -> tuple[int, ...]:
        """Nodes of the fixed points."""
        return tuple(self.point_names[name] for name in self.scene.fixed_points)

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Nodes of the free points."""
        return tuple(self.point_names[name] for name in self.scene.free_points)

    @cached_property
    def buoys(self) -> tuple[Float, ...]:
        return tuple(Float(self.point_names[b.point], b.diameter, b.height, b.attachment) for b in self.scene.buoys)

    @cached_property
    def bodies(self) -> Bodies | None:
        """The rigid bodies; None without any."""
        specs = self.scene.bodies
        if not specs or self.body_position is None or self.body_attitude is None:
            return None
        cylinders = []
        spheres = []
        for i, body in enumerate(specs):
            cylinders += [Shape(i, c.start, c.end, c.diameter) for c in body.cylinders]
            spheres += [Shape(i, s.centre, s.centre, s.diameter) for s in body.spheres]
        names = tuple(names_of(specs))
        return Bodies(names, (*cylinders, *spheres), self.body_position, self.body_attitude)

    @cached_property
    def first(self) -> np.ndarray:
        """First node of each link (n,); the next node is its last."""
        return first_nodes(self.scene)

    @property
    def peak(self) -> int:
        """The sample of the maximum tension, the last one if it is constant; that at the start belongs to no step."""
        # a failed run may end with any value
        largest = np.nan_to_num(self.max_tension[1:].max(axis=1), posinf=0.0, neginf=0.0)
        if len(largest) == 0 or np.ptp(largest) <= TENSION_ROUNDING * np.abs(largest).max():
            return len(largest)
        return 1 + int(np.argmax(largest))

    def sample(self, time: float | None) -> int:
        """The sample at a time [s], or that of the maximum tension."""
        if time is None:
            return self.peak
        return int(np.argmin(np.abs(self.t - time)))

    def segments(self, nodes: np.ndarray) -> np.ndarray:
        """Both ends of each link (n, 2, d) from the positions of all nodes (nodes, d)."""
        return np.stack([nodes[self.first], nodes[self.first + 1]], axis=1)

    @property
    def lengths(self) -> np.ndarray:
        """Lengths of the links (n,) [m] at the first sample."""
        start, end = np.swapaxes(self.segments(self.positions[0]), 0, 1)
        return np.linalg.norm(end - start, axis=-1)

    @property
    def written_lines(self) -> tuple[WholeLine, ...]:
        """The lines as in the scene, pieces between attached points together."""
        return whole_lines(self.scene)

    @property
    def labels(self) -> list[str]:
        """A name for each link: its number, with the name of its line if there are several."""
        if len(self.lines) == 1:
            return [f"link {j + 1}" for j in range(self.tension.shape[1])]
        found = []
        for line in self.lines:
            found += [f"{line.name} {j + 1}" for j in range(line.links.stop - line.links.start)]
        return found


def readable(solution: Samples) -> Run:
    """The run until it diverged or became non-finite, with at least its first sample, in double precision."""
    given = {field.name: getattr(solution, field.name) for field in dataclasses.fields(Samples)}
    moved = [np.asarray(given[name], float) for name in ("positions", "velocities", "kinetic", "potential", "work")]
    finite = np.all([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in moved], axis=0)
    positions = moved[0]
    # a run has diverged if a node is farther out than this many sizes of the first configuration
    far = 100.0 * max(view.size(positions[:1]), np.finfo(float).tiny)
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(positions - positions[0]).max(axis=(1, 2)) <= far
    last = max(1, int(np.argmin(np.append(finite & near, False))))
    for name in (*ARRAYS, *SOME):
        if given[name] is not None:
            given[name] = np.asarray(given[name][:last], float)
    return Run(**given)


def elevations(scene: Scene, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Elevation (q, n) [m] over positions (n, 3) [m] at times (q,) [s]."""
    return surface_over(scene, np.broadcast_to(positions, (len(times), *positions.shape)), times)
