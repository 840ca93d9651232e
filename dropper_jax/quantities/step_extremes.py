"""Extremes over all steps of a run that saves fewer states: tensions, forces on end points and on fixed points.

The signals are computed after every step in the compiled run (`stepping.extremes`); arrays of a solution are made from
the rows of the run here.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.quantities.end_links import (
    EndLinks,
    Motion,
    end_forces_of_model,
    ends_of,
    line_ends,
    load_vectors,
    loaded_fixed_points,
)
from dropper_jax.quantities.variables import STEP_SIGNALS
from dropper_jax.scene import whole_lines
from dropper_jax.stepping.extremes import Extremes

#: Components of the force of the lines on a fixed point.
LOADS = ("horizontal", "vertical", "total")


@dataclass(frozen=True)
class StepSignals:
    """Computes the signals (m,) [N] of a step: tensions of links, forces on line ends, loads of fixed points.

    They are those of `end_links.Motion.end_force` and `end_links.point_loads`, at the time of the step's tension.

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

    def __call__(self, model: Model, before: State, after: State) -> tuple[Array, Array]:
        """The signals (m,) of a step, and their time [s]."""
        fraction = self.tension_time
        t = before.t + fraction * (after.t - before.t)
        # linear over the step, as `interpolate_rows` between saved times
        first = model.geometry.everywhere(before.r, model.ends(before.t).positions)
        last = model.geometry.everywhere(after.r, model.ends(after.t).positions)
        links = np.array(self.links)
        is_first = np.arange(len(links)) < len(links) // 2  # the first half of the end links are first links of lines
        nodes = first + fraction * (last - first)
        forces = end_forces_of_model(model, links, is_first, nodes, after.tension, t)
        signals = [after.tension, safe_norm(forces)[np.array(self.whole)]]
        if self.points:
            load = jnp.stack([jnp.sum(forces[np.array(ends_there)], axis=0) for ends_there in self.points])
            signals.append(jnp.stack([horizontal_norm(load), load[:, 2], safe_norm(load)], axis=1).ravel())
        return jnp.concatenate(signals), t


jax.tree_util.register_static(StepSignals)


def step_signals(scene: Scene, tension_time: float) -> StepSignals | None:
    """The signals of a run whose saved states are farther apart than its steps; None if every step is saved."""
    if scene.run.save_every == 1 and scene.run.accuracy is None:
        return None
    ends = list(line_ends(scene))
    ends = [*ends[::2], *ends[1::2]]
    numbers = {(end.link, end.last): i for i, (_, end) in enumerate(ends)}
    whole = []
    for line in whole_lines(scene):
        whole += [numbers[end.link, end.last] for end in ends_of(line)]
    points = []
    for point in loaded_fixed_points(scene):
        points.append(tuple(i for i, (name, _) in enumerate(ends) if name == point))
    links = tuple(end.link for _, end in ends)
    return StepSignals(links, tuple(whole), tuple(points), float(tension_time))


def saved_signal(signal: str, motion: Motion) -> np.ndarray:
    """One of the `STEP_SIGNALS` at the saved times: (k, n), (k, lines, 2) or (k, fixed points, 3) [N]."""
    if signal == "tension":
        return motion.tension
    with np.errstate(invalid="ignore", over="ignore"):  # a failed run may end with infinite positions
        if signal == "end_force":
            return _end_force_sizes(motion)
        return load_components(load_vectors(motion))


def _end_force_sizes(motion: Motion) -> np.ndarray:
    """Forces of the lines on their end points (k, lines, 2) [N]."""
    links = EndLinks(motion.scene)
    sizes = []
    for line in whole_lines(motion.scene):
        for end in ends_of(line):
            sizes.append(np.linalg.norm(motion.end_force(links, end), axis=1))
    return np.stack(sizes, axis=1).reshape(len(motion.tension), -1, 2)


def load_components(vectors: np.ndarray) -> np.ndarray:
    """The components `LOADS` (..., 3) [N] of forces (..., 3)."""
    horizontal = np.hypot(vectors[..., 0], vectors[..., 1])
    return np.stack([horizontal, vectors[..., 2], np.linalg.norm(vectors, axis=-1)], axis=-1)


def extremes_by_signal(scene: Scene, extremes: Extremes) -> dict[str, Extremes]:
    """Rows (k, m) of the run by signal, each (k, n), (k, lines, 2) or (k, fixed points, 3)."""
    shapes = {
        "tension": (scene.line.links,),
        "end_force": (len(whole_lines(scene)), 2),
        "point_load": (len(loaded_fixed_points(scene)), len(LOADS)),
    }
    by_signal = {}
    first = 0
    for signal in STEP_SIGNALS:
        shape = shapes[signal]
        columns = slice(first, first + int(np.prod(shape)))
        rows = [np.asarray(array)[:, columns].reshape(len(array), *shape) for array in extremes]
        by_signal[signal] = Extremes(*rows)
        first = columns.stop
    return by_signal
