"""The data of a solution for pictures, without samples that cannot be drawn."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.analysis.angles import angle_rates, link_angles
from dropper_jax.load.scene import Scene
from dropper_jax.plots.shapes import Bodies, bodies_of
from dropper_jax.run.build import build_model
from dropper_jax.run.simulate import Solution
from dropper_jax.scene import LineSlice, WholeLine, whole_lines
from dropper_jax.scene.data import point_nodes

#: A run has diverged if a node is farther out than this many sizes of the first configuration.
FARTHEST = 100.0


class Float(NamedTuple):
    """An upright buoy: the node of its point, diameter and height [m], height of the point above its base [m]."""

    node: int
    diameter: float
    height: float
    attachment: float


@dataclasses.dataclass(frozen=True)
class Run:
    """Arrays of a solution as in `dropper_jax.run.simulate.Solution`, k samples; all but the tension are finite.

    Attributes:
        lines: nodes and links of each line.
        scene: of a system of lines, with the water and the seabed in the pictures; None for a single line.
        held, joints: nodes of the fixed and of the free points of a system.
        buoys: its buoys.
        bodies: its rigid bodies; None without.
        point_names: nodes of a system's points by name.
        extremes: minimum and maximum tension (k, n) [N] since the previous sample, if steps adapt to snap loads.
        surface: of a single line in water, the elevation (q, n) [m] at positions (n, 3) and times (q,); else None.
    """

    name: str
    integrator: str
    dt: float
    status: str
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    tension: np.ndarray
    t_tension: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    work_names: tuple[str, ...]
    lines: tuple[LineSlice, ...]
    scene: Scene = None
    held: tuple[int, ...] = ()
    joints: tuple[int, ...] = ()
    buoys: tuple[Float, ...] = ()
    bodies: Bodies | None = None
    point_names: dict[str, int] = dataclasses.field(default_factory=dict)
    extremes: tuple[np.ndarray, np.ndarray] | None = None
    surface: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    @property
    def max_tension(self) -> np.ndarray:
        """Maximum tension (k, n) [N] of each sample."""
        return self.tension if self.extremes is None else self.extremes[1]

    @property
    def min_tension(self) -> np.ndarray:
        """Minimum tension (k, n) [N] of each sample."""
        return self.tension if self.extremes is None else self.extremes[0]

    @property
    def first(self) -> np.ndarray:
        """First node of each link (n,); the next node is its last."""
        return np.concatenate([np.arange(line.nodes.start, line.nodes.stop - 1) for line in self.lines])

    def segments(self, nodes: np.ndarray) -> np.ndarray:
        """Both ends of each link (n, 2, d) from the positions of all nodes (nodes, d)."""
        return np.stack([nodes[self.first], nodes[self.first + 1]], axis=1)

    @property
    def written_lines(self) -> tuple[LineSlice | WholeLine, ...]:
        """The lines as in the scene, pieces between attached points together."""
        return self.lines if self.scene is None else whole_lines(self.scene)

    @property
    def labels(self) -> list[str]:
        """A name for each link: its number, with the name of its line if there are several."""
        if len(self.lines) == 1:
            return [f"link {j + 1}" for j in range(self.tension.shape[1])]
        return [f"{line.name} {j + 1}" for line in self.lines for j in range(line.links.stop - line.links.start)]

    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Polar angle from the horizontal and azimuth of each link (k, n) [rad]."""
        parts = [link_angles(self.positions[:, line.nodes]) for line in self.lines]
        return tuple(np.concatenate(found, axis=1) for found in zip(*parts, strict=True))

    def angle_rates(self) -> tuple[np.ndarray, np.ndarray]:
        """Rates of the angles (k, n) [rad/s]."""
        parts = [angle_rates(self.positions[:, line.nodes], self.velocities[:, line.nodes]) for line in self.lines]
        return tuple(np.concatenate(found, axis=1) for found in zip(*parts, strict=True))


def readable(solution: Solution) -> Run:
    """The run until it diverged or became non-finite, with at least its first sample."""
    moved = [np.asarray(getattr(solution, name), float) for name in ("positions", "velocities", "kinetic", "potential")]
    work = np.asarray(solution.work, float).reshape(len(solution.t), -1)
    finite = np.all([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in (*moved, work)], axis=0)
    first = moved[0][0]
    far = FARTHEST * max(float(np.ptp(first, axis=0).max()), np.finfo(float).tiny)
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(moved[0] - first).max(axis=(1, 2)) <= far
    good = np.append(finite & near, False)
    last = max(1, int(np.argmin(good)))
    positions, velocities, kinetic, potential = (a[:last] for a in moved)
    return Run(
        name=solution.scene.name,
        integrator=str(solution.settings["integrator"]),
        dt=float(solution.settings["dt"]),
        status=str(solution.status),
        t=np.asarray(solution.t, float)[:last],
        positions=positions,
        velocities=velocities,
        tension=np.asarray(solution.tension, float)[:last],
        t_tension=np.asarray(solution.t_tension, float)[:last],
        kinetic=kinetic,
        potential=potential,
        work=work[:last],
        work_names=tuple(solution.work_names),
        extremes=_extremes(solution, last),
        bodies=bodies_of(solution, last),
        **_lines(solution),
    )


def _extremes(solution: Solution, last: int) -> tuple[np.ndarray, np.ndarray] | None:
    least, largest = (getattr(solution, name, None) for name in ("tension_min", "tension_max"))
    return None if least is None or largest is None else (least[:last], largest[:last])


def elevations(scene: Scene, positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Elevation (q, n) [m] of a scene's sea at positions (n, 3) and times (q,)."""
    sea = build_model(scene, "float64").sea
    return np.asarray(jax.jit(jax.vmap(sea.elevation, (None, 0)))(jnp.asarray(positions), jnp.asarray(times)))


def _lines(solution: Solution) -> dict[str, Any]:
    """The lines and, for a system, their points."""
    if not getattr(solution.scene, "branched", False):
        links = solution.tension.shape[1]
        single = {"lines": (LineSlice("line", slice(0, links + 1), slice(0, links)),)}
        wet = getattr(solution.scene, "sea", None) is not None
        return {**single, "surface": partial(elevations, solution.scene)} if wet else single
    scene, node = solution.scene, point_nodes(solution.scene)
    return {
        "lines": solution.lines,
        "scene": scene,
        "point_names": node,
        "held": tuple(node[p.name] for p in scene.points if p.kind == "fixed"),
        "joints": tuple(node[p.name] for p in scene.points if p.kind != "fixed"),
        "buoys": tuple(Float(node[b.point], b.diameter, b.height, b.attachment) for b in scene.buoys),
    }
