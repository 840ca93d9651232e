"""`simulate`: from a scene to a solution, with progress, status and provenance."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError, SimulationError
from dropper_jax.base.programs import kept
from dropper_jax.integrators import OPTIONS
from dropper_jax.integrators.projected import ProjectedRungeKutta
from dropper_jax.load.checks_motion import motion_warnings
from dropper_jax.load.checks_water import sea_warnings
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Frozen, Model, Parted, state, work_names
from dropper_jax.residual import Implicit
from dropper_jax.run.bodies import body_motion
from dropper_jax.run.build import SceneLike, allowed_error, build_model, stepper_of
from dropper_jax.run.carry import Last, done, first_row, last_row, may_go_on, named, refused, restored, same_scene
from dropper_jax.run.failures import breaks, words
from dropper_jax.run.pieces import compile_run, first_carry, go_through
from dropper_jax.run.remarks import pose_remarks
from dropper_jax.run.resolution import judged, without_push
from dropper_jax.run.room import check_room
from dropper_jax.run.rows import BLOCK, InMemory, OnDisk, let_go
from dropper_jax.run.solution import Solution
from dropper_jax.run.start import initial_state
from dropper_jax.run.stiffness import stiffness_remarks
from dropper_jax.stepping.adaptive import Adaptive, Within
from dropper_jax.stepping.controlled import Controlled
from dropper_jax.stepping.integrate import DRIFT_LIMIT, Trajectory, begin
from dropper_jax.stepping.observe import Observed, observe
from dropper_jax.stepping.stepper import TOO_FAR, Stepper


@kept()
def _observe(
    model: Model, r: jax.Array, v: jax.Array, t: jax.Array, parted: Parted | None, own: dict[str, Frozen]
) -> Observed:
    return jax.vmap(observe, in_axes=(None, 0, 0, 0, 0, 0))(model, r, v, t, parted, own)


def simulate(
    scene: SceneLike,
    *,
    dt: float | None = None,
    duration: float | None = None,
    integrator: str | None = None,
    solver: str | None = None,
    dtype: str | None = None,
    save_every: int | None = None,
    step_tolerance: float | None = None,
    error_tolerance: float | None = None,
    progress: Callable[[float, str], None] | None = None,
    throw: bool = False,
    tolerance: float | None = None,
    errors: bool = False,
    skip: float = 0.0,
    start: Solution | None = None,
    scratch: str | Path | None = None,
    **settings: Any,
) -> Solution:
    """Simulate a scene; what is not given is taken from its `[run]`.

    Args:
        scene: packaged name, TOML file, plain values or a `Scene`.
        dt, duration: time step and simulated time [s]; the duration is rounded up to whole saved steps.
        integrator, solver: see `make_stepper`.
        dtype: `float64` or `float32`.
        save_every: steps between saved times.
        step_tolerance: speed [m/s] that the change of a tension within a step may give to a link of mean mass. Steps
            then follow the snaps of lines (see `stepping.adaptive`), dt is the interval between saved times and the
            longest step, and saved tensions are means over it; `tension_min` and `tension_max` keep the extremes.
        error_tolerance: error of a step in places [m] and velocities [m/s] that tsit5 and dop853 allow (see
            `stepping.controlled`); dt is then the interval between states that can be saved, not a step.
        progress: called with the fraction done and a line of text.
        throw: raise `SimulationError` (with the partial solution) where the status is not `ok`.
        tolerance: wanted RMS angle error [rad]. Without `dt` a short pilot chooses the step (see
            `study.step_choice`); with it the pilot only checks, and a run that misses is `not_converged`. The
            estimate and the time it holds for are in `settings["estimated_error"]`.
        errors: run again with smaller steps and more links (about 12 times the cost), and keep the loads with an
            estimate of their errors in `settings["load_errors"]` (see `study.load_errors`).
        skip: time at the start [s] that those loads leave out.
        start: a run of the same scene to go on from its last state, whose times count on (see `Solution.continued`);
            values of `[run]` but scheme and precision may be others.
        scratch: an empty folder in which saved states are kept as they come, for runs that are larger than memory; the
            solution's arrays are mapped from there, and last as long as it does.
        **settings: options of the scheme (gamma, rho_infinity) and further fields of `Stepper` (iterations,
            residual_tolerance, extra, halvings).

    Raises:
        SceneError: for anything a user can mend, before the run starts.
    """
    given = {
        "dt": dt,
        "duration": duration,
        "integrator": integrator,
        "solver": solver,
        "dtype": dtype,
        "save_every": save_every,
        "step_tolerance": step_tolerance,
        "error_tolerance": error_tolerance,
        **{name: settings.pop(name) for name in OPTIONS if name in settings},
    }
    scene = load_scene(scene)
    changed = {f"run.{key}": value for key, value in given.items() if value is not None}
    scene = scene.with_values(changed) if changed else scene
    _check_skip(skip, errors, scene.run.duration)
    if start is not None:
        may_go_on(start.status, start.failure)
        same_scene(scene, start.scene)
        if tolerance is not None or errors:
            what = "errors" if errors else "tolerance"
            raise SceneError(f"{what}: runs the scene from its start; allowed: without a run to go on from")
    say = progress or (lambda fraction, text: None)
    choice = None
    if tolerance is not None:
        say(0.0, "choosing the step")
        scene, choice = _choose_step(scene, tolerance, dt is not None)
    run = scene.run
    model = build_model(scene)
    renamed = {"tolerance" if key == "residual_tolerance" else key: value for key, value in settings.items()}
    stepper = stepper_of(model, run, **renamed)  # a pairing that makes no sense is refused before the start is sought
    say(0.0, "finding the start")
    first, since = _first(stepper, model, scene, start)
    folder = None if scratch is None else Path(scratch)
    check_room(model, first.row, run, folder)
    about = {"scene": scene.as_written(), "settings": settings, "went_on": start is not None}
    rows = InMemory() if folder is None else OnDisk(folder, about)
    begun = time.perf_counter()
    compiled = compile_run(stepper, model, first.carry, run)
    compile_s = time.perf_counter() - begun
    gone = go_through(compiled, run.saves, say, rows)
    trajectory, within, carry = gone.trajectory, gone.beside, gone.carry
    solution = _solution(scene, stepper, model, first, since, trajectory, dict(settings), rows)
    if isinstance(carry, Adaptive):
        solution = _followed(solution, within, refused(carry) - refused(first.carry))
    if isinstance(carry, Controlled):
        solution = _controlled(solution, stepper, model, trajectory, within, carry, first.carry)
    if solution.first_bad is None:
        solution = replace(solution, last=named(Last(last_row(trajectory), carry)))
    solution = replace(solution, compile_s=compile_s + gone.late_s, run_s=gone.run_s)
    if gone.interrupted:
        told = (gone.refused,) if gone.refused else ()
        solution = replace(solution, status="interrupted", warnings=(*solution.warnings, *told))
    solution = judged(solution)
    if choice is not None:
        solution = _within(solution, tolerance, choice)
    if errors and solution.status == "ok":
        solution = _with_errors(solution, scene, skip, settings, say)
    say(1.0, solution.status)
    if throw and solution.status != "ok":
        raise SimulationError(solution.failure, solution)
    return solution


class _Since(NamedTuple):
    """What saved times count from: t [s] and saved times behind the first one."""

    origin: float = 0.0
    saves: int = 0


def _first(stepper: Stepper, model: Model, scene: Scene, before: Solution | None) -> tuple[Last, _Since]:
    """Where a run begins, at its scene's start or at the end of the run before, and what its times count from."""
    run, names = scene.run, work_names(model) if stepper.track_work else ()
    if before is None:
        s = initial_state(model, scene.start)
        return Last(first_row(s, len(names)), first_carry(stepper, model, s, run)), _Since()

    def kind(model: Model) -> Last:
        s = state(model, jnp.zeros((model.free_nodes, 3), model.dtype))
        return Last(first_row(s, len(names)), first_carry(stepper, model, s, run))

    last, used = restored(jax.eval_shape(kind, model), before.last), before.settings
    since = _Since(*(before.continues or {"origin_s": 0.0, "saves": 0}).values())
    since = since._replace(saves=since.saves + len(before.t) - 1)
    if (run.dt, run.save_every) != (used["dt"], used["save_every"]):
        since = _Since(float(before.t[-1]))
        if isinstance(last.carry, Controlled):
            here = last.carry._replace(origin=jnp.asarray(since.origin, model.dtype), saved=jnp.zeros((), jnp.int32))
            last = last._replace(carry=here)
    return last, since


