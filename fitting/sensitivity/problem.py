"""A quantity of a scene as a function of parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.batches import map_members
from dropper_jax.backend.one_kernel import one_kernel
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Progress, SceneError, silent
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Stepper
from dropper_jax.run.build import SceneLike, build, initial_state, stepper_of
from dropper_jax.run.fixed_points import with_points_fixed
from dropper_jax.run.members import StepVerdict, check_steps
from dropper_jax.run.quantities import OVER_STEPS, Quantity, quantity
from dropper_jax.run.statistics import OF_SAMPLES, PERIOD
from dropper_jax.scene import RunSpec, StartSpec
from dropper_jax.statics.host_stiffness import follow_parameters, free_motion
from dropper_jax.statics.rest_problem import rest, unbalanced_at
from dropper_jax.statics.search import outward
from dropper_jax.statics.static_pose import release_loads
from dropper_jax.stepping.integrate import (
    Trajectory,
    advance,
    advance_and_save,
    begin,
    empty_trajectory,
    integrate,
    scan_steps,
)
from dropper_jax.study.gradient_check import GradientCheck
from dropper_jax.study.march import spare_rows
from fitting.parameters.names import full_names
from fitting.parameters.of_scene import find_parameters
from fitting.parameters.parameter import Parameter, apply, with_effects
from fitting.parameters.targets import Direction

#: Number of runs of a global study that a GPU advances together.
RUNS_TOGETHER = 64


@dataclass(frozen=True)
class Plan:
    """Key of a compiled program of a study: everything that is not a number of the model.

    Attributes:
        of: the quantity.
        parameters: positions of the values; their own start values and bounds are omitted.
        start, run: of the scene.
        stepper: with or without halved steps.
    """

    of: Quantity
    parameters: tuple[Parameter, ...]
    start: StartSpec
    run: RunSpec
    stepper: Stepper

    def march(self, model: Model, s: State, saves: int, checkpoint: bool = False) -> Trajectory:
        """Saved states of a run from s."""
        every = self.run.save_every
        return integrate(self.stepper, model, s, self.run.step, saves * every, every, checkpoint, warn=False)[1]

    def measure(self, model: Model, s: State, run: Trajectory) -> jax.Array:
        """The quantity, NaN if a step failed."""
        if self.of.at_rest:
            return self.of(model, s.r, run, s.t[None])
        t = s.t + (1 + jnp.arange(run.r.shape[0])) * (self.run.step * self.run.save_every)
        return jnp.where(run.first_bad[-1] < 0, self.of(model, s.r, run, t), jnp.nan)

    def value(self, model: Model, near: State, values: jax.Array) -> jax.Array:
        """The quantity of the model with these values (p,), by a run whose derivatives are not needed."""
        model = apply(model, self.parameters, values)
        s = initial_state(model, self.start, near=near)
        if self.of.at_rest:
            return self.measure(model, s, standing(s))
        march = one_kernel(partial(advance, self.stepper, saves=self.run.saves, save_every=self.run.save_every))
        _, run = march(model, begin(self.stepper, model, s), jnp.asarray(self.run.step, model.dtype))
        return self.measure(model, s, run)

    def evaluate(
        self, model: Model, near: State, values: jax.Array, checkpoint: bool = False
    ) -> tuple[jax.Array, Trajectory]:
        """The quantity of the model with these values (p,), and the corresponding run."""
        model = apply(model, self.parameters, values)
        s = initial_state(model, self.start, near=near)
        if self.of.at_rest:
            run = standing(s)
        else:
            run = self.march(model, s, self.run.saves, checkpoint)
        return self.measure(model, s, run), run


@dataclass(frozen=True, eq=False)
class Study:
    """A quantity of a scene as a function of parameters, `study(values)`, values (p,) -> scalar; differentiable.

    Without `retries` a step that does not converge makes the value NaN. Derivatives of halved steps take most of the
    compilation, and few runs need them. `local` turns them on if needed, `batch` always has them.

    Attributes:
        scene: with equal steps.
        following: the scene with its accuracy, if it has one and links stretch: differences of runs follow it.
    """

    scene: Scene
    of: Quantity
    parameters: tuple[Parameter, ...]
    model: Model
    start: State
    retries: bool = False
    following: Scene | None = None

    @property
    def run_scene(self) -> Scene:
        """The scene of runs whose steps need not be equal."""
        if self.following is None:
            return self.scene
        return self.following

    @property
    def stretches(self) -> bool:
        """Whether runs have links that stretch: slopes are then differences of runs."""
        return not (self.of.at_rest or self.model.line.axial.rigid(self.model.line.links).all())

    @property
    def names(self) -> list[str]:
        return [p.name for p in self.parameters]

    @property
    def values(self) -> np.ndarray:
        return np.array([p.value for p in self.parameters])

    @cached_property
    def stepper(self) -> Stepper:
        more = {} if self.retries else {"halvings": 0}
        return stepper_of(self.model, self.scene.run, track_work=False, **more)

    @cached_property
    def plan(self) -> Plan:
        """The key of its compiled programs."""
        where = tuple(Parameter(p.name, p.where, 0.0) for p in self.parameters)
        return Plan(self.of, where, self.scene.start, self.scene.run, self.stepper)

    def __call__(self, values: jax.Array) -> jax.Array:
        return self.plan.evaluate(self.model, self.start, values)[0]

    def check_derivatives(self, found: np.ndarray) -> None:
        """Reject derivatives (p,) that do not exist, such as those of a static pose with an unconstrained direction.

        Raises:
            SceneError: with the names of the node and of the parameters.
        """
        if np.isfinite(found).all():
            return
        start = self.scene.start
        model = self.model
        s = self.start
        if start.kind == "points":
            model = with_points_fixed(model)
            s = state(model, s.r[: model.free_nodes], tension=s.tension)
        if start.kind in ("static", "points") and model.free_nodes:
            free = free_motion(model, s, release_loads(model, start))
            if free:
                why = "Use a pose that is constrained in all directions"
                raise SceneError(f"start: the static pose does not follow the parameters: {free}. {why}")
        names = ", ".join(name for name, slope in zip(self.names, found, strict=True) if not np.isfinite(slope))
        raise SceneError(f"to: {self.of.name} has no finite derivative by {names}. Use another start or parameter")

    def batch(self, values: np.ndarray) -> np.ndarray:
        """The quantity of many values (cases, p) -> (cases,) by one compiled program; each run halves its own steps."""
        plan = replace(self, retries=True).plan
        run = jax.jit(map_members(partial(plan.value, self.model, self.start), together=RUNS_TOGETHER))
        return np.asarray(run(jnp.asarray(values, self.model.dtype)))


def standing(s: State) -> Trajectory:
    """The saved states of a run that has not started: its start alone."""
    one = lambda tree: jax.tree.map(lambda a: a[None], tree)  # noqa: E731
    none = jnp.zeros((1,), jnp.int32)
    never = jnp.full((1,), -1, jnp.int32)
    r, v, tension, work = one((s.r, s.v, s.tension, s.work))
    residual = jnp.zeros_like(s.t)[None]
    return Trajectory(r, v, tension, work, residual, none, none, never, one(s.parted), one(s.own))


class Varied(NamedTuple):
    """A tree of arrays as a function of the parameters: its values, and the derivatives (p, ...) of its floats."""

    tree: Any
    slopes: Sequence[jax.Array | np.ndarray]


def floats_of(tree: Any) -> list[jax.Array]:
    return [x for x in jax.tree.leaves(tree) if jnp.issubdtype(jnp.result_type(x), jnp.inexact)]


def _with_floats(tree: Any, values: list[jax.Array]) -> Any:
    leaves, form = jax.tree.flatten(tree)
    new = iter(values)
    return form.unflatten([next(new) if jnp.issubdtype(jnp.result_type(x), jnp.inexact) else x for x in leaves])


def _vary(
    function: Callable[..., Any], parameters: Sequence[Parameter], model: Model, values: jax.Array, *given: Varied
) -> Varied:
    """`function(model, *trees)` with its derivatives by the parameters, of which the trees are functions too."""

    def at(p: jax.Array, *floats: list[jax.Array]) -> tuple[list[jax.Array], Any]:
        trees = (_with_floats(one.tree, new) for one, new in zip(given, floats, strict=True))
        found = function(apply(model, parameters, p), *trees)
        return floats_of(found), found

    def along(*direction: Any) -> Varied:
        _, slopes, found = jax.jvp(at, (values, *(floats_of(one.tree) for one in given)), direction, has_aux=True)
        return Varied(found, slopes)

    slopes = (one.slopes for one in given)
    return jax.vmap(along, out_axes=Varied(None, 0))(jnp.eye(len(values)), *slopes)


def vary_start(plan: Plan, model: Model, s: State, values: jax.Array) -> Varied:
    """The initial state s of the model with these values, and its derivatives; a small program for elastic lines."""
    still = rest(model)
    if not plan.start.is_static or still.constraints or outward(model) or not still.line.axial.elastic:
        return _vary_start(plan, model, s, values)
    count = len(values)
    found, unsolved = follow_parameters(still, count, partial(_slopes_at_rest, plan, model, s, values))
    return Varied(found.tree, [x[-count:].at[unsolved].set(jnp.nan) for x in found.slopes])


@cached_jit(static=("plan",))
def _vary_start(plan: Plan, model: Model, s: State, values: jax.Array) -> Varied:
    """The same for any initial state."""
    return _vary(lambda changed: initial_state(changed, plan.start, s, there=True), plan.parameters, model, values)


@cached_jit(static=("plan",))
def _slopes_at_rest(
    plan: Plan, model: Model, s: State, values: jax.Array, by_value: jax.Array, by_position: jax.Array
) -> tuple[jax.Array, Varied]:
    """Derivatives of the unbalanced forces (k, free, 3) [N] at rest, and of the state, along k directions of the
    parameters (k, p) and of the positions (k, free, 3) [m]."""

    def at(p: jax.Array, x: jax.Array) -> tuple[tuple[jax.Array, list[jax.Array]], State]:
        full = apply(model, plan.parameters, p)
        loads = release_loads(full, plan.start)
        rows, tension = unbalanced_at(rest(full), state(full, s.r), loads, x)
        found = state(full, s.r + x, tension=tension)
        return (rows, floats_of(found)), found

    def along(*direction: jax.Array) -> tuple[jax.Array, Varied]:
        _, (rows, slopes), found = jax.jvp(at, (values, jnp.zeros_like(s.r)), direction, has_aux=True)
        return rows, Varied(found, slopes)

    directions = (part.astype(model.dtype) for part in (by_value, by_position))
    return jax.vmap(along, out_axes=(0, Varied(None, 0)))(*directions)


@cached_jit(static=("stepper", "parameters", "every", "capacity"), kernel=True)
def _vary_run(
    stepper: Stepper,
    parameters: tuple[Parameter, ...],
    model: Model,
    values: jax.Array,
    start: Varied,
    dt: jax.Array,
    count: jax.Array | int,
    every: int,
    capacity: int,
) -> Varied:
    """`count` saved states of a run, in the first of `capacity` rows, with derivatives: one program for any duration,
    quantity and start. JAX differentiates one step and not the loops around it: a third of the time of tracing.
    """

    def advance(now: Varied, _: jax.Array) -> tuple[Varied, Varied]:
        found = _vary(partial(advance_and_save, stepper, dt=dt, save_every=every), parameters, model, values, now)
        after, row = found.tree
        state_floats = len(now.slopes)
        return Varied(after, found.slopes[:state_floats]), Varied(row, found.slopes[state_floats:])

    now = _vary(partial(begin, stepper), parameters, model, values, start)
    rows = empty_trajectory(now.tree, capacity)
    slopes = [jnp.zeros((capacity, len(values), *x.shape[1:]), x.dtype) for x in floats_of(rows)]
    run = scan_steps(advance, now, count, Varied(rows, slopes))[1]
    return Varied(run.tree, [jnp.swapaxes(x, 0, 1) for x in run.slopes])


@cached_jit(static=("plan",))
def _vary_quantity(plan: Plan, model: Model, values: jax.Array, start: Varied, run: Varied | None) -> Varied:
    """The quantity of a run from `start`, or of the start alone."""
    if run is None:
        return _vary(lambda changed, s: plan.measure(changed, s, standing(s)), plan.parameters, model, values, start)
    return _vary(plan.measure, plan.parameters, model, values, start, run)


def vary_study(problem: Study, at: jax.Array, start: Varied, saves: int) -> tuple[Varied, Varied | None]:
    """The quantity over `saves` saved times from `start`, and the run, with derivatives."""
    plan = problem.plan
    model = problem.model
    run = None
    if not plan.of.at_rest:
        dt = jnp.asarray(plan.run.step, model.dtype)
        rows = spare_rows(plan.run.saves)
        run = _vary_run(plan.stepper, plan.parameters, model, at, start, dt, saves, plan.run.save_every, rows)
        run = Varied(
            jax.tree.map(lambda x: np.asarray(x)[:saves], run.tree), [np.asarray(x)[:, :saves] for x in run.slopes]
        )
    return _vary_quantity(plan, model, at, start, run), run


def study(scene: SceneLike, of: str, to: Sequence[str]) -> Study:
    """The study of a quantity (see `quantities`) and parameters (paths or unique short names).

    Raises:
        SceneError: unknown names.
    """
    given = load_scene(scene)
    names = full_names(given, to, "to")
    given = with_effects(given, names)
    scene = given.with_equal_steps()
    model, start = build(scene)
    parameters = find_parameters(scene, model, names, "to", idle=True)
    wanted = quantity(of, model)
    if wanted.statistic in (*OVER_STEPS, *OF_SAMPLES):  # an extreme is that of all steps
        scene = scene.with_values({"run.save_every": 1})
    if wanted.signal == PERIOD and scene.start.kind != "static":
        raise SceneError(f"of: {of!r}: the scene starts at {scene.start.kind!r}; allowed: start.kind = 'static'")
    found = Study(scene, wanted, parameters, model, start)
    if given.run.accuracy is None or not found.stretches:
        return found
    if wanted.statistic in OF_SAMPLES and given.run.interval > LONGEST_INTERVAL:
        given = given.with_values({"run.save_interval": LONGEST_INTERVAL})
    return replace(found, following=given)


#: Longest time [s] between the samples of statistics that need them close together.
LONGEST_INTERVAL = 0.1


def check_step(problem: Study, box: Sequence[tuple[float, float]] | None = None, say: Progress = silent) -> StepVerdict:
    """The verdict of `dropper run` on the step of the study's run, or of those at both ends of a box of its values."""
    if problem.of.at_rest or (box is None and problem.following is not None):  # the error is in the study's result
        return StepVerdict()
    members = {"the run": problem.scene}
    if box is not None:
        with suppress(SceneError):  # numbers of the model that no value of the scene sets
            lowest, highest = (dict(zip(problem.names, map(float, end), strict=True)) for end in zip(*box, strict=True))
            members = {
                "lowest values": problem.scene.with_values(lowest),
                "highest values": problem.scene.with_values(highest),
            }
    return check_steps(members, say)


