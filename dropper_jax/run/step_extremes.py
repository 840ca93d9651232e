"""Extremes over all steps of a run that saves fewer states: tensions, forces on end points and on fixed points.

The signals are computed after every step in the compiled run (`stepping.extremes`); arrays of a solution are made from
the rows of the run here.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component, option
from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model, State
from dropper_jax.run.bends import held_points, point_load, positions_at
from dropper_jax.run.growth import carried_weight, end_forces, end_weights
from dropper_jax.scene import line_slices, whole_lines
from dropper_jax.stepping.extremes import Extremes

#: Signals whose extremes a run keeps, in this order, and the arrays of each.
SIGNALS = ("tension", "end_force", "point_load")
ARRAYS_OF = ("min", "max", "min_time", "max_time")
#: Names of the arrays of a solution.
STEP_EXTREMES = tuple(f"{signal}_{name}" for signal in SIGNALS for name in ARRAYS_OF)
#: Components of the force of the lines on a fixed point.
LOADS = ("horizontal", "vertical", "total")


@component
class StepSignals:
    """Signals (m,) of a step: tensions of the links, forces on the end points of lines, loads of fixed points, in N.

    They are those of `growth.end_forces` and `bends.point_load`, at the time of the step's tension.

    Attributes:
        weights: of the parts of the end links that belong to their points (2 lines,) [N], first ends and then last ends
            of the scene's lines.
        nodes, inner, links: the ends' nodes, the next nodes and the end links.
        whole: ends of the lines as the user wrote them, first and last in turn.
        points: ends at each fixed point.
        tension_time: fraction of the step at which its tension is.
    """

    weights: jax.Array
    nodes: tuple[int, ...] = option("nodes of the ends")
    inner: tuple[int, ...] = option("nodes next to them")
    links: tuple[int, ...] = option("end links")
    whole: tuple[int, ...] = option("ends of the lines as written")
    points: tuple[tuple[int, ...], ...] = option("ends at each fixed point")
    tension_time: float = option("fraction of the step")

    def __call__(self, model: Model, before: State, after: State) -> tuple[jax.Array, jax.Array]:
        share = self.tension_time
        # linear over the step, as `bends.positions_at` between saved times
        first, last = (model.nodes(s.r, model.ends(s.t)) for s in (before, after))
        nodes = first + share * (last - first)
        at = nodes[np.array(self.nodes)]
        along = nodes[np.array(self.inner)] - at
        size = safe_norm(along)[:, None]
        force = after.tension[np.array(self.links)][:, None] * along / jnp.where(size > 0.0, size, 1.0)
        loads = [jnp.sum(force[np.array(own)], axis=0) for own in self.points]
        bed = model.effect("seabed")
        height = None if bed is None else bed.bed_height(at, rounded=0.0)
        carried = carried_weight(jnp, self.weights, force, at, height)
        ends = safe_norm(force.at[:, 2].add(-carried))[np.array(self.whole)]
        found = [after.tension, ends]
        if loads:
            load = jnp.stack(loads)
            found.append(jnp.stack([horizontal_norm(load), load[:, 2], safe_norm(load)], axis=1).ravel())
        return jnp.concatenate(found), before.t + share * (after.t - before.t)


def step_signals(scene: Scene, tension_time: float) -> StepSignals | None:
    """The signals of a run whose saved states are farther apart than its steps; None if every step is saved."""
    run = scene.run
    if run.save_every == 1 and run.step_tolerance is None:
        return None
    lines, slices = scene.lines, line_slices(scene)
    first = [(where.nodes.start, where.nodes.start + 1, where.links.start) for where in slices]
    last = [(where.nodes.stop - 1, where.nodes.stop - 2, where.links.stop - 1) for where in slices]
    nodes, inner, links = zip(*first, *last, strict=True)
    whole = [end for line in whole_lines(scene) for end in _whole_ends(line.links, first, last)]
    names = [line.start for line in lines] + [line.end for line in lines]
    points = [tuple(i for i, name in enumerate(names) if name == point) for point in held_points(scene)]
    weights = jnp.asarray(end_weights(scene).T.ravel(), scene.run.dtype)
    return StepSignals(weights, nodes, inner, links, tuple(whole), tuple(points), float(tension_time))


def _whole_ends(links: slice, first: list[tuple[int, ...]], last: list[tuple[int, ...]]) -> tuple[int, int]:
    """Numbers of the ends of a line with these links among the first and last ends of the scene's lines."""
    start = [link for *_, link in first].index(links.start)
    end = [link for *_, link in last].index(links.stop - 1)
    return start, len(first) + end


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
            forces = end_forces(scene, positions_at(t, positions, t_tension), tension)
            return np.stack(list(forces.values()), axis=1)
        loads = [point_load(scene, name, t, positions, t_tension, tension) for name in held_points(scene)]
        vectors = np.stack(loads, axis=1) if loads else np.zeros((len(tension), 0, 3))
        parts = np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2], np.linalg.norm(vectors, axis=-1)
        return np.stack(parts, axis=-1)


def extremes_by_signal(scene: Scene, extremes: Extremes) -> dict[str, Extremes]:
    """Rows (k, m) of the run by signal, each (k, n), (k, lines, 2) or (k, fixed points, 3)."""
    shapes = signal_shapes(scene)
    cuts = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])[:-1]
    parts = zip(*(np.split(np.asarray(rows), cuts, axis=1) for rows in extremes), strict=True)
    return {
        signal: Extremes(*(rows.reshape(len(rows), *shape) for rows in own))
        for (signal, shape), own in zip(shapes.items(), parts, strict=True)
    }


def signal_shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    """The shape of each of the `SIGNALS` at one time."""
    links, lines, points = sum(line.links for line in scene.lines), len(whole_lines(scene)), len(held_points(scene))
    return {"tension": (links,), "end_force": (lines, 2), "point_load": (points, len(LOADS))}