def solution_of_rows(scene: Scene, folder: Path, settings: dict[str, Any]) -> Solution:
    """The run that a killed process left in its scratch folder, as far as its states are whole.

    Raises:
        SceneError: its steps were held by their error, which needs more than the states.
    """
    model = build_model(scene)
    renamed = {"tolerance" if key == "residual_tolerance" else key: value for key, value in settings.items()}
    stepper = stepper_of(model, scene.run, **renamed)
    if isinstance(stepper.integrator, ProjectedRungeKutta):
        raise SceneError(f"integrator: {stepper.integrator.name} holds its steps by their error; allowed: any other")
    first, since = _first(stepper, model, scene, None)
    s = begin(stepper, model, initial_state(model, scene.start)).state
    beside = None if scene.run.step_tolerance is None else Within(*(0.0,) * len(Within._fields))
    rows = OnDisk.left(folder, (Trajectory(*(0.0,) * 8, s.parted, s.own), beside))
    run, within = rows.joined(scene.run.saves)
    solution = _solution(scene, stepper, model, first, since, run, dict(settings), rows)
    return judged(solution if within is None else _followed(solution, within, 0))


def _choose_step(scene: Scene, tolerance: float, fixed: bool) -> tuple[Scene, Any]:
    """The scene with its step chosen for the tolerance (or as it is, where the caller fixed it), and the estimate."""
    from dropper_jax.study.step_choice import choose_step, estimate_error  # noqa: PLC0415

    if fixed:
        return scene, estimate_error(scene)
    choice = choose_step(scene, tolerance)
    return scene.with_values({"run.dt": choice.dt}), choice