class LinearRange(NamedTuple):
    """What a run with all parameters changed shows of exact derivatives.

    Attributes:
        size: relative change of all parameters that they predict: 0.01, 0.001, 0.0001, otherwise 0.
        error: of the derivatives as predictions of that change (p,): what all together do not predict.
        warnings: one unless the change is 0.01.
        along: that run and the one with the opposite change; None where a bound is between.
    """

    size: float
    error: np.ndarray
    warnings: list[str]
    along: GradientCheck | None


def linear_range(
    problem: Study, value: float, slopes: np.ndarray, evaluate: Callable[[np.ndarray], float]
) -> LinearRange:
    """Relative change of all parameters that the derivatives `slopes` (p,) predict.

    A prediction holds within a third of the change, or within 0.01 in `p/Q dQ/dp`. All parameters change together, each
    in the direction that increases the quantity, so that one run at 1 % is enough for a smooth motion. One with the
    opposite change checks the derivatives along this direction.
    """
    scale = np.array([p.scale for p in problem.parameters])
    step = np.where(slopes < 0.0, -1.0, 1.0) * scale
    ahead = problem.values + 0.01 * step
    inside = [p.low <= x <= p.high for p, x in zip(problem.parameters, ahead, strict=True)]
    step = np.where(inside, step, -step)
    behind = problem.values - 0.01 * step
    along = None
    changes = []
    for size in (1e-2, 1e-3, 1e-4):
        real = evaluate(problem.values + size * step) - value
        changes.append((real, size * float(slopes @ step)))
        if size == 1e-2 and all(p.low <= x <= p.high for p, x in zip(problem.parameters, behind, strict=True)):
            opposite = evaluate(behind) - value
            along = GradientCheck.of(2.0 * changes[0][1], real - opposite, 2e-4 * abs(value))
        missed = abs(real - changes[-1][1])
        # not less: `max` jumps by 0.3 % where another sample becomes the largest, 22 % of a change by 1 % (lab dropper)
        if missed <= max(abs(changes[-1][1]) / 3.0, 0.01 * size * abs(value)):
            break
    else:
        size = 0.0
    error = np.where(slopes == 0.0, 0.0, missed / ((size or 1e-4) * scale))
    if len(changes) == 1:
        return LinearRange(size, error, [], along)
    real, predicted = changes[0]
    unit = problem.of.unit
    if np.isfinite(real):
        effect = f"changes by {real:.3g} {unit}"
    else:
        effect = "has a failed step"
    warning = (
        f"{problem.of.name}: {effect} if all parameters change by 1 %; the derivatives predict {predicted:.3g} "
        f"{unit}. They are valid for changes below {100 * size or 0.01:.2g} % only. Use a sweep for larger ones"
    )
    return LinearRange(size, error, [warning], along)


def ranges(problem: Study, given: Mapping[str, tuple[float, float]] | None = None) -> list[tuple[float, float]]:
    """Range of each parameter in a global study: the given one, otherwise +-20 %, inside its bounds."""
    given = given or {}
    full = dict(zip(full_names(problem.scene, list(given), "range"), given.values(), strict=True))
    for name, (low, high) in full.items():
        if name not in problem.names or not low < high:
            raise SceneError(f"range: {name} = {low:g}:{high:g}; allowed: low < high of a parameter of --to")
    found = []
    for p in problem.parameters:
        if isinstance(p.where, Direction) and not p.where.linear:
            raise SceneError(
                f"to: the model is not linear in {p.name!r}. Use it in local studies, or in `dropper sweep`"
            )
        spread = 0.2 * p.scale
        found.append(full.get(p.name, (max(p.low, p.value - spread), min(p.high, p.value + spread))))
    return found
