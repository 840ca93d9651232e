"""Error against time: every scheme at every step on one scene, measured against one reference."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.study.counted_work import evaluation_work, step_work
from dropper_jax.study.march import (
    GridRun,
    Rows,
    grid_run,
    march_with_accuracy,
    rms,
    rms_angle,
    rms_position,
)
from dropper_jax.study.reference import Reference
from dropper_jax.study.schemes import Scheme

#: Accuracies of schemes whose steps follow one.
ACCURACIES = tuple(10.0 ** (-0.5 * k) for k in range(2, 13))
#: Maximum counted operations of a run, some seconds of a core: a longer run, and those of finer steps, are left out.
WORK_LIMIT = 1e10
#: Callback that gets each row as soon as it is measured.
Each = Callable[[Table], None]
#: A failed run has no errors and no speed, since these values would be meaningless.
NOTHING = {
    "rms_angle_error_rad": None,
    "rms_position_error_m": None,
    "rms_tension_error_n": None,
    "energy_drift_j": None,
    "equivalent_linear_damping": None,
    "resolved": False,
}


@dataclass(frozen=True)
class Comparison:
    """Runs of a model that are compared with one reference.

    Attributes:
        model, s: in float64.
        target: the reference.
        repeats, pick: timed runs of each, and which of their wall times counts.
    """

    model: Model
    s: State
    target: Reference
    repeats: int = 3
    pick: Callable[[list[float]], float] = statistics.median

    @cached_property
    def evaluation(self) -> float:
        """Counted work of one evaluation of the forces."""
        return evaluation_work(self.model, self.s)

    def rows(
        self, schemes: Sequence[Scheme], dts: Sequence[float], retry: bool = True, progress: Progress = silent
    ) -> Iterator[Table]:
        """The rows of all schemes and steps, one by one; a run left out for its work (`WORK_LIMIT`) has a `reason`.

        Schemes whose steps follow an accuracy are run at `ACCURACIES` too; their `dt` is the mean step.

        Args:
            dts: steps [s]; each is moved to the nearest that divides the reference's grid.
            retry: halve steps that do not converge, as `simulate` does; else a run with such a step is `not_converged`.
        """
        everies = sorted({max(1, round(self.target.grid / dt)) for dt in dts})
        for i, scheme in enumerate(schemes):
            progress(i / len(schemes), scheme.label)
            yield from self._rows_of(scheme, everies, retry)

    def _rows_of(self, scheme: Scheme, everies: list[int], retry: bool) -> Iterator[Table]:
        """The rows of a scheme; `everies` are steps between saved times."""
        target = self.target
        model = self.model
        start = self.s
        if scheme.dtype != "float64":
            model, start = jax.tree.map(_single, (model, start))
        stepper = scheme.stepper(model)
        if not retry:
            stepper = stepper.plain
        saves = len(target.t)
        work = step_work(self.model, stepper, self.evaluation)
        if stepper.integrator.follows_accuracy and scheme.dtype == "float64":
            for accuracy in ACCURACIES:
                yield self._row_of_accuracy(scheme, stepper, accuracy, work)
            if isinstance(stepper.integrator, Embedded):
                return
        compiled = False
        for every in everies:
            dt = target.grid / every
            if work * every * saves > WORK_LIMIT:
                yield {"scheme": scheme.label, "dt": dt, "reason": f"over {WORK_LIMIT:g} operations a run"}
                continue
            again = partial(grid_run, stepper, model, start, target.grid, every, saves)
            started = time.perf_counter()
            run = replace(again(), model=self.model, start=self.s)
            before = time.perf_counter() - started if compiled else 0.0  # the first row compiles
            compiled = True
            yield self._row(scheme, run, again, every * saves, work, before) | {"dt": dt}

    def _row(
        self, scheme: Scheme, run: GridRun, again: Callable[[], object], steps: int, work: float, before: float = 0.0
    ) -> Table:
        """The row of a run with this number of steps, each of some counted work; without its step."""
        errors = NOTHING
        us_per_step = None
        wall_s_per_simulated_s = None
        if run.status == "ok":
            errors = row_errors(run, self.target)
            wall = self.pick(_walls(again, self.repeats, before))
            us_per_step = 1e6 * wall / steps
            wall_s_per_simulated_s = wall / self.target.horizon
        return {
            **asdict(scheme),
            "solver": run.stepper.solver_name,
            "label": scheme.label,
            **errors,
            "us_per_step": us_per_step,
            "wall_s_per_simulated_s": wall_s_per_simulated_s,
            "operations_per_simulated_s": work * steps / self.target.horizon,
            "status": run.status,
            "retried_steps": int(run.rows.retried[-1]),
        }

    def _row_of_accuracy(self, scheme: Scheme, stepper: Stepper, accuracy: float, work: float) -> Table:
        """The row of a scheme whose steps follow an accuracy; its `dt` is the mean step."""
        target = self.target
        again = partial(march_with_accuracy, stepper, self.model, self.s, target.grid, accuracy, len(target.t))
        found = jax.tree.map(np.asarray, again())
        run = GridRun(stepper, self.model, self.s, target.t, found.run)
        return self._row(scheme, run, again, int(found.taken + found.refused), work) | {
            "label": f"{scheme.label}, accuracy",
            "dt": target.horizon / max(int(found.taken), 1),
            "accuracy": accuracy,
            "refused_steps": int(found.refused),
            "rms_tension_error_n": None,  # means between saved times
            "retried_steps": 0,
        }


def _single(x: ArrayLike) -> ArrayLike:
    """A number in single precision; integers are unchanged."""
    if jnp.issubdtype(jnp.asarray(x).dtype, jnp.floating):
        return jnp.asarray(x, jnp.float32)
    return x


def _walls(run: Callable[[], object], repeats: int, before: float) -> list[float]:
    """Wall times of compiled runs [s]; only a few if they are long, none if one took `before` and is long."""
    enough = 0.2  # total time [s] after which no more are run
    times = [before] if before > enough else []
    while len(times) < repeats and sum(times) <= enough:
        started = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - started)
    return times


#: Minimum ratio of a measured error to that of the reference.
RESOLVED_RATIO = 100.0


def row_errors(run: GridRun, target: Reference) -> Table:
    """Errors of a run on the reference's grid, its energy drift and the damping equivalent to this drift."""
    angle = rms_angle(run.links, target.links)
    loss = run.energy_loss
    path = run.rows.path[-1]
    damping = 0.0
    if path > 0:
        damping = loss[-1] / path
    return {
        "rms_angle_error_rad": angle,
        "rms_position_error_m": rms_position(run.r, target.r),
        "rms_tension_error_n": rms(_tension_errors(run, target.tension)),
        "energy_drift_j": np.max(np.abs(loss)),
        "equivalent_linear_damping": damping,
        "resolved": bool(RESOLVED_RATIO * target.error <= angle < math.inf),
    }


def _tension_errors(run: GridRun, reference: np.ndarray) -> Rows:
    """Differences (k - 1, n) [N]; tensions from within steps are interpolated between both sides of a saved time."""
    seen = run.rows.tension[:-1, 0]
    share = run.stepper.integrator.tension_time
    if share != 1.0:
        seen = share * seen + (1.0 - share) * run.rows.tension[1:, 1]
    with np.errstate(invalid="ignore"):
        return seen - reference[:-1]


def orders(rows: list[Table]) -> dict[str, float]:
    """Slope of log error over log step of each scheme, through its finest three resolved steps below 0.1 rad."""
    found = {}
    for label in dict.fromkeys(column(rows, "label")):
        good = []
        for r in rows:
            fine = r["status"] == "ok" and r["resolved"] and r["rms_angle_error_rad"] < 0.1
            if r["label"] == label and fine and "accuracy" not in r:  # mean steps have no order
                good.append((r["dt"], r["rms_angle_error_rad"]))
        if len(good) >= 2:
            steps, errors = np.log(sorted(good)[:3]).T
            found[label] = np.polyfit(steps, errors, 1)[0]
    # errors that do not fall with the step are those of rounding, which have no order
    return {label: order for label, order in found.items() if order > 0.5}
