"""Error against time: every scheme at every step on one scene, measured against one reference."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.study.counted_work import evaluation_work, step_work
from dropper_jax.study.march import (
    Marched,
    Rows,
    Scheme,
    grid_run,
    link_vectors,
    march_with_accuracy,
    rms,
    rms_angle,
    rms_position,
    status_of,
)
from dropper_jax.study.reference import Reference

#: Accuracies of schemes whose steps follow one.
ACCURACIES = tuple(10.0 ** (-0.5 * k) for k in range(2, 13))
#: Maximum counted operations of a run, some seconds of a core: a longer run, and those of finer steps, are left out.
WORK_LIMIT = 1e10
#: Wall times of repeated runs [s], and which of them counts.
Timing = tuple[Callable[..., list[float]], Callable[[list[float]], float]]
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


def measure(
    model: Model,
    s: State,
    schemes: list[Scheme],
    dts: list[float],
    target: Reference,
    repeats: int = 3,
    say: Progress = silent,
    pick: Callable[[list[float]], float] = statistics.median,
    retry: bool = True,
    each: Each = lambda row: None,
) -> tuple[list[Table], list[Table]]:
    """Rows of all schemes and steps, and runs left out because of their counted work (`WORK_LIMIT`).

    Schemes whose steps follow an accuracy are run at `ACCURACIES` too; their `dt` is the mean step.

    Args:
        model, s: in float64.
        dts: steps [s]; each is moved to the nearest that divides the reference's grid.
        repeats, pick: timed runs of each, and which of their wall times counts (the median).
        retry: halve steps that do not converge, as `simulate` does; else a run with such a step is `not_converged`.
        each: gets each row as soon as it is measured.
    """
    rows: list[Table] = []
    skipped: list[Table] = []
    evaluation = evaluation_work(model, s)
    for i, scheme in enumerate(schemes):
        say(i / len(schemes), scheme.label)
        timing = partial(_walls, repeats=repeats), pick
        for row in _scheme_rows(model, s, scheme, sorted(dts, reverse=True), target, timing, retry, evaluation):
            if "reason" in row:
                skipped.append(row)
                continue
            rows.append(row)
            each(row)
    return rows, skipped


def _scheme_rows(
    model: Model,
    s: State,
    scheme: Scheme,
    dts: list[float],
    target: Reference,
    timing: Timing,
    retry: bool,
    evaluation: float,
) -> Iterator[Table]:
    """The rows of a scheme, one by one; a run that is left out has a `reason` instead."""
    own = model
    start = s
    if scheme.dtype != "float64":
        own, start = jax.tree.map(_single, (model, s))
    stepper = scheme.stepper(own)
    stepper = stepper if retry else stepper.plain
    saves = len(target.t)
    per_step = step_work(model, stepper, evaluation)
    if stepper.integrator.follows_accuracy and scheme.dtype == "float64":
        for accuracy in ACCURACIES:
            yield _row_of_accuracy(model, s, scheme, stepper, target, accuracy, timing, per_step)
        if isinstance(stepper.integrator, Embedded):
            return
    walls, pick = timing
    compiled = False
    for every in sorted({max(1, round(target.grid / dt)) for dt in dts}):
        steps = every * saves
        if per_step * steps > WORK_LIMIT:
            reason = f"over {WORK_LIMIT:g} operations a run"
            yield {"scheme": scheme.label, "dt": target.grid / every, "reason": reason}
            continue
        started = time.perf_counter()
        run = grid_run(stepper, own, start, target.grid, every, saves)
        seconds = time.perf_counter() - started
        wall = None
        errors = NOTHING
        if status_of(run, stepper) == "ok":
            errors = row_errors(model, s, run, stepper, target)
            again = partial(grid_run, stepper, own, start, target.grid, every, saves)
            # the first row compiles
            wall = pick(walls(again, before=seconds if compiled else 0.0))
        compiled = True
        yield _row(scheme, stepper, target, run, errors, wall, steps, per_step) | {"dt": target.grid / every}


def _row(
    scheme: Scheme,
    stepper: Stepper,
    target: Reference,
    run: Marched,
    errors: Table,
    wall: float | None,
    steps: int,
    per_step: float,
) -> Table:
    """The row of a run with so many steps, which took `wall` [s]; without its step."""
    us_per_step = None
    wall_s_per_simulated_s = None
    if wall:
        us_per_step = 1e6 * wall / steps
        wall_s_per_simulated_s = wall / target.horizon
    return {
        "integrator": scheme.integrator,
        "gamma": scheme.gamma,
        "solver": stepper.solver_name,
        "dtype": scheme.dtype,
        "label": scheme.label,
        **errors,
        "us_per_step": us_per_step,
        "wall_s_per_simulated_s": wall_s_per_simulated_s,
        "operations_per_simulated_s": per_step * steps / target.horizon,
        "status": status_of(run, stepper),
        "retried_steps": int(run.retried[-1]),
    }


def _row_of_accuracy(
    model: Model,
    s: State,
    scheme: Scheme,
    stepper: Stepper,
    target: Reference,
    accuracy: float,
    timing: Timing,
    per_step: float,
) -> Table:
    """The row of a scheme whose steps follow an accuracy; its `dt` is the mean step."""
    walls, pick = timing
    again = partial(march_with_accuracy, stepper, model, s, target.grid, accuracy, len(target.t))
    found = jax.tree.map(np.asarray, again())
    wall = None
    errors = NOTHING
    if status_of(found.run, stepper) == "ok":
        errors = row_errors(model, s, found.run, stepper, target)
        wall = pick(walls(again))
    tries = int(found.taken + found.refused)
    return _row(scheme, stepper, target, found.run, errors, wall, tries, per_step) | {
        "label": f"{scheme.label}, accuracy",
        "dt": target.horizon / max(int(found.taken), 1),
        "accuracy": accuracy,
        "refused_steps": int(found.refused),
        "rms_tension_error_n": None,  # means between saved times
        "retried_steps": 0,
    }


def _single(x: ArrayLike) -> ArrayLike:
    if jnp.issubdtype(jnp.asarray(x).dtype, jnp.floating):
        return jnp.asarray(x, jnp.float32)
    return x


def _walls(run: Callable[[], object], repeats: int, before: float = 0.0) -> list[float]:
    """Wall times of compiled runs [s]; only a few if they are long, none if one took `before` and is long."""
    enough = 0.2  # total time [s] after which no more are run
    times = [before] if before > enough else []
    while len(times) < repeats and sum(times) <= enough:
        started = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - started)
    return times


#: Minimum ratio of a measured error to that of the reference.
RESOLVED = 100.0


def row_errors(model: Model, s: State, run: Marched, stepper: Stepper, target: Reference) -> Table:
    """Errors of a run on the reference's grid, its energy drift and the damping equivalent to this drift."""
    links = link_vectors(model, run.r, target.t)
    angle = rms_angle(links, target.links)
    loss = energy_loss(model, s, run, target.t)
    path = float(run.path[-1])
    equivalent_linear_damping = 0.0
    if path > 0:
        equivalent_linear_damping = float(loss[-1]) / path
    return {
        "rms_angle_error_rad": angle,
        "rms_position_error_m": rms_position(run.r, target.r),
        "rms_tension_error_n": rms(_tension_errors(run, stepper, target.tension)),
        "energy_drift_j": float(np.max(np.abs(loss))),
        "equivalent_linear_damping": equivalent_linear_damping,
        "resolved": bool(RESOLVED * target.error <= angle < math.inf),
    }


