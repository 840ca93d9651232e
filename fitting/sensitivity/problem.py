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
from dropper_jax.run.quantities import OVER_STEPS, Quantity, QuantitySignals, quantity, quantity_signals
from dropper_jax.run.statistics import OF_SAMPLES, PERIOD
from dropper_jax.scene import RunSpec, StartSpec
from dropper_jax.statics.host_stiffness import follow_parameters, free_motion
from dropper_jax.statics.rest_problem import rest, unbalanced_at
from dropper_jax.statics.search import outward
from dropper_jax.statics.static_pose import release_loads
from dropper_jax.stepping.adaptive import MOST_STEPS, adaptive_start, advance_adaptively, find_lengths
from dropper_jax.stepping.control import ROUNDING
from dropper_jax.stepping.integrate import Progress as RunProgress
from dropper_jax.stepping.integrate import (
    Steps,
    Trajectory,
    advance,
    advance_and_save,
    along_accepted_steps,
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

    @property
    def follows(self) -> bool:
        """Whether the steps follow an accuracy."""
        return self.run.accuracy is not None

    def march(self, model: Model, s: State, steps: Steps, checkpoint: bool = False) -> Trajectory:
        """Saved states of a run from s along these steps."""
        if self.follows:
            return along_accepted_steps(self.stepper.plain, model, s, steps, 1, checkpoint, None, follows=True)[1]
        every = self.run.save_every
        return integrate(self.stepper, model, s, self.run.step, len(steps.ends) * every, every, checkpoint, warn=False)[
            1
        ]

    def measure(self, model: Model, s: State, run: Trajectory, t: jax.Array) -> jax.Array:
        """The quantity of states saved at times t (k,) [s], NaN if a step failed."""
        if self.of.at_rest:
            return self.of(model, s.r, run, t)
        return jnp.where(run.first_bad[-1] < 0, measure_rows(self.of, model, s, run, t, self.watch(s)), jnp.nan)

    def watch(self, s: State) -> QuantitySignals | None:
        """What a run from s records over its steps."""
        if self.of.statistic in OVER_STEPS:
            return quantity_signals([self.of], s.r)
        return None

    def value(self, model: Model, near: State, values: jax.Array) -> jax.Array:
        """The quantity of the model with these values (p,), by a run with steps of its own whose derivatives are not
        needed."""
        model = apply(model, self.parameters, values)
        s = initial_state(model, self.start, near=near)
        if self.of.at_rest:
            return self.measure(model, s, standing(s), s.t[None])
        rows = self.run.rows
        interval = jnp.asarray(self.run.interval, model.dtype)
        first = begin(self.stepper, model, s)
        if self.follows:
            march = one_kernel(partial(advance_adaptively, self.stepper, saves=rows))
            accuracy = jnp.asarray(self.run.accuracy, model.dtype)
            first = adaptive_start(self.stepper, model, first)
            _, (run, _) = march(model, first, interval, accuracy, watch=self.watch(s))
        else:
            march = one_kernel(partial(advance, self.stepper, saves=rows, save_every=self.run.save_every))
            _, run = march(model, first, jnp.asarray(self.run.step, model.dtype))
        return self.measure(model, s, run, s.t + interval * (1.0 + jnp.arange(rows)))

    def evaluate(
        self, model: Model, near: State, values: jax.Array, steps: Steps | None, checkpoint: bool = False
    ) -> jax.Array:
        """The quantity of the model with these values (p,), by a run along these steps."""
        model = apply(model, self.parameters, values)
        s = initial_state(model, self.start, near=near)
        if steps is None:
            return self.measure(model, s, standing(s), s.t[None])
        return self.measure(model, s, self.march(model, s, steps, checkpoint), s.t + saved_times(steps))


@dataclass(frozen=True, eq=False)
class Study:
    """A quantity of a scene as a function of parameters, `study(values)`, values (p,) -> scalar; differentiable.

    Runs with other values repeat the steps of its own run, at its own values: derivatives are those with the steps held
    constant.

    Without `retries` an equal step that does not converge makes the value NaN. Derivatives of halved steps take most of
    the compilation, and few runs need them. `local` turns them on if needed, `batch` always has them.
    """

    scene: Scene
    of: Quantity
    parameters: tuple[Parameter, ...]
    model: Model
    start: State
    retries: bool = False

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
        more = {} if self.retries or self.scene.run.accuracy is not None else {"halvings": 0}
        return stepper_of(self.model, self.scene.run, track_work=False, **more)

    @cached_property
    def plan(self) -> Plan:
        """The key of its compiled programs."""
        where = tuple(Parameter(p.name, p.where, 0.0) for p in self.parameters)
        return Plan(self.of, where, self.scene.start, self.scene.run, self.stepper)

    @cached_property
    def steps(self) -> Steps | None:
        """The steps of its own run; None of a quantity at rest."""
        if self.of.at_rest:
            return None
        return self.steps_of(self.scene.run)

    def steps_of(self, run: RunSpec) -> Steps:
        """The steps of a run at its own values with other settings.

        Where an extreme over all steps of those that follow an accuracy is wanted, each is an interval of its own.

        Raises:
            SceneError: they are more than `MOST_STEPS`.
        """
        if run.accuracy is None:
            length = np.full(run.steps, run.step)
            return _steps(self.model, length, run.save_every * (1 + np.arange(run.saves)), failed=False)
        numbers = (jnp.asarray(x, self.model.dtype) for x in (run.interval, run.rows, run.accuracy))
        length, number, failed = map(np.asarray, _find_lengths(self.stepper, self.model, self.start, *numbers))
        if number >= MOST_STEPS:
            raise SceneError(f"{self.of.name}: the run takes more than {MOST_STEPS} steps. Use a shorter run.duration")
        length = length[:number]
        if self.of.statistic in OVER_STEPS:
            ends = 1 + np.arange(number)
        else:
            saved = run.interval * (1.0 + np.arange(run.rows))
            ends = np.minimum(np.searchsorted(np.cumsum(length), saved * (1.0 - ROUNDING)) + 1, number)
        return _steps(self.model, length, ends, bool(failed))

    def __call__(self, values: jax.Array) -> jax.Array:
        return self.plan.evaluate(self.model, self.start, values, self.steps)

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


@cached_jit(static=("stepper",), kernel=True)
def _find_lengths(
    stepper: Stepper, model: Model, s: State, interval: jax.Array, rows: jax.Array, accuracy: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """`find_lengths` of any run."""
    return find_lengths(stepper, model, s, interval, rows, accuracy, MOST_STEPS)


def _steps(model: Model, length: np.ndarray, ends: np.ndarray, failed: bool) -> Steps:
    """Steps of these lengths [s], with intervals that have these ends."""
    none = np.zeros(len(ends), np.int32)
    residual = np.zeros(len(ends), model.dtype)
    return Steps(length.astype(model.dtype), ends.astype(np.int32), residual, none, np.full(len(ends), failed))


def part_of_steps(steps: Steps, first: int, rows: int) -> Steps:
    """The steps of `rows` intervals from number `first` on."""
    ends = steps.ends[first : first + rows]
    begin = steps.ends[first - 1] if first else 0
    others = (x[first : first + rows] for x in steps[2:])
    return Steps(steps.length[begin : ends[-1]], ends - begin, *others)


def _padded(steps: Steps) -> Steps:
    """The same with room for more steps and intervals, so that one program serves many durations."""
    room = len(steps.length), *[len(steps.ends)] * 4
    return Steps(*(np.pad(x, (0, spare_rows(n) - n)) for x, n in zip(steps, room, strict=True)))


def saved_times(steps: Steps) -> jax.Array:
    """Ends of the intervals (k,) [s] from the start of the run."""
    return jnp.cumsum(jnp.asarray(steps.length))[steps.ends - 1]


def measure_rows(
    of: Quantity, model: Model, s: State, rows: Trajectory, t: jax.Array, watch: QuantitySignals | None
) -> jax.Array:
    """A quantity of the rows of a run from s, saved at times t (k,) [s]; `watch`: what was recorded over its steps."""
    if watch is not None and rows.extremes is not None:
        return OVER_STEPS[of.statistic](watch.over_steps(rows.extremes)[of])
    return of(model, s.r, rows, t)


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


class _Passed(NamedTuple):
    """A run between two saved times: its state, and the tensions over the time since the last one (n,) [N s]."""

    progress: RunProgress
    impulse: jax.Array


def _take_step(
    stepper: Stepper, follows: bool, h: jax.Array, before: jax.Array, since: jax.Array, model: Model, passed: _Passed
) -> tuple[_Passed, Trajectory]:
    """One step of h [s] after one of `before` [s], to the time `since` the last saved one [s]; and the row to save
    after it, of steps that follow an accuracy with mean tensions."""
    if not follows:
        progress, row = advance_and_save(stepper, model, passed.progress, h, 1)
        return passed._replace(progress=progress), row
    progress, row = advance_and_save(stepper, model, passed.progress, h[None], 1, before=before[None])
    impulse = passed.impulse + h * row.tension
    return _Passed(progress, impulse), row._replace(tension=impulse / since)


class _Between(NamedTuple):
    """The loop over the steps between two saved times: the run, the row to save, and the time since the last one."""

    now: Varied
    row: Varied
    since: jax.Array


@cached_jit(static=("stepper", "parameters", "follows"), kernel=True)
def _vary_run(
    stepper: Stepper,
    parameters: tuple[Parameter, ...],
    follows: bool,
    model: Model,
    values: jax.Array,
    start: Varied,
    steps: Steps,
    count: jax.Array | int,
) -> Varied:
    """`count` saved states of a run along known steps, in the first of as many rows as these have ends, with
    derivatives: one program for any duration, quantity and start. JAX differentiates one step and not the loops around
    it: a third of the time of tracing.
    """

    def save(now: Varied, i: jax.Array) -> tuple[Varied, Varied]:
        first = jnp.where(i > 0, steps.ends[i - 1], 0)
        nothing = now.tree._replace(impulse=jnp.zeros_like(now.tree.impulse))
        now = Varied(nothing, [*now.slopes[:-1], jnp.zeros_like(now.slopes[-1])])

        def take(k: jax.Array, so_far: _Between) -> _Between:
            h = steps.length[k]
            since = so_far.since + h
            before = jnp.where(k > 0, steps.length[k - 1], 0.0)
            one = partial(_take_step, stepper, follows, h, before, since)
            found = _vary(one, parameters, model, values, so_far.now)
            after, row = found.tree
            earlier = so_far.row.tree
            row = row._replace(
                residual=jnp.maximum(earlier.residual, row.residual),
                retried=earlier.retried + row.retried,
                failed=earlier.failed + row.failed,
            )
            floats = len(so_far.now.slopes)
            return _Between(Varied(after, found.slopes[:floats]), Varied(row, found.slopes[floats:]), since)

        between = _Between(now, jax.tree.map(lambda x: x[0], rows), jnp.zeros((), model.dtype))
        between = jax.lax.fori_loop(first, steps.ends[i], take, between)
        return between.now, between.row

    def begun(changed: Model, s: State) -> _Passed:
        return _Passed(begin(stepper, changed, s), jnp.zeros_like(s.tension))

    now = _vary(begun, parameters, model, values, start)
    capacity = len(steps.ends)
    rows = empty_trajectory(now.tree.progress, capacity)
    slopes = [jnp.zeros((capacity, len(values), *x.shape[1:]), x.dtype) for x in floats_of(rows)]
    rows = Varied(rows, slopes)
    run = scan_steps(save, now, count, rows)[1]
    return Varied(run.tree, [jnp.swapaxes(x, 0, 1) for x in run.slopes])


@cached_jit(static=("plan",))
def _vary_quantity(
    plan: Plan, model: Model, values: jax.Array, start: Varied, run: Varied | None, t: jax.Array
) -> Varied:
    """The quantity of a run from `start` with states saved at t (k,) [s], or of the start alone."""
    if run is None:

        def measure_start(changed: Model, s: State) -> jax.Array:
            return plan.measure(changed, s, standing(s), s.t[None])

        return _vary(measure_start, plan.parameters, model, values, start)
    return _vary(partial(plan.measure, t=t), plan.parameters, model, values, start, run)


def vary_study(problem: Study, at: jax.Array, start: Varied, steps: Steps | None) -> tuple[Varied, Varied | None]:
    """The quantity of a run from `start` along these steps, and the run, with derivatives."""
    plan = problem.plan
    model = problem.model
    t = start.tree.t
    if steps is None:
        return _vary_quantity(plan, model, at, start, None, t[None]), None
    saves = len(steps.ends)
    spare = _padded(steps)
    run = _vary_run(plan.stepper, plan.parameters, plan.follows, model, at, start, spare, saves)
    rows = jax.tree.map(lambda x: np.asarray(x)[:saves], run.tree)
    if np.any(steps.failed):
        rows = rows._replace(first_bad=np.zeros_like(rows.first_bad))
    run = Varied(rows, [np.asarray(x)[:, :saves] for x in run.slopes])
    return _vary_quantity(plan, model, at, start, run, t + saved_times(steps)), run


def study(scene: SceneLike, of: str, to: Sequence[str]) -> Study:
    """The study of a quantity (see `quantities`) and parameters (paths or unique short names).

    Raises:
        SceneError: unknown names.
    """
    scene = load_scene(scene)
    names = full_names(scene, to, "to")
    scene = with_effects(scene, names)
    model, start = build(scene)
    parameters = find_parameters(scene, model, names, "to", idle=True)
    wanted = quantity(of, model)
    run = scene.run
    if run.accuracy is None and wanted.statistic in (*OVER_STEPS, *OF_SAMPLES):  # an extreme is that of all steps
        scene = scene.with_values({"run.save_every": 1})
    if run.accuracy is not None and wanted.statistic in OF_SAMPLES and run.interval > LONGEST_INTERVAL:
        scene = scene.with_values({"run.save_interval": LONGEST_INTERVAL})
    if wanted.signal == PERIOD and scene.start.kind != "static":
        raise SceneError(f"of: {of!r}: the scene starts at {scene.start.kind!r}; allowed: start.kind = 'static'")
    return Study(scene, wanted, parameters, model, start)


#: Longest time [s] between the samples of statistics that need them close together.
LONGEST_INTERVAL = 0.1


def check_step(problem: Study, box: Sequence[tuple[float, float]] | None = None, say: Progress = silent) -> StepVerdict:
    """The verdict of `dropper run` on the step of the study's run, or of those at both ends of a box of its values."""
    if problem.of.at_rest or (box is None and problem.plan.follows):  # the error is in the study's result
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
