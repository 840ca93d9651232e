"""Extremes over all steps of a run that saves fewer states: tensions, forces on end points and on fixed points.

The signals are computed after every step in the compiled run (`stepping.extremes`); arrays of a solution are made from
the rows of the run here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.run.bends import held_points, point_load
from dropper_jax.run.end_links import EndLinks, end_forces_of_model, ends_of
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import line_slices, whole_lines
from dropper_jax.stepping.extremes import Extremes

#: Signals whose extremes a run keeps, in this order, and the arrays of each.
SIGNALS = ("tension", "end_force", "point_load")
ARRAYS_OF = ("min", "max", "min_time", "max_time")
#: Names of the arrays of a solution.
STEP_EXTREMES = tuple(f"{signal}_{name}" for signal in SIGNALS for name in ARRAYS_OF)
#: Components of the force of the lines on a fixed point.
LOADS = ("horizontal", "vertical", "total")


@dataclass(frozen=True)
class StepSignals:
    """Signals (m,) of a step: tensions of the links, forces on the end points of lines, loads of fixed points, in N.

    They are those of `growth.end_forces` and `bends.point_load`, at the time of the step's tension.

    Attributes:
        links: end links (2 lines,), the first and then the last of each of the scene's lines.
        whole: ends of the lines as the user wrote them, first and last in turn.
        points: ends at each fixed point.
        tension_time: fraction of the step at which its tension is.
    """

    links: tuple[int, ...]
    whole: tuple[int, ...]
    points: tuple[tuple[int, ...], ...]
    tension_time: float

    def __call__(self, model: Model, before: State, after: State) -> tuple[jax.Array, jax.Array]:
        share = self.tension_time
        t = before.t + share * (after.t - before.t)
        # linear over the step, as `end_links.positions_at` between saved times
        first = model.geometry.everywhere(before.r, model.ends(before.t).positions)
        last = model.geometry.everywhere(after.r, model.ends(after.t).positions)
        links = np.array(self.links)
        starts = np.arange(len(links)) < len(links) // 2
        forces = end_forces_of_model(model, links, starts, first + share * (last - first), after.tension, t)
        found = [after.tension, safe_norm(forces)[np.array(self.whole)]]
        if self.points:
            load = jnp.stack([jnp.sum(forces[np.array(own)], axis=0) for own in self.points])
            found.append(jnp.stack([horizontal_norm(load), load[:, 2], safe_norm(load)], axis=1).ravel())
        return jnp.concatenate(found), t


jax.tree_util.register_static(StepSignals)


def step_signals(scene: Scene, tension_time: float) -> StepSignals | None:
    """The signals of a run whose saved states are farther apart than its steps; None if every step is saved."""
    if scene.run.save_every == 1 and scene.run.accuracy is None:
        return None
    slices = line_slices(scene)
    first = [where.links.start for where in slices]
    last = [where.links.stop - 1 for where in slices]
    lines = [line.links for line in whole_lines(scene)]
    whole = [(first.index(own.start), len(first) + last.index(own.stop - 1)) for own in lines]
    names = [line.start for line in scene.lines] + [line.end for line in scene.lines]
    points = []
    for point in held_points(scene):
        points.append(tuple(i for i, name in enumerate(names) if name == point))
    return StepSignals((*first, *last), tuple(chain.from_iterable(whole)), tuple(points), float(tension_time))


def saved_signal(
    signal: str,
    scene: Scene,
    t: np.ndarray,
    positions: np.ndarray,
    t_tension: np.ndarray,
    tension: np.ndarray,
) -> np.ndarray:
    """One of the `SIGNALS` at the saved times: (k, n), (k, lines, 2) or (k, fixed points, 3) [N]."""
    if signal == "tension":
        return tension
    with np.errstate(invalid="ignore", over="ignore"):  # a failed run may end with infinite positions
        if signal == "end_force":
            return _end_forces(scene, t, positions, t_tension, tension)
        loads = [point_load(scene, name, t, positions, t_tension, tension) for name in held_points(scene)]
        if loads:
            vectors = np.stack(loads, axis=1)
        else:
            vectors = np.zeros((len(tension), 0, 3))
        parts = np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2], np.linalg.norm(vectors, axis=-1)
        return np.stack(parts, axis=-1)


def _end_forces(
    scene: Scene, t: np.ndarray, positions: np.ndarray, t_tension: np.ndarray, tension: np.ndarray
) -> np.ndarray:
    """Forces (k, lines, 2) [N] of the lines on their points, from the nodes of the end links alone: the positions of a
    run may be larger than memory."""
    links = EndLinks(overgrown(scene))
    found = []
    for line in whole_lines(scene):
        for end in ends_of(line):
            found.append(np.linalg.norm(links.force_between(end, t, positions, t_tension, tension), axis=1))
    return np.stack(found, axis=1).reshape(len(tension), -1, 2)


def extremes_by_signal(scene: Scene, extremes: Extremes) -> dict[str, Extremes]:
    """Rows (k, m) of the run by signal, each (k, n), (k, lines, 2) or (k, fixed points, 3)."""
    shapes = signal_shapes(scene)
    cuts = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])[:-1]
    parts = zip(*(np.split(np.asarray(rows), cuts, axis=1) for rows in extremes), strict=True)
    found = {}
    for (signal, shape), own in zip(shapes.items(), parts, strict=True):
        found[signal] = Extremes(*(rows.reshape(len(rows), *shape) for rows in own))
    return found


def signal_shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """The shape of each of the `SIGNALS` at one time."""
    lines = len(whole_lines(scene))
    points = len(held_points(scene))
    return {"tension": (scene.line.links,), "end_force": (lines, 2), "point_load": (points, len(LOADS))}