def _within(solution: Solution, tolerance: float, choice: Any) -> Solution:
    """The solution with its estimated error; one that misses the tolerance is not called ok."""
    solution = replace(solution, settings={**solution.settings, "estimated_error": choice.summary()})
    if choice.estimate <= tolerance or solution.status != "ok":
        return solution
    text = f"estimated error {choice.estimate:.2g} rad exceeds the tolerance of {tolerance:g} rad: take a smaller step"
    return replace(solution, status="not_converged", warnings=(*solution.warnings, text))


def _check_skip(skip: float, errors: bool, duration: float) -> None:
    if skip and not errors:
        raise SceneError(f"--skip: {skip:g} s is left out of the loads with errors; allowed: beside --errors")
    if not 0.0 <= skip < duration:
        raise SceneError(f"--skip: {skip:g} is out of range; allowed: 0 to less than the {duration:g} s of the run")


def _with_errors(
    solution: Solution, scene: Scene, skip: float, settings: dict[str, Any], say: Callable[[float, str], None]
) -> Solution:
    """The solution with its loads and their errors; lines whose peaks are off are warned of."""
    from dropper_jax.study.load_errors import load_errors  # noqa: PLC0415

    again = lambda variant: simulate(variant, **settings)  # noqa: E731
    found = load_errors(scene, again, skip, solution, lambda done, what: say(done, f"errors: {what}"))
    told = tuple(f"{name}: its largest tension is not resolved (see the errors)" for name in found["not_resolved"])
    return replace(solution, settings={**solution.settings, "load_errors": found}, warnings=(*solution.warnings, *told))


