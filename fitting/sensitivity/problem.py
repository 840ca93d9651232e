"""A quantity of a scene as a function of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.batches import map_members
from dropper_jax.backend.one_kernel import one_kernel
from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.model import Model, State, state
from dropper_jax.modelling.build import SceneLike, build, initial_state, stepper_of
from dropper_jax.modelling.fixed_points import with_points_fixed
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_extremes import QuantitySignals, quantity_signals
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.quantities.statistics import OF_SAMPLES, OVER_STEPS, PERIOD
from dropper_jax.residual import Stepper
from dropper_jax.run.step_verdict import StepVerdict, check_steps
from dropper_jax.scene import RunSpec, StartSpec
from dropper_jax.statics.host_stiffness import free_motion
from dropper_jax.statics.loads import release_loads
from dropper_jax.stepping.adaptive import interval_ends
from dropper_jax.stepping.integrate import Steps, advance, along_accepted_steps, integrate
from dropper_jax.stepping.progress import Trajectory, begin
from dropper_jax.stepping.step_record import MOST_STEPS
from fitting.parameters.names import full_names
from fitting.parameters.parameter import Parameter, with_parameter_values, with_zero_damping
from fitting.parameters.scene_parameters import find_parameters
from fitting.sensitivity.study_steps import find_step_lengths, make_steps

#: Number of runs of a global study that a GPU advances together.
RUNS_TOGETHER = 64
#: Longest time [s] between the samples of statistics that need them close together.
LONGEST_INTERVAL = 0.1


@dataclass(frozen=True)
class StudyProgram:
    """Key of a compiled program of a study: everything that is not a number of the model.

    Attributes:
        of: the quantity.
        parameters: positions of the values; their own start values and bounds are omitted.
        start_spec, run: of the scene.
        stepper: with or without halved steps.
    """

    of: Quantity
    parameters: tuple[Parameter, ...]
    start_spec: StartSpec
    run: RunSpec
    stepper: Stepper

    @property
    def is_adaptive(self) -> bool:
        """Whether the steps follow an accuracy."""
        return self.run.accuracy is not None

    def march(self, model: Model, s: State, steps: Steps, checkpoint: bool = False) -> Trajectory:
        """Saved states of a run from s along these steps."""
        if self.is_adaptive:
            _, run = along_accepted_steps(self.stepper.plain, model, s, steps, 1, checkpoint, None, follows=True)
        else:
            every = self.run.save_every
            count = len(steps.ends) * every
            _, run = integrate(self.stepper, model, s, self.run.step, count, every, checkpoint, warn=False)
        return run

    def measure(self, model: Model, s: State, run: Trajectory, t: Array) -> Array:
        """The quantity of states saved at times t (k,) [s], NaN if a step failed."""
        if self.of.at_rest:
            return self.of(model, s.r, run, t)
        return jnp.where(run.first_bad[-1] < 0, measure_rows(self.of, model, s, run, t, self.watch(s)), jnp.nan)

    def watch(self, s: State) -> QuantitySignals | None:
        """What a run from s records over its steps."""
        if self.of.statistic in OVER_STEPS:
            return quantity_signals([self.of], s.r)
        return None

    def evaluate(
        self, model: Model, near: State, values: Array, steps: Steps | None = None, checkpoint: bool = False
    ) -> Array:
        """The quantity of the model with these values (p,), by a run along these steps; None: along steps of its own,
        without derivatives."""
        model = with_parameter_values(model, self.parameters, values)
        s = initial_state(model, self.start_spec, near=near)
        if self.of.at_rest:
            return self.measure(model, s, start_as_trajectory(s), s.t[None])
        if steps is None:
            run, times = self._run_study_steps(model, s)
            return self.measure(model, s, run, times)
        ends = jnp.asarray(steps.ends) - 1
        times = s.t + jnp.cumsum(jnp.asarray(steps.length))[ends]
        return self.measure(model, s, self.march(model, s, steps, checkpoint), times)

    def _run_study_steps(self, model: Model, s: State) -> tuple[Trajectory, Array]:
        """Saved states of a run from s along steps of its own, and their times."""
        rows = self.run.rows
        interval = jnp.asarray(self.run.interval, model.dtype)
        first = begin(self.stepper, model, s, self.is_adaptive)
        if self.is_adaptive:
            march = one_kernel(partial(advance, self.stepper, saves=rows))
            accuracy = jnp.asarray(self.run.accuracy, model.dtype)
            _, run = march(model, first, interval, accuracy=accuracy, watch=self.watch(s))
        else:
            march = one_kernel(partial(advance, self.stepper, saves=rows, save_every=self.run.save_every))
            _, run = march(model, first, jnp.asarray(self.run.step, model.dtype))
        return run, s.t + interval * (1.0 + jnp.arange(rows))


@dataclass(frozen=True, eq=False)
class Study:
    """A quantity of a scene as a function of parameters, `study(values)`, values (p,) -> scalar; differentiable.

    Runs with other values repeat the steps of its own run, at its own values: derivatives are those with the steps held
    constant.

    Without `retries` an equal step that does not converge makes the value NaN. Derivatives of halved steps take most of
    the compilation, and few runs need them. `local_derivatives` turns them on if needed, `batch` always has them.
    """

    scene: Scene
    of: Quantity
    parameters: tuple[Parameter, ...]
    model: Model
    start: State
    retries: bool = False

    @property
    def has_elastic_links(self) -> bool:
        """Whether runs have links that stretch: slopes are then differences of runs."""
        return not (self.of.at_rest or self.model.line.axial.rigid(self.model.line.links).all())

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [p.name for p in self.parameters]

    @property
    def values(self) -> np.ndarray:
        """The scene's own values of the parameters (p,)."""
        return np.array([p.value for p in self.parameters])

    @cached_property
    def stepper(self) -> Stepper:
        """The scene's stepper, without halved steps unless they are wanted."""
        settings = {}
        if not self.retries and self.scene.run.accuracy is None:
            settings["halvings"] = 0
        return stepper_of(self.model, self.scene.run, track_work=False, **settings)

    @cached_property
    def plan(self) -> StudyProgram:
        """The key of its compiled programs."""
        where = tuple(Parameter(p.name, p.where, 0.0) for p in self.parameters)
        return StudyProgram(self.of, where, self.scene.start, self.scene.run, self.stepper)

    @cached_property
    def steps(self) -> Steps:
        """The steps of its own run; none of a quantity at rest."""
        with jax.ensure_compile_time_eval():
            if self.of.at_rest:
                return make_steps(self.model, np.zeros(0), np.zeros(0), failed=False)
            return self.steps_of(self.scene.run)

    def steps_of(self, run: RunSpec) -> Steps:
        """The steps of a run at its own values with other settings.

        For an extreme over adaptive steps, every step is one interval.

        Raises:
            SceneError: they are more than `MOST_STEPS`.
        """
        if run.accuracy is None:
            length = np.full(run.steps, run.step)
            return make_steps(self.model, length, run.save_every * (1 + np.arange(run.saves)), failed=False)
        numbers = (jnp.asarray(x, self.model.dtype) for x in (run.interval, run.rows, run.accuracy))
        length, number, failed = map(np.asarray, find_step_lengths(self.stepper, self.model, self.start, *numbers))
        if number >= MOST_STEPS:
            raise SceneError(f"{self.of.name}: the run takes more than {MOST_STEPS} steps. Use a shorter run.duration")
        length = length[:number]
        if self.of.statistic in OVER_STEPS:
            ends = 1 + np.arange(number)
        else:
            ends = np.asarray(interval_ends(jnp.asarray(length), run.interval, run.rows))
        return make_steps(self.model, length, ends, bool(failed))

    def __call__(self, values: Array) -> Array:
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
        """The quantity of many values (cases, p) -> (cases,) by one compiled program, each run in steps of its own."""
        plan = replace(self, retries=True).plan
        run = jax.jit(map_members(partial(plan.evaluate, self.model, self.start), together=RUNS_TOGETHER))
        return np.asarray(run(jnp.asarray(values, self.model.dtype)))