def energy_loss(model: Model, s: State, run: Marched, t: np.ndarray) -> np.ndarray:
    """Energy balance error since the start (k,) [J]: energies of the raw velocities minus all counted work."""
    dtype = model.dtype
    states = [jnp.asarray(x, dtype) for x in (run.r, run.v, t)]
    energies = np.asarray(_energies(model, *states))
    start = float(_energies(model, s.r[None], s.v[None], s.t[None])[0])
    with np.errstate(invalid="ignore", over="ignore"):
        return start - (energies - np.sum(np.asarray(run.work, float), axis=1))


@cached_jit()
def _energies(model: Model, r: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
    """Energies (k,) [J] of states (k, nodes, 3) at times (k,)."""

    def total(r: jax.Array, v: jax.Array, time: jax.Array) -> jax.Array:
        k = model.instant(r, v, time)
        return model.kinetic_energy(k) + model.potential_energy(k)

    return jax.vmap(total)(r, v, t)


def _tension_errors(run: Marched, stepper: Stepper, reference: np.ndarray) -> Rows:
    """Differences (k - 1, n) [N]; tensions from within steps are interpolated between both sides of a saved time."""
    ending = run.tension[:-1, 0]
    beginning = run.tension[1:, 1]
    share = stepper.integrator.tension_time
    if share == 1.0:
        seen = ending
    else:
        seen = share * ending + (1.0 - share) * beginning
    with np.errstate(invalid="ignore"):
        return seen - reference[:-1]


def orders(rows: list[Table]) -> dict[str, float]:
    """Slope of log error over log step of each scheme, through its finest three resolved steps below 0.1 rad."""
    found = {}
    for label in dict.fromkeys(row["label"] for row in rows):
        # mean steps that follow an accuracy have no order
        good = []
        for r in rows:
            if r["label"] == label and r["status"] == "ok" and r["resolved"] and "accuracy" not in r:
                good.append(r)
        good = sorted((r for r in good if r["rms_angle_error_rad"] < 0.1), key=lambda r: r["dt"])[:3]
        if len(good) >= 2:
            x = np.log([r["dt"] for r in good])
            y = np.log([r["rms_angle_error_rad"] for r in good])
            found[label] = float(np.polyfit(x, y, 1)[0])
    # errors that do not fall with the step are those of rounding, which have no order
    return {label: order for label, order in found.items() if order > 0.5}