def _solution(
    scene: Scene,
    stepper: Stepper,
    model: Model,
    first: Last,
    since: _Since,
    run: Trajectory,
    extra: dict[str, Any],
    rows: InMemory,
) -> Solution:
    dt, every = scene.run.dt, scene.run.save_every
    start, before = first.row, done(first.carry)
    good = _good_saves(run)
    bad_step = int(run.first_bad[-1])
    kept = jax.tree.map(lambda a: a[: max(good, 0)], run)
    join = rows.join
    t = since.origin + (since.saves + np.arange(good + 1)) * (every * dt)
    parted = jax.tree.map(join, start.parted, kept.parted)
    own = jax.tree.map(join, start.own, kept.own)
    seen = _seen(model, (join(start.r, kept.r), join(start.v, kept.v), t.astype(model.dtype), parted, own), rows)
    broken = breaks(scene, jax.tree.map(lambda a: a[-1], parted))
    middle = (1.0 - stepper.integrator.tension_time) * dt
    names = work_names(model) if stepper.track_work else ()
    work = join(start.work, kept.work)
    status, first_bad = "ok", None
    if bad_step >= 0:
        residual = float(run.residual[min((bad_step - before) // every, len(run.residual) - 1)])
        status, reason = _reason(residual, stepper, model)
        when = float(t[0]) + (bad_step - before + 1) * dt
        first_bad = {"step": bad_step + 1, "time_s": when, "residual": residual, "reason": reason}
    settings = {
        "integrator": stepper.integrator.name,
        "solver": stepper.solver,
        "dt": dt,
        "duration": scene.run.duration,
        "steps": scene.run.steps,
        "dtype": str(model.dtype),
        **{key: getattr(stepper.integrator, key, None) for key in OPTIONS},
        "residual_tolerance": stepper.limit(model),
        "iterations": stepper.iterations,
        "save_every": every,
        **{key: value for key, value in extra.items() if key not in ("iterations", "residual_tolerance")},
    }
    return Solution(
        scene=scene,
        settings=settings,
        t=t,
        positions=seen.each.positions,
        velocities=seen.each.velocities,
        tension=without_push(scene, join(start.tension, kept.tension), stepper.limit(model)),
        t_tension=np.concatenate([t[:1], t[1:] - middle]),
        kinetic=seen.each.kinetic,
        potential=seen.each.potential,
        work=work,
        work_names=names,
        step_status=np.zeros(good + 1, np.int8),
        status=status,
        failed_steps=int(np.sum(run.failed)) if bad_step < 0 else 1,
        retried_steps=int(np.sum(run.retried[: good + 1])),
        first_bad=first_bad,
        max_residual=float(np.max(run.residual[: good + 1])),
        max_closure_error=float(np.max(seen.each.closure)),
        versions=_versions(),
        broken=broken,
        own=_named(own),
        continues={"origin_s": since.origin, "saves": since.saves} if before or since.origin else None,
        **seen.bodies,
        warnings=(
            *scene.notes,
            *_precision(scene, model),
            *(() if model.sea is None else sea_warnings(scene, model.sea)),
            *motion_warnings(scene),
            *(() if t[0] else _at_rest(scene, seen.each.positions[0], np.asarray(start.tension))),
            *(words(row) for row in broken),
        ),
    )


class _Seen(NamedTuple):
    """What is reported of all saved times: of the lines, and of the bodies by name."""

    each: Observed
    bodies: dict[str, np.ndarray]


def _seen(model: Model, states: tuple[Any, ...], rows: InMemory) -> _Seen:
    """What is reported of states (k, ...): places, velocities, times, what parted, effects' own.

    Many go by blocks of one length, so that they share a program and never stand in memory together.
    """
    count = len(states[2])
    if count <= BLOCK:
        states = jax.tree.map(jnp.asarray, states)
        return _Seen(jax.tree.map(np.asarray, _observe(model, *states)), body_motion(model, *states[:2]))
    found = None
    for first in range(0, count, BLOCK):
        at = np.arange(first, first + BLOCK).clip(max=count - 1)
        block = jax.tree.map(lambda a, at=at: jnp.asarray(a[at]), states)
        seen = _Seen(jax.tree.map(np.asarray, _observe(model, *block)), body_motion(model, *block[:2]))
        if found is None:
            found = jax.tree.map(lambda a: rows.empty((count, *a.shape[1:]), a.dtype), seen)
        for whole, part in zip(jax.tree.leaves(found), jax.tree.leaves(seen), strict=True):
            whole[first : first + BLOCK] = part[: count - first]
        let_go(jax.tree.leaves((states, found)))
    return found


def _followed(solution: Solution, within: Within, refused: int) -> Solution:
    """The solution of steps that follow the snaps: what is known between saved times, steps taken and refused."""
    good = len(solution.t) - 1
    first = solution.tension[:1]
    kept = {name: np.concatenate([first, getattr(within, name)[:good]]) for name in ("least", "largest")}
    square = np.concatenate([first**2, within.square[:good]])
    middle = np.concatenate([solution.t[:1], solution.t[1:] - 0.5 * solution.settings["dt"]])
    taken = {"steps": int(np.sum(within.steps[:good])), "refused_steps": refused}
    return replace(
        solution,
        t_tension=middle,
        tension_min=kept["least"],
        tension_max=kept["largest"],
        tension_square=square,
        settings={**solution.settings, **taken, "step_tolerance": solution.scene.run.step_tolerance},
    )


def _controlled(
    solution: Solution,
    stepper: Stepper,
    model: Model,
    run: Trajectory,
    h: np.ndarray,
    carry: Controlled,
    first: Controlled,
) -> Solution:
    """The solution of steps held by their error: how many were taken and refused, where they failed, what held them."""
    good = len(solution.t) - 1
    taken = {"steps": int(carry.taken - first.taken), "refused_steps": int(carry.refused - first.refused)}
    taken["error_tolerance"] = allowed_error(stepper, model, solution.scene.run)
    told = stiffness_remarks(stepper.integrator, model, run.r[:good], run.v[:good], solution.t[1:], h[:good])
    bad = solution.first_bad
    if bad is not None:
        why = "places or velocities are infinite or undefined" if int(carry.bad) == 2 else "its error is not small"
        reason = f"{why} however short the step"
        bad = {"step": int(carry.taken) + 1, "time_s": float(carry.now.t), "residual": math.nan, "reason": reason}
        solution = replace(solution, status="non_finite" if int(carry.bad) == 2 else "not_converged")
    settings, warnings = {**solution.settings, **taken}, (*solution.warnings, *told)
    return replace(solution, settings=settings, warnings=warnings, first_bad=bad, max_residual=0.0)


def _at_rest(scene: Scene, positions: np.ndarray, tension: np.ndarray) -> tuple[str, ...]:
    return pose_remarks(scene, positions, tension) if scene.start.kind == "static" else ()


def _precision(scene: Scene, model: Model) -> tuple[str, ...]:
    """A warning where JAX did not give the precision that was asked for."""
    if str(model.dtype) == scene.run.dtype:
        return ()
    return (f"run.dtype: {scene.run.dtype} was asked for, but JAX computes in {model.dtype} (JAX_ENABLE_X64 is off)",)


def _explicit(stepper: Stepper, model: Model) -> str:
    """What an explicit scheme needs on lines that stretch: about 2/omega, omega^2 = 4 EA/(L m) of the stiffest link."""
    line = model.line
    if isinstance(stepper.integrator, Implicit) or not line.axial.elastic:
        return ""
    omega = 2.0 * float(np.sqrt(np.max(np.asarray(line.axial.EA / (line.length * line.mass)))))
    return (
        f"; {stepper.integrator.name} is explicit, and these lines call for steps of about {2.0 / omega:.1g} s or less"
    )


def _good_saves(run: Trajectory) -> int:
    """Saved times before the first failed step."""
    bad = np.flatnonzero(run.first_bad >= 0)
    return int(bad[0]) if bad.size else len(run.first_bad)


def _reason(residual: float, stepper: Stepper, model: Model) -> tuple[str, str]:
    """Status and reason of a step that failed."""
    limit = stepper.limit(model)
    if not np.isfinite(residual):
        return "non_finite", f"the step gave infinite or undefined values{_explicit(stepper, model)}"
    if residual >= TOO_FAR:
        parts = f", in the smallest of {2**stepper.halvings} parts of a step" if stepper.iterations else ""
        return "retry_exhausted", f"lines in contact moved by more than half their radius{parts}; take a smaller step"
    if residual <= limit:
        return "not_converged", f"this scheme lets lengths drift, and a link has changed by more than {DRIFT_LIMIT:.0%}"
    what = f"the residual stayed above the tolerance {limit:.0e}"
    if not stepper.halvings:
        return "not_converged", what
    return "retry_exhausted", f"{what} after halving {stepper.halvings} times"


def _named(own: dict[str, Frozen]) -> dict[str, np.ndarray]:
    """Leaves of what is effects' own by the effect's name, numbered where there are several."""
    found = {}
    for name, tree in own.items():
        leaves = jax.tree.leaves(tree)
        found |= {name if len(leaves) == 1 else f"{name}.{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
    return found


def _versions() -> dict[str, str]:
    found = {name: metadata.version(name) for name in ("jax", "jaxlib", "numpy")}
    try:
        found["dropper-jax"] = metadata.version("dropper-jax")
    except metadata.PackageNotFoundError:
        found["dropper-jax"] = "not installed"
    return {**found, "python": platform.python_version(), "backend": jax.default_backend()}
