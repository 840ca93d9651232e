"""Runs of a study along the steps of its own run: the quantity, and displacements from the own run."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.parallel_runs import run_parallel
from dropper_jax.base.progress import Progress, silent
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import initial_state, stepper_of
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.statistics import OVER_STEPS
from dropper_jax.run.chunks import FACTOR, Program, compile_run, run_chunks
from dropper_jax.run.companion import Companion
from dropper_jax.scene import RunSpec
from dropper_jax.stepping.progress import Progress as RunProgress
from dropper_jax.stepping.progress import Trajectory, begin
from dropper_jax.stepping.step_record import StepRecord
from fitting.parameters.parameter import with_parameter_values
from fitting.sensitivity.problem import Study, measure_rows

#: Displacement by a change, over that by the opposite or a smaller change, each per change, from which a run is on
#: another branch; and the fraction of the motion below which it is not looked at.
JUMP_RATIO = 6.0
SMALLEST_JUMP_SHARE = 0.01


class Run(NamedTuple):
    """A run of a study: the quantity, NaN if a step failed; and the displacement of the farthest node from the study's
    own run, at the start and at the most [m]."""

    value: float
    at_start: float
    at_most: float


def farthest(one: np.ndarray | Array, other: np.ndarray | Array) -> float:
    """Distance [m] of the two positions (..., 3) that are farthest apart."""
    return float(np.linalg.norm(np.asarray(one) - np.asarray(other), axis=-1).max())


def error_by_coarser(of: Quantity, value: float, coarser: float, accuracy: float) -> float:
    """The error of a quantity at an accuracy by its value in a run with `FACTOR` times it, at most 1; of an extreme the
    whole difference, which depends on few steps. NaN at an accuracy of 1, which has no coarser run."""
    ratio = min(FACTOR * accuracy, 1.0) / accuracy
    if ratio <= 1.0:
        return np.nan
    if of.statistic in OVER_STEPS:
        return abs(coarser - value)
    return abs(coarser - value) / (ratio - 1.0)


class StudyRuns:
    """Runs of a study along the steps of its own run.

    Attributes:
        start, model, rows: of the study's own run; record: its steps, None if all are equal.
        value, value_error: the quantity of the study's own run, and its error by the steps.
        extent: of the motion of that run [m].
    """

    def __init__(self, problem: Study, say: Progress = silent) -> None:
        self.problem = problem
        self.settings: RunSpec = problem.scene.run
        self.say = say
        start = self.start_at(problem.values)
        if start is None:
            raise SceneError(f"{problem.of.name}: the scene has no start")
        self.start = start
        self.model = self.model_at(problem.values)
        program = self.program(self.model, self.start, None)
        outcome = run_chunks(program, self.settings.rows, lambda share, _: say(0.2 * share, "own run"))
        self.rows: Trajectory = outcome.trajectory
        self.record = _recorded(outcome.carry, problem.of)
        self.value = self.measure(self.model, self.start, self.rows)
        self.extent = farthest(self.rows.r, self.rows.r[0])
        self.value_error = self._error_of_steps(Companion(program, False))

    def _error_of_steps(self, companion: Companion) -> float:
        """The error of the quantity by a run with four times the accuracy; NaN if a step fails, or steps are equal."""
        if self.settings.accuracy is None or not np.isfinite(self.value):
            return np.nan
        pieces = list(companion.chunks(len(self.rows.r)))
        if sum(len(rows.r) for rows in pieces) < len(self.rows.r) // 2 or not pieces:
            return np.nan
        rows = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
        coarser = self.measure(self.model, self.start, rows, 2.0)
        return error_by_coarser(self.problem.of, self.value, coarser, self.settings.accuracy)

    def program(self, model: Model, s: State, record: StepRecord | None) -> Program:
        """The run of a model from a start, along the recorded steps if there are any."""
        settings = self.settings
        if settings.accuracy is None:
            stepper = stepper_of(model, settings)
            return compile_run(stepper, model, begin(stepper, model, s), settings)
        if record is None:
            record = StepRecord.empty(model)
        stepper = stepper_of(model, settings, track_work=False)
        carry = begin(stepper, model, s, follows=True, record=record)
        return compile_run(stepper, model, carry, settings, self.problem.plan.watch(s))

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these values (p,)."""
        problem = self.problem
        return with_parameter_values(problem.model, problem.parameters, jnp.asarray(values, problem.model.dtype))

    def start_at(self, values: np.ndarray) -> State | None:
        """The start with these values, solved from scratch as that of a scene is; None if the scene has none."""
        try:
            return initial_state(self.model_at(values), self.problem.scene.start)
        except SceneError:
            return None

    def start_moved(self, values: np.ndarray) -> float:
        """Displacement [m] of the farthest node at the start with these values; NaN without one."""
        start = self.start_at(values)
        if start is None:
            return np.nan
        return farthest(start.r, self.start.r)

    def is_jump(self, moved: np.ndarray | float, change: np.ndarray | float, rate: np.ndarray | float) -> np.ndarray:
        """Whether changes displace a node much farther than others do at this rate [m per change], if it is known."""
        most = np.maximum(JUMP_RATIO * np.asarray(rate) * change, SMALLEST_JUMP_SHARE * self.extent)
        return (np.asarray(rate) > 0.0) & (moved > most)

    def measure(self, model: Model, s: State, rows: Trajectory, intervals: float = 1.0) -> float:
        """The quantity of the rows of a run, NaN if a step failed.

        Args:
            intervals: time between rows, in intervals of the study's own run.
        """
        if rows.first_bad[-1] >= 0:
            return np.nan
        t = s.t + intervals * self.settings.interval * (1.0 + np.arange(len(rows.r)))
        return float(measure_run(self.problem.of, model, s, rows, t, self.problem.plan.watch(s)))

    def run(self, values: np.ndarray) -> Run:
        """The run with these values (p,)."""
        start = self.start_at(values)
        if start is None:
            return Run(np.nan, np.nan, np.nan)
        return self.run_from(start, values)

    def run_from(self, start: State, values: np.ndarray) -> Run:
        """The run with these values (p,) from another start, such as the study's own."""
        model = self.model_at(values)
        program = self.program(model, start, self.record)
        return self.compare(model, start, run_chunks(program, self.settings.rows, silent).trajectory)

    def compare(self, model: Model, s: State, rows: Trajectory) -> Run:
        """The quantity of the rows of a run from s, and its displacements from the study's own."""
        at_most = farthest(rows.r, self.rows.r[: len(rows.r)])
        return Run(self.measure(model, s, rows), farthest(s.r, self.start.r), at_most)

    def run_all(self, values: np.ndarray) -> list[Run]:
        """The runs with these values (cases, p), on all cores at once."""

        def say_done(done: int) -> None:
            self.say(0.2 + 0.8 * done / len(values), f"differences: {done} of {len(values)} runs")

        return run_parallel(self.run, list(values), say_done, alone=0)


def _recorded(carry: RunProgress, of: Quantity) -> StepRecord | None:
    """The steps of a run, for others to repeat; None if all are equal."""
    record = carry.record
    if record is None:
        return None
    if int(record.number) >= len(record.length):
        raise SceneError(f"{of.name}: the run takes more than {len(record.length)} steps. Use a shorter run.duration")
    return record.to_repeat()


#: The quantity of a run, compiled.
measure_run = cached_jit(static=("of",))(measure_rows)
