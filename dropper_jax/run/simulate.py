"""`simulate`: from a scene to a solution, with progress, status and provenance."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError, SimulationError
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.scene import Scene
from dropper_jax.load.source import load_scene
from dropper_jax.model import Model, state, work_names
from dropper_jax.run.assembled import Since, assembled, controlled, followed
from dropper_jax.run.build import SceneLike, build_model, stepper_of
from dropper_jax.run.carry import Last, first_row, last_row, may_go_on, named, refused, restored, same_scene
from dropper_jax.run.pieces import compile_run, first_carry, go_through
from dropper_jax.run.remarks import check_stretch
from dropper_jax.run.resolution import judged
from dropper_jax.run.room import check_room
from dropper_jax.run.rows import InMemory, OnDisk
from dropper_jax.run.samples import finished
from dropper_jax.run.solution import Solution
from dropper_jax.run.start import initial_state
from dropper_jax.run.step_check import with_step_check
from dropper_jax.stepping.adaptive import Adaptive
from dropper_jax.stepping.controlled import Controlled
from dropper_jax.stepping.stepper import Stepper


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
    step_check: bool = False,
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
        step_check: repeat the run, or stretches of a long one, at half the step, and warn where the step is too long
            (see `run.step_check`). Without effect with `tolerance` or `errors`, and of schemes that choose their steps.
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
    entered = time.perf_counter()
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
    first, since = first_of(stepper, model, scene, start)
    folder = None if scratch is None else Path(scratch)
    check_room(model, first.row, run, folder)
    about = {"scene": scene.as_written(), "settings": settings, "went_on": start is not None}
    rows = InMemory() if folder is None else OnDisk(folder, about)
    begun = time.perf_counter()
    before = 0 if start is None else int(start.settings["steps"])
    compiled = compile_run(stepper, model, first.carry, run, before)
    compile_s = time.perf_counter() - begun
    start_s = time.perf_counter() - entered
    gone = go_through(compiled, run.saves, say, rows)
    trajectory, within, carry = gone.trajectory, gone.beside, gone.carry
    solution = assembled(scene, stepper, model, first, since, trajectory, dict(settings), rows)
    if isinstance(carry, Adaptive):
        solution = followed(solution, within, refused(carry) - refused(first.carry))
    if isinstance(carry, Controlled):
        solution = controlled(solution, stepper, model, trajectory, within, carry, first.carry)
    if solution.first_bad is None:
        solution = replace(solution, last=named(Last(last_row(trajectory), carry)))
    solution = replace(solution, compile_s=compile_s + gone.late_s, run_s=gone.run_s)
    if gone.interrupted:
        told = (gone.refused,) if gone.refused else ()
        solution = replace(solution, status="interrupted", warnings=(*solution.warnings, *told))
    solution = judged(solution)
    if step_check and tolerance is None and not errors:
        solution = with_step_check(solution, compiled, gone, start_s + gone.late_s)
    if choice is not None:
        solution = _within(solution, tolerance, choice)
    if errors and finished(solution):
        solution = _with_errors(solution, scene, skip, settings, say)
    say(1.0, solution.status)
    if throw and solution.status != "ok":
        raise SimulationError(solution.failure, solution)
    return solution


def first_of(stepper: Stepper, model: Model, scene: Scene, before: Solution | None) -> tuple[Last, Since]:
    """Where a run begins, at its scene's start or at the end of the run before, and what its times count from."""
    run, names = scene.run, work_names(model) if stepper.track_work else ()
    if before is None:
        s = initial_state(model, scene.start)
        if scene.start.kind == "static":
            check_stretch(scene, np.asarray(model.nodes(s.r, model.ends(s.t))))
        return Last(first_row(s, len(names)), first_carry(stepper, model, s, run)), Since()

    def kind(model: Model) -> Last:
        s = state(model, jnp.zeros((model.free_nodes, 3), model.dtype))
        return Last(first_row(s, len(names)), first_carry(stepper, model, s, run))

    last, used = restored(jax.eval_shape(kind, model), before.last), before.settings
    since = Since(*(before.continues or {"origin_s": 0.0, "saves": 0}).values())
    since = since._replace(saves=since.saves + len(before.t) - 1)
    if (run.dt, run.save_every) != (used["dt"], used["save_every"]):
        since = Since(float(before.t[-1]))
        if isinstance(last.carry, Controlled):
            here = last.carry._replace(origin=jnp.asarray(since.origin, model.dtype), saved=jnp.zeros((), jnp.int32))
            last = last._replace(carry=here)
    return last, since


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

    again = lambda variant: simulate(variant, step_check=False, **settings)  # noqa: E731
    found = load_errors(scene, again, skip, solution, lambda done, what: say(done, f"errors: {what}"))
    told = tuple(f"{name}: its largest tension is not resolved (see the errors)" for name in found["not_resolved"])
    return replace(solution, settings={**solution.settings, "load_errors": found}, warnings=(*solution.warnings, *told))
