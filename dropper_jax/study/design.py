"""Values of a scene that give static quantities their required values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import brentq, least_squares

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import SceneLike, build_model, equilibrium
from dropper_jax.modelling.growth import overgrown
from dropper_jax.modelling.model_slopes import model_slopes, shift_model
from dropper_jax.modelling.scene_model import bare_model, static_pose
from dropper_jax.quantities.end_forces import end_angles, end_forces
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_names import static_quantity
from dropper_jax.scene import line_slices, whole_lines
from dropper_jax.statics.loads import release_loads
from dropper_jax.statics.static_pose import settle


@dataclass(frozen=True)
class Design:
    """A solved design.

    Attributes:
        values: the solved values of the scene by path, each in its own unit.
        targets: required and reached value of each target quantity.
        status: `ok`, or `not_reached` with its `message`.
        solves: number of equilibria solved.
        scene: the scene with the values set.
        end_forces, end_angles: of the line of the first target, a tension: the forces [N] on its first and last point,
            which a link's tension is not, and the angles of the line there above the horizontal [deg].
    """

    values: dict[str, float]
    targets: dict[str, tuple[float, float]]
    status: str
    message: str
    solves: int
    scene: Scene
    end_forces: tuple[float, ...] | None = None
    end_angles: tuple[float, ...] | None = None

    @property
    def value(self) -> float:
        """The first solved value."""
        return next(iter(self.values.values()))


#: Relative miss above which a target counts as not reached. A root between two ends is as near as numbers allow, unless
#: the quantity jumps over its required value.
MAX_MISS = 1e-6
MAX_JUMP = 1e-3


def solve_design(
    scene: SceneLike,
    path: str | Sequence[str],
    low: float | Sequence[float],
    high: float | Sequence[float],
    target: str | Sequence[str],
    goal: float | Sequence[float],
    progress: Progress = silent,
) -> Design:
    """Values of the scene between `low` and `high` that give static quantities their required values.

    Args:
        scene: anything that `load_scene` takes.
        path: of one number of the scene, such as `line.0.length` or `point.float.volume`, or paths (p,).
        low, high: their ranges (p,).
        target: a quantity without its statistic (see `quantities.quantity_names`): `tension.LINE.first`, `.last`,
            `.fairlead` or `.max` [N], `anchor.POINT.horizontal` [N], `line.LINE.fairlead.angle` [rad],
            `depth.POINT` [m] below z = 0, `offset.POINT` [m], `period.1` [s]; or as many as there are paths.
        goal: the values of the targets.
        progress: gets a fraction, which approaches 1, and the number of poses after each static pose.

    One value is found by root finding on the statics (Brent's method: secant steps within the interval), several by
    Gauss-Newton steps in a trust region within their ranges, from the middle of these (Branch, Coleman and Li 1999,
    `scipy.optimize.least_squares`), with derivatives by the implicit function theorem. Every evaluation solves the full
    equilibrium, so slack lines and contact may change during the search.

    Raises:
        SceneError: unknown or repeated paths and targets, numbers of both that differ, no equilibrium, a single target
            that does not reach its required value, or targets that do not determine the values.
    """
    paths = [path] if isinstance(path, str) else list(path)
    names = [target] if isinstance(target, str) else list(target)
    lows, highs, goals = (np.atleast_1d(np.asarray(given, float)) for given in (low, high, goal))
    _check_design(paths, names, lows, highs, goals)
    search = _DesignSearch(load_scene(scene), paths, names, goals, progress)
    if len(paths) == 1:
        x = search.find_root(*lows, *highs)
        message = search.missed_target(x, lows, highs, MAX_JUMP)
    else:
        x = search.solve_together(lows, highs)
        message = search.missed_target(x, lows, highs, MAX_MISS)
    status = "not_reached" if message else "ok"
    reached = search.pose(x).reached
    solved = search.at(x)
    forces, angles = _ends_of(solved, names[0])
    return Design(
        values=dict(zip(paths, x.tolist(), strict=True)),
        targets=dict(zip(names, zip(goals.tolist(), reached.tolist(), strict=True), strict=True)),
        status=status,
        message=message,
        solves=len(search.poses),
        scene=solved,
        end_forces=forces,
        end_angles=angles,
    )


def _check_design(paths: list[str], names: list[str], lows: np.ndarray, highs: np.ndarray, goals: np.ndarray) -> None:
    """Reject numbers of values and targets that differ, repeated ones, and empty ranges."""
    if len(set(map(len, (paths, lows, highs, names, goals)))) > 1:
        raise SceneError(
            f"design: {len(paths)} values for {len(names)} targets with {len(goals)} goals; allowed: as many"
        )
    for what, given in (("vary", paths), ("target", names)):
        if len(set(given)) < len(given):
            raise SceneError(f"{what}: {', '.join(given)}: the same twice; allowed: each once")
    for name, start, end in zip(paths, lows, highs, strict=True):
        if not start < end:
            raise SceneError(f"vary: {name}: {start:g} to {end:g} is an empty range; allowed: LOW < HIGH")
    for name, goal in zip(names, goals, strict=True):
        if not np.isfinite(goal):
            raise SceneError(f"value: {goal:g} of {name} is not finite; allowed: a finite number")


#: Fraction of the progress that is left after each pose: a search takes about ten, but no fixed number.
PER_POSE = 0.9
#: Relative change of the value at which the search stops.
VALUE_TOLERANCE = 1e-9
#: Ratio of singular values below which derivatives with errors of 1e-10 determine no combination.
UNDETERMINED_RATIO = 1e-8


class _Pose(NamedTuple):
    """Model, static pose and quantities (p,)."""

    model: Model
    state: State
    reached: np.ndarray


@dataclass
class _DesignSearch:
    """Static quantities of a scene as functions of some of its numbers, each equilibrium solved once."""

    scene: Scene
    paths: list[str]
    names: list[str]
    goals: np.ndarray
    progress: Progress
    poses: dict[tuple[float, ...], _Pose] = field(default_factory=dict)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        model = bare_model(overgrown(self.scene))
        return tuple(static_quantity(name, model, "target") for name in self.names)

    def at(self, x: np.ndarray | list[float]) -> Scene:
        return self.scene.with_values(dict(zip(self.paths, map(float, x), strict=True)))

    def pose(self, x: np.ndarray | list[float]) -> _Pose:
        """The pose for values (p,)."""
        key = tuple(map(float, x))
        if key not in self.poses:
            changed = self.at(x)
            model = build_model(changed)
            pose = static_pose(changed, model)
            values = ", ".join(f"{path} = {value:g}" for path, value in zip(self.paths, key, strict=True))
            if pose.status != "ok":
                raise SceneError(f"{values} has no equilibrium: {pose.message}")
            reached = np.array([float(q.of_pose(model, pose.state)) for q in self.quantities])
            for name, value in zip(self.names, reached, strict=True):
                if not np.isfinite(value):
                    raise SceneError(f"{values} gives {name} no value. Use a range in which it has one")
            self.poses[key] = _Pose(model, pose.state, reached)
            solved = len(self.poses)
            self.progress(1.0 - PER_POSE**solved, f"{solved} static poses")
        return self.poses[key]

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives (p, p) of the quantities by the numbers: dq/dx + dq/dr dr/dx, K dr/dx = -dF/dx."""
        model, pose, _ = self.pose(x)
        scene = self.at(x)
        slopes = [model_slopes(scene, model, path) for path in self.paths]
        moving = tuple(sorted({leaf for own in slopes for leaf in own}))
        leaves = jax.tree.leaves(model)
        rows = []
        for i in moving:
            rows.append(np.stack([own.get(i, np.zeros(jnp.shape(leaves[i]))) for own in slopes]))
        return np.asarray(_slopes(moving, self.quantities, model, rows, pose, release_loads(model, scene.start)))

    def scale(self, reached: np.ndarray) -> np.ndarray:
        """Sizes (p,) of the targets: the required value, or what is reached where it is zero."""
        return np.where(self.goals != 0.0, np.abs(self.goals), np.maximum(np.abs(reached), 1.0))

    def missed_target(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, most: float) -> str:
        """The target with the largest relative miss, and values at a bound; empty if no miss exceeds `most`."""
        reached = self.pose(x).reached
        miss = np.abs(reached - self.goals) / self.scale(reached)
        worst = int(np.argmax(miss))
        if miss[worst] <= most:
            return ""
        message = f"{self.names[worst]} reaches {reached[worst]:.6g} of {self.goals[worst]:g}"
        near = np.minimum(x - low, high - x) < 1e-6 * (high - low)
        if np.any(near):
            message += f"; at a bound: {', '.join(np.array(self.paths)[near])}"
        return message

    def find_root(self, low: float, high: float) -> np.ndarray:
        """The value in an interval whose ends are on either side of the goal."""
        first, last = (float(self.pose([x]).reached[0]) for x in (low, high))
        goal = self.goals[0]
        if (first - goal) * (last - goal) > 0:
            raise SceneError(
                f"{self.paths[0]}: {low:g} to {high:g} gives {self.names[0]} from {first:.6g} to {last:.6g}, which "
                f"does not include {goal:g}. Use a range whose ends are on either side"
            )
        tolerance = {"xtol": VALUE_TOLERANCE * max(abs(low), abs(high)), "rtol": 4 * np.finfo(float).eps}
        return np.array([brentq(lambda x: self.pose([x]).reached[0] - goal, low, high, **tolerance)])

    def solve_together(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Several values by least squares within their ranges.

        Raises:
            SceneError: a singular system at the end, or no equilibrium.
        """
        middle = 0.5 * (low + high)
        scale = self.scale(self.pose(middle).reached)
        found = least_squares(
            lambda x: (self.pose(x).reached - self.goals) / scale,
            middle,
            lambda x: self.slopes(x) / scale[:, None],
            (low, high),
            x_scale=high - low,
            xtol=1e-12,
            ftol=1e-15,
            gtol=1e-15,
        )
        rows, sizes, columns = np.linalg.svd(found.jac * (high - low))
        if sizes[-1] <= UNDETERMINED_RATIO * sizes[0]:
            targets = np.array(self.names)[np.abs(rows[:, -1]) > 0.1]
            values = np.array(self.paths)[np.abs(columns[-1]) > 0.1]
            raise SceneError(
                f"design: {', '.join(targets)} do not determine {', '.join(values)}: the system is singular. Use other "
                "targets or values"
            )
        return found.x


@cached_jit(static=("moving", "quantities"))
def _slopes(
    moving: tuple[int, ...],
    quantities: tuple[Quantity, ...],
    model: Model,
    rows: Sequence[Array | np.ndarray],
    pose: State,
    loads: Array,
) -> Array:
    """Derivatives (q, p) of quantities of a static pose, along changes (p, ...) of some leaves of the model."""

    def values(shift: Array) -> Array:
        changed = shift_model(model, moving, rows, shift)
        there = settle(changed, pose, loads, is_equilibrium=True)
        return jnp.stack([q.of_pose(changed, there) for q in quantities])

    return jax.jacfwd(values)(jnp.zeros(len(rows[0]), model.dtype))


def _ends_of(scene: Scene, target: str) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """Forces on the end points of the line of a tension, and its angles there; None for other targets."""
    kind, _, rest = target.partition(".")
    if kind not in ("tension", "line"):
        return None, None
    name = rest.partition(".")[0]
    pose = equilibrium(scene)
    positions = pose.positions[None]
    tension = pose.tension[None]
    forces = {}
    angles = {}
    for lines in (line_slices(scene), whole_lines(scene)):
        forces |= end_forces(scene, positions, tension, lines)
        angles |= end_angles(positions, lines)
    if name not in forces:
        return None, None
    return tuple(forces[name][0].tolist()), tuple(angles[name][0].tolist())
