"""Build a solution from the output of a run: observed states, work, status with its reason, and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from dropper_jax.base.machine import versions
from dropper_jax.base.read import Table
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.scene import Scene
from dropper_jax.load.sea_warnings import sea_warnings
from dropper_jax.model import Frozen, Model, work_names
from dropper_jax.plausibility.plausibility import scene_warnings
from dropper_jax.plausibility.pose_remarks import pose_remarks
from dropper_jax.quantities.bending import crushed_links
from dropper_jax.quantities.end_links import Motion
from dropper_jax.quantities.step_extremes import extremes_by_signal, saved_signal
from dropper_jax.quantities.twist import twist_warnings
from dropper_jax.quantities.variables import EXTREMES
from dropper_jax.residual import TOO_FAR, Embedded, Stepper
from dropper_jax.run.chunks import RunOutcome
from dropper_jax.run.damping_limit import damping_warnings
from dropper_jax.run.end_of_run import Last, last_row, name_leaves, trajectory_rows
from dropper_jax.run.observation import SavedStates, break_in_words, breaks, observe_states
from dropper_jax.run.quality_checks import with_quality_checks
from dropper_jax.run.row_store import InMemory
from dropper_jax.run.samples import Kind
from dropper_jax.scene import RunSpec, sliced_lines
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.stepping.halving import DRIFT_LIMIT
from dropper_jax.stepping.progress import Trajectory
from dropper_jax.stepping.step_change import STEP_CHANGES, books_changes
from dropper_jax.stepping.step_control import allowed_error

#: Fraction of the steps that may be of the shortest length with a larger error, as after a start or a snap, without a
#: warning.
SHORTEST_SHARE = 0.01


class TimeOrigin(NamedTuple):
    """Origin of the saved times: t [s] and the number of earlier saved times."""

    origin_s: float = 0.0
    saves: int = 0


class PreparedRun(NamedTuple):
    """Everything that a run needs.

    Attributes:
        scene, stepper, model: of the run.
        first: its initial state and carry.
        origin: of its times.
        rows: store of its saved states.
        settings: of the stepping, as the caller gave them.
    """

    scene: Scene
    stepper: Stepper
    model: Model
    first: Last
    origin: TimeOrigin
    rows: InMemory
    settings: Table


def build_solution(kind: type[Kind], prepared: PreparedRun, outcome: RunOutcome) -> Kind:
    """The result of a run: its observed states, steps, final state and warnings."""
    run = outcome.trajectory
    solution = _observe_run(kind, prepared, run)
    solution = _with_step_extremes(solution, run.extremes, prepared)
    solution = _with_adaptive_steps(solution, prepared, outcome)
    if solution.first_bad is None:
        solution = replace(solution, last=name_leaves(Last(last_row(run), outcome.carry)))
    if outcome.interrupted:
        refused = (outcome.refused,) if outcome.refused else ()
        solution = replace(solution, status="interrupted", warnings=(*solution.warnings, *refused))
    return with_quality_checks(solution)


def _observe_run(kind: type[Kind], prepared: PreparedRun, run: Trajectory) -> Kind:
    """The solution of the good saves of a run, observed at their times."""
    scene = prepared.scene
    stepper = prepared.stepper
    model = prepared.model
    origin = prepared.origin
    interval = scene.run.interval
    dt = interval / scene.run.save_every
    start = prepared.first.row
    good = int(np.sum(run.first_bad < 0))  # a step that failed stays the first bad one
    t = origin.origin_s + (origin.saves + np.arange(good + 1)) * interval
    saved = jax.tree.map(lambda first, later: prepared.rows.join(first, later[:good]), start, trajectory_rows(run))
    states = SavedStates(saved.r, saved.v, t.astype(model.dtype), saved.parted, saved.own)
    observed = observe_states(model, states, prepared.rows)
    closure = observed.pop("closure")
    status = "ok"
    first_bad = None
    failed_steps = int(np.sum(run.failed))
    if run.first_bad[-1] >= 0:
        status, first_bad = _first_failure(prepared, run, float(t[0]))
        failed_steps = 1
    continues = None
    if prepared.first.carry.done or origin.origin_s:
        continues = origin._asdict()
    found = kind(
        scene=scene,
        settings=_settings_of(prepared),
        t=t,
        tension=without_push(scene, saved.tension, stepper.limit(model)),
        t_tension=np.concatenate([t[:1], t[1:] - (1.0 - stepper.integrator.tension_time) * dt]),
        work=saved.work,
        work_names=run_work_names(stepper, model, scene.run),
        step_status=np.zeros(good + 1, np.int8),
        status=status,
        failed_steps=failed_steps,
        retried_steps=int(np.sum(run.retried[: good + 1])),
        first_bad=first_bad,
        max_residual=float(np.max(run.residual[: good + 1])),
        max_closure_error=float(np.max(closure)),
        versions=versions(),
        broken=breaks(scene, jax.tree.map(lambda a: a[-1], saved.parted)),
        own=_states_by_effect(saved.own),
        continues=continues,
        **observed,
    )
    return replace(found, warnings=tuple(_run_warnings(found, model, np.asarray(start.tension))))


def without_push(scene: Scene, tension: np.ndarray, tolerance: float) -> np.ndarray:
    """The tensions (k, n) [N], changed in place: zero for slack ropes if negative within the step tolerance.

    Axial residuals are lengths, so a relative tolerance of the length is a relative tolerance of EA for tensions.
    """
    for line, where in sliced_lines(scene):
        if line.axial_law == "rope" and line.EA is not None:
            own = tension[:, where.links]
            tension[:, where.links] = np.where((own < 0.0) & (own >= -tolerance * line.EA), 0.0, own)
    return tension


def _first_failure(prepared: PreparedRun, run: Trajectory, start_s: float) -> tuple[str, Table]:
    """Status of a run that failed, and its first bad step: number, time, residual and reason.

    Args:
        start_s: time of the initial state [s].
    """
    spec = prepared.scene.run
    step = int(run.first_bad[-1])
    since_start = step - int(prepared.first.carry.done)
    residual = float(run.residual[min(since_start // spec.save_every, len(run.residual) - 1)])
    status, reason = _reason(residual, prepared.stepper, prepared.model)
    time_s = start_s + (since_start + 1) * (spec.interval / spec.save_every)
    return status, {"step": step + 1, "time_s": time_s, "residual": residual, "reason": reason}


def _settings_of(prepared: PreparedRun) -> Table:
    """Everything that a run was made with."""
    run = prepared.scene.run
    stepper = prepared.stepper
    model = prepared.model
    return {
        "integrator": stepper.integrator.name,
        "solver": stepper.solver_name,
        "dt": run.interval / run.save_every,
        "duration": run.duration,
        "steps": run.steps,
        "dtype": str(model.dtype),
        **{key: getattr(stepper.integrator, key, None) for key in OPTIONS},
        "residual_tolerance": stepper.limit(model),
        "iterations": stepper.iterations,
        "save_every": run.save_every,
        **{key: value for key, value in prepared.settings.items() if key not in ("iterations", "residual_tolerance")},
    }


def _run_warnings(solution: Kind, model: Model, tension: np.ndarray) -> Iterator[str]:
    """Warnings on a scene, its start with these tensions (n,) [N], what broke and how ropes are twisted."""
    scene = solution.scene
    at_rest = scene.start.is_static and not solution.t[0]
    yield from scene_warnings(scene, at_rest)
    if str(model.dtype) != scene.run.dtype:
        yield (f"run.dtype: {scene.run.dtype} was requested, but JAX computes in {model.dtype} (JAX_ENABLE_X64 is off)")
    if model.sea is not None:
        yield from sea_warnings(scene, model.sea)
    if at_rest:
        yield from pose_remarks(scene, solution.positions[0], tension)
    for row in solution.broken:
        yield break_in_words(row)
    yield from crushed_links(scene, solution.positions)
    if solution.torque is not None:
        yield from twist_warnings(scene, solution.positions, solution.tension, solution.torque)


def run_work_names(stepper: Stepper, model: Model, run: RunSpec) -> tuple[str, ...]:
    """Names of the works of a run."""
    if not stepper.track_work:
        return ()
    names = work_names(model)
    if run.accuracy is not None and books_changes(stepper, model):
        return (*names, STEP_CHANGES)
    return names


def _with_step_extremes(solution: Kind, extremes: Extremes | None, prepared: PreparedRun) -> Kind:
    """The solution with the extremes of its signals over all steps up to the last good save.

    Args:
        extremes: rows of the run (q, m), None if every step is saved; the first row of the solution is that of the
            start.
    """
    if extremes is None:
        return solution
    scene = solution.scene
    good = len(solution.t) - 1
    start = Motion(scene, solution.t[:1], solution.positions[:1], solution.t_tension[:1], solution.tension[:1])
    found = {}
    for signal, of_signal in extremes_by_signal(scene, extremes).items():
        value = saved_signal(signal, start)[0]
        when = np.full(value.shape, solution.t_tension[0])
        for name, first, later in zip(EXTREMES, (value, value, when, when), of_signal, strict=True):
            found[f"{signal}_{name}"] = prepared.rows.join(first.astype(later.dtype), later[:good])
    limit = prepared.stepper.limit(prepared.model)
    found["tension_min"] = without_push(scene, found["tension_min"], limit)
    return replace(solution, **found)


def _with_adaptive_steps(solution: Kind, prepared: PreparedRun, outcome: RunOutcome) -> Kind:
    """The solution with mean squares between saved times and counts of steps, if the run follows an accuracy."""
    run = outcome.trajectory
    within = run.within
    start = prepared.first.carry.control
    control = outcome.carry.control
    accuracy = solution.scene.run.accuracy
    if accuracy is None or within is None or control is None or start is None:
        return solution
    scheme = prepared.stepper.integrator
    model = prepared.model
    good = len(solution.t) - 1
    steps = within.steps[:good]
    interval = solution.settings["dt"]
    shortest = int(control.shortest) - int(start.shortest)
    taken = {
        "steps": int(np.sum(steps)),
        "refused_steps": int(control.refused) - int(start.refused),
        "shortest_steps": shortest,
        "accuracy": accuracy,
    }
    warnings = list(solution.warnings)
    if solution.first_bad is None and shortest > SHORTEST_SHARE * taken["steps"]:
        counted = f"{shortest} of {taken['steps']} steps are as short as steps get"
        warnings.append(
            f"accuracy: {counted} and have a larger error than {accuracy:g} allows. Use a larger run.accuracy"
        )
    if isinstance(scheme, Embedded):
        taken["error_tolerance"] = float(allowed_error(accuracy, model.dtype))
        warnings += damping_warnings(scheme, model, run.r[:good], run.v[:good], solution.t[1:], interval / steps)
    return replace(
        solution,
        t_tension=np.concatenate([solution.t[:1], solution.t[1:] - 0.5 * interval]),
        tension_square=np.concatenate([solution.tension[:1] ** 2, within.square[:good]]),
        settings={**solution.settings, **taken},
        warnings=tuple(warnings),
    )


def _reason(residual: float, stepper: Stepper, model: Model) -> tuple[str, str]:
    """Status and reason of a step that failed."""
    limit = stepper.limit(model)
    if not np.isfinite(residual):
        what = "the step gave non-finite values"
        line = model.line
        if not stepper.integrator.implicit and line.axial.elastic:
            # the step limit is about 2/omega, omega^2 = 4 EA/(L m) of the stiffest link
            omega = 2.0 * float(np.sqrt(np.max(np.asarray(line.axial.axial_stiffness() / (line.length * line.mass)))))
            limit_s = f"its stability limit with these lines is about {2.0 / omega:.1g} s"
            what = f"{what}; {stepper.integrator.name} is explicit; {limit_s}"
        return "non_finite", what
    if residual >= TOO_FAR:
        parts = ""
        if stepper.integrator.implicit:
            parts = f", in the shortest of {2**stepper.halvings} substeps"
        return "retry_exhausted", f"lines in contact moved by more than half their radius{parts}; take a smaller step"
    if residual <= limit:
        return "not_converged", f"constraint drift: the length of a link has changed by more than {DRIFT_LIMIT:.0%}"
    what = f"the residual stayed above the tolerance {limit:.0e}"
    if not stepper.halvings:
        return "not_converged", what
    return "retry_exhausted", f"{what} after halving {stepper.halvings} times"


def _states_by_effect(internal: dict[str, Frozen]) -> dict[str, np.ndarray]:
    """Leaves of the internal states of effects by the name of the effect, numbered if there are several."""
    found = {}
    for name, tree in internal.items():
        leaves = jax.tree.leaves(tree)
        for i, leaf in enumerate(leaves):
            key = name if len(leaves) == 1 else f"{name}.{i}"
            found[key] = np.asarray(leaf)
    return found
