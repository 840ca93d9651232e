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
from dropper_jax.run.end_links import (
    EndLinks,
    Motion,
    end_forces_of_model,
    ends_of,
    line_ends,
    loaded_fixed_points,
    point_loads,
)
from dropper_jax.run.variables import SIGNALS
from dropper_jax.scene import whole_lines
from dropper_jax.stepping.extremes import Extremes

#: Components of the force of the lines on a fixed point.
LOADS = ("horizontal", "vertical", "total")


@dataclass(frozen=True)
class StepSignals:
    """Signals (m,) of a step: tensions of the links, forces on the end points of lines, loads of fixed points, in N.

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
        share = self.tension_time
        t = before.t + share * (after.t - before.t)
        # linear over the step, as `interpolate_rows` between saved times
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
    ends = list(line_ends(scene))
    ends = [*ends[::2], *ends[1::2]]
    links = [(end.link, end.last) for _, end in ends]
    whole = []
    for line in whole_lines(scene):
        whole += [links.index((end.link, end.last)) for end in ends_of(line)]
    points = []
    for point in loaded_fixed_points(scene):
        points.append(tuple(i for i, (name, _) in enumerate(ends) if name == point))
    return StepSignals(tuple(link for link, _ in links), tuple(whole), tuple(points), float(tension_time))


def saved_signal(signal: str, motion: Motion) -> np.ndarray:
    """One of the `SIGNALS` at the saved times: (k, n), (k, lines, 2) or (k, fixed points, 3) [N]."""
    if signal == "tension":
        return motion.tension
    scene = motion.scene
    with np.errstate(invalid="ignore", over="ignore"):  # a failed run may end with infinite positions
        if signal == "end_force":
            links = EndLinks(scene)
            sizes = []
            for line in whole_lines(scene):
                for end in ends_of(line):
                    sizes.append(np.linalg.norm(motion.end_force(links, end), axis=1))
            return np.stack(sizes, axis=1).reshape(len(motion.tension), -1, 2)
        loads = point_loads(motion)
        vectors = np.zeros((len(motion.tension), 0, 3))
        if names := loaded_fixed_points(scene):
            vectors = np.stack([loads[name] for name in names], axis=1)
        parts = np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2], np.linalg.norm(vectors, axis=-1)
        return np.stack(parts, axis=-1)


def extremes_by_signal(scene: Scene, extremes: Extremes) -> dict[str, Extremes]:
    """Rows (k, m) of the run by signal, each (k, n), (k, lines, 2) or (k, fixed points, 3)."""
    shapes = ((scene.line.links,), (len(whole_lines(scene)), 2), (len(loaded_fixed_points(scene)), len(LOADS)))
    found = {}
    first = 0
    for signal, shape in zip(SIGNALS, shapes, strict=True):
        own = slice(first, first + int(np.prod(shape)))
        found[signal] = Extremes(*(np.asarray(rows)[:, own].reshape(len(rows), *shape) for rows in extremes))
        first = own.stop
    return found