def measure_rows(
    of: Quantity, model: Model, s: State, rows: Trajectory, t: Array, watch: QuantitySignals | None
) -> Array:
    """A quantity of the rows of a run from s, saved at times t (k,) [s]; `watch`: what was recorded over its steps."""
    if watch is not None and rows.extremes is not None:
        return OVER_STEPS[of.statistic](watch.over_steps(rows.extremes)[of])
    return of(model, s.r, rows, t)


def start_as_trajectory(s: State) -> Trajectory:
    """The saved states of a run that has not started: its start alone."""
    row: State = jax.tree.map(lambda a: a[None], s)
    none = jnp.zeros((1,), jnp.int32)
    never = jnp.full((1,), -1, jnp.int32)
    residual = jnp.zeros_like(row.t)
    return Trajectory(row.r, row.v, row.tension, row.work, residual, none, none, never, row.parted, row.own)


def study(scene: SceneLike, of: str, to: Sequence[str]) -> Study:
    """The study of a quantity (see `quantities.quantity_names`) and parameters (paths or unique short names).

    Raises:
        SceneError: unknown names.
    """
    scene = load_scene(scene)
    names = full_names(scene, to, "to")
    scene = with_zero_damping(scene, names)
    model, start = build(scene)
    parameters = find_parameters(scene, model, names, "to", idle=True)
    wanted = quantity(of, model)
    run = scene.run
    is_extreme = wanted.statistic in OVER_STEPS
    needs_samples = wanted.statistic in OF_SAMPLES
    if run.accuracy is None and (is_extreme or needs_samples):  # an extreme is that of all steps
        scene = scene.with_values({"run.save_every": 1})
    if run.accuracy is not None and needs_samples and run.interval > LONGEST_INTERVAL:
        scene = scene.with_values({"run.save_interval": LONGEST_INTERVAL})
    if wanted.signal == PERIOD and scene.start.kind != "static":
        raise SceneError(f"of: {of!r}: the scene starts at {scene.start.kind!r}; allowed: start.kind = 'static'")
    return Study(scene, wanted, parameters, model, start)


def check_step(problem: Study, box: Sequence[tuple[float, float]] | None = None, say: Progress = silent) -> StepVerdict:
    """The verdict of `dropper run` on the step of the study's run, or of those at both ends of a box of its values."""
    if problem.of.at_rest or (box is None and problem.plan.is_adaptive):  # the error is in the study's result
        return StepVerdict()
    members = {"the run": problem.scene}
    if box is not None:
        low, high = np.transpose(box).tolist()
        lowest = dict(zip(problem.names, low, strict=True))
        highest = dict(zip(problem.names, high, strict=True))
        with suppress(SceneError):  # numbers of the model that no value of the scene sets
            members = {
                "lowest values": problem.scene.with_values(lowest),
                "highest values": problem.scene.with_values(highest),
            }
    return check_steps(members, say)
