"""The data of a solution for pictures: its valid samples, and what they are drawn with."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.load.surface import surface_over
from dropper_jax.plots import view
from dropper_jax.plots.body_shapes import Bodies, Shape
from dropper_jax.quantities.variables import ARRAYS, SOME
from dropper_jax.run.samples import Samples
from dropper_jax.scene import WholeLine, whole_lines
from dropper_jax.scene.slices import first_nodes, link_differences, point_nodes
from dropper_jax.sea.spec import SeaSpec

#: Change of tensions relative to the maximum up to which it is rounding.
TENSION_ROUNDING = 1e-6


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
    def max_tension(self) -> np.ndarray:
        """(k, n) [N]; over the steps since the previous sample if not every step is saved, else the tension itself."""
        return self.tension_range[1]

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
        return np.linalg.norm(link_differences(self.scene, self.positions[:1])[0], axis=-1)

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


def sea_of(run: Run) -> SeaSpec:
    """The water of the scene of a run."""
    if run.scene.sea is None:
        raise ValueError(f"solution: scene {run.scene.name!r} has no [sea]. Use a scene with water")
    return run.scene.sea
