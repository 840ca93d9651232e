"""Solve for a design value: the line length, buoyancy or stiffness that gives a required static tension or depth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.run.build import SceneLike, build_model, equilibrium
from dropper_jax.run.growth import overgrown
from dropper_jax.run.quantities import static_quantity
from dropper_jax.run.weights import end_forces
from dropper_jax.scene import line_slices


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
        target: a quantity without its statistic (see `run.quantities`): `tension.LINE.first`, `.last`, `.fairlead` or
            `.max` [N], `anchor.POINT.horizontal` [N], `depth.POINT` [m] below z = 0, `offset.POINT` [m].
        goal: the value of the target.

    Root finding on the statics (Brent's method: secant steps within the interval). Every evaluation solves the full
    equilibrium, so slack lines and contact may change during the search.

    Raises:
        SceneError: an unknown target, no equilibrium, or a target that does not reach the required value.
    """
    scene = load_scene(scene)
    wanted = static_quantity(target, bare_model(overgrown(scene)), "target")
    seen: dict[float, float] = {}

    def miss(value: float) -> float:
        if value not in seen:
            changed = scene.with_values({path: value})
            model = build_model(changed)
            pose = static_pose(changed, model)
            if pose.status != "ok":
                raise SceneError(f"{path}: {value:g} has no equilibrium: {pose.message}")
            seen[value] = float(wanted.of_pose(model, pose.state))
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
    kind, name, *_ = *target.split("."), ""
    if kind != "tension":
        return None
    pose = equilibrium(scene)
    arrays = np.asarray(pose.positions)[None], np.asarray(pose.tension)[None]
    found = {**end_forces(scene, *arrays, line_slices(scene)), **end_forces(scene, *arrays)}
    return tuple(found[name][0].tolist()) if name in found else None
