"""Solve for a design value: the line length, buoyancy or stiffness that gives a required static tension or depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.run.build import SceneLike, equilibrium
from dropper_jax.run.weights import end_forces
from dropper_jax.scene import line_slices, whole_lines
from dropper_jax.statics.search import Equilibrium


@dataclass(frozen=True)
class Design:
    """A solved design.

    Attributes:
        path, value: the solved value of the scene, in its own unit.
        target, requested, reached: the target quantity, its required and its reached value, [N] or [m].
        solves: number of equilibria solved.
        scene: the scene with the value set.
        end_forces: of a tension's line, the forces [N] on its first and last point, which a link's tension is not.
    """

    path: str
    value: float
    target: str
    requested: float
    reached: float
    solves: int
    scene: Scene
    end_forces: tuple[float, float] | None = None


def solve_design(scene: SceneLike, path: str, low: float, high: float, target: str, goal: float) -> Design:
    """The value of `path` between `low` and `high` that gives a static quantity its required value.

    Args:
        scene: anything that `load_scene` takes.
        path: of one number of the scene, such as `line.0.length` or `point.float.volume`.
        target: `tension.LINE.first`, `tension.LINE.last` or `tension.LINE.max` [N], or `depth.POINT` [m] below z = 0.
        goal: the value of the target.

    Root finding on the statics (Brent's method: secant steps within the interval). Every evaluation solves the full
    equilibrium, so slack lines and contact may change during the search.

    Raises:
        SceneError: an unknown target, no equilibrium, or a target that does not reach the required value.
    """
    scene = load_scene(scene)
    measure = _measure(scene, target)
    seen: dict[float, float] = {}

    def miss(value: float) -> float:
        if value not in seen:
            changed = scene.with_values({path: value})
            pose = equilibrium(changed)
            if pose.status != "ok":
                raise SceneError(f"{path}: {value:g} has no equilibrium: {pose.message}")
            seen[value] = float(measure(changed, pose))
        return seen[value] - goal

    ends = miss(low), miss(high)
    if ends[0] * ends[1] > 0:
        raise SceneError(
            f"{path}: {low:g} to {high:g} gives {target} from {ends[0] + goal:.6g} to {ends[1] + goal:.6g}, which "
            f"does not include {goal:g}. Use a range whose ends are on either side"
        )
    # relative change of the value at which the search stops
    value = brentq(miss, low, high, xtol=1e-9 * max(abs(low), abs(high)), rtol=4 * np.finfo(float).eps)
    reached, changed = miss(value) + goal, scene.with_values({path: value})
    return Design(path, value, target, goal, reached, len(seen), changed, _end_forces(changed, target))


def _end_forces(scene: Scene, target: str) -> tuple[float, float] | None:
    kind, _, rest = target.partition(".")
    if kind != "tension":
        return None
    pose, name = equilibrium(scene), rest.rpartition(".")[0]
    arrays = np.asarray(pose.positions)[None], np.asarray(pose.tension)[None]
    found = {**end_forces(scene, *arrays, line_slices(scene)), **end_forces(scene, *arrays)}
    return tuple(found[name][0].tolist())


def _measure(scene: Scene, target: str) -> Callable[[Scene, Equilibrium], float]:
    kind, _, rest = target.partition(".")
    if kind == "depth":
        names = [p.name for p in scene.points]
        if rest not in names:
            raise SceneError(f"target: {rest!r} is not a point; {nearest(rest, names)}")
        return lambda changed, pose: -_point_height(changed, pose, rest)
    line, _, part = rest.rpartition(".")
    picks = {"first": lambda t: t[0], "last": lambda t: t[-1], "max": np.max}
    if kind != "tension" or part not in picks:
        raise SceneError(f"target: {target!r} is unknown; allowed: tension.LINE.first, .last or .max, depth.POINT")
    if line not in _links(scene):
        raise SceneError(f"target: {line!r} is not a line; {nearest(line, _links(scene))}")
    return lambda changed, pose: picks[part](pose.tension[_links(changed)[line]])


def _links(scene: Scene) -> dict[str, slice]:
    """Indices of the links of each line, by the name of the line or of one of its pieces."""
    return {where.name: where.links for where in (*line_slices(scene), *whole_lines(scene))}


def _point_height(scene: Scene, pose: Equilibrium, name: str) -> float:
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        for point, node in ((line.start, where.nodes.start), (line.end, where.nodes.stop - 1)):
            if point == name:
                return float(pose.positions[node, 2])
    raise SceneError(f"target: point {name!r} is not an end of a line")
