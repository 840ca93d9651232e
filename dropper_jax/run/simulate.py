"""`simulate`: from a scene to a solution, which is summarised, saved, read again and continued."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropper_jax.base.errors import SceneError, SimulationError
from dropper_jax.base.html_table import html_table
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.checks_system import check_changing_lengths_until
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.modelling.build import SceneLike, build_model, stepper_of
from dropper_jax.quantities.step_extremes import step_signals
from dropper_jax.run.build_solution import PreparedRun, build_solution
from dropper_jax.run.chunks import compile_run, run_chunks
from dropper_jax.run.companion import with_stated_errors
from dropper_jax.run.end_of_run import RUN, name_leaves, same_scene
from dropper_jax.run.memory_check import check_memory
from dropper_jax.run.row_store import InMemory, OnDisk
from dropper_jax.run.samples import Samples, is_finished
from dropper_jax.run.start_of_run import initial_carry, stepper_fields
from dropper_jax.run.summary import summary
from dropper_jax.stepping.stepper import check_settings, stepper_settings

if TYPE_CHECKING:
    import xarray


#: Kinds of second run that states the errors of a run (see `run.companion`).
COMPANIONS = (None, "coarser", "finer")
#: The log of the library: warnings of runs, and a line for each run as information.
LOG = logging.getLogger("dropper_jax")
LOG.addHandler(logging.NullHandler())  # nothing is printed unless the user configures it


class Solution(Samples):
    """Result of a run with k saved times and n links.

    Attributes:
        scene: the simulated scene.
        settings: integrator, solver, dt, duration, steps, dtype, gamma, rho_infinity, residual_tolerance,
            save_every; with an accuracy dt is the interval between saved times; with errors `load_errors` (see
            `study.load_errors`); with a companion `stated_errors` (see `run.companion`).
        t: saved times (k,) [s].
        positions, velocities: all nodes, both ends included, (k, n + 1, 3) [m], [m/s]; of a system of lines the nodes
            of all lines, line after line (points that join lines are listed once per line), see `lines`.
        tension: (k, n) [N] at the times `t_tension` (k,) [s] (the step's midpoint in midpoint schemes).
        kinetic, potential: energies (k,) [J].
        work: work done since the start (k, w) [J] by each of `work_names`.
        step_status: 0 where every step up to the saved time is good.
        status: `ok`, `energy_drift` (the end is reached; the energy balance error exceeds 10 % of the energy scale),
            `step_too_long` (the same; the companion of equal steps states an error above 10 %), `retry_exhausted`,
            `not_converged`, `non_finite` or `interrupted`.
        failed_steps, retried_steps: counts.
        first_bad: step, time_s, residual and reason of the first bad step, or None.
        max_residual: maximum scaled residual of a step.
        max_closure_error: maximum error of a rigid link's length [m].
        compile_s, run_s: wall time [s].
        versions: of the packages that affect the result.
        warnings: one line each.
        broken: broken links, by time: line, link (from 1), time_s, tension_n.
        tension_min, tension_max: extremes of the tensions over the steps since the last saved time (k, n) [N], at
            `tension_min_time`, `tension_max_time` [s]. None if every step is saved: `step_extremes` has them always.
            With an accuracy `tension` is the mean since the last saved time, else that of a saved step.
        end_force_min, end_force_max and their times: the same of the forces on the end points (k, lines, 2).
        point_load_min, point_load_max and their times: the same of the loads of fixed points (k, points, 3).
        tension_square: with an accuracy the mean square of the tensions since the last saved time [N^2]; else
            None.
        body_position, body_attitude: of each rigid body its reference point (k, bodies, 3) [m], and roll, pitch and yaw
            [rad]; None without.
        body_velocity, body_rates: velocity of the reference point [m/s], angular velocity in the scene's axes [rad/s].
        own: internal states of effects, by effect (k, ...); `NAME.0`, `NAME.1` ... of one with several.
        last: the whole state at the end, from which `continued` starts; empty if the run failed.
        continues: origin of the times of a continued run: `origin_s`, and the number of earlier `saves`; else None.
    """

    def summary(self) -> Table:
        """The JSON object of a run; NaN and infinity are null."""
        return summary(self)

    def _repr_html_(self) -> str:
        """A small table, for notebooks."""
        used = self.settings
        rows = [
            ("status", self.failure or self.status),
            ("scheme", f"{used['integrator']}, solver {used['solver']}"),
            ("time", f"{self.t[0]:g} to {self.t[-1]:g} s, {len(self.t)} saved times"),
            ("tension", "{min:.4g} to {max:.4g} N".format(**self.tension_summary()["all"])),
        ]
        if self.saved_rows:
            rows.append(("saved", f"{self.saved_rows}; extremes are those of all steps"))
        rows.append(("energy balance error", f"{self.energy_drift:.2g} J (reference {self.energy_scale:.3g} J)"))
        rows += [("warning", text) for text in self.warnings]
        return html_table(f"Run of {self.scene.name}", rows)

    def to_xarray(self) -> xarray.Dataset:
        """The run as an `xarray.Dataset` with names, units and provenance; needs the extra `io`."""
        from dropper_jax.run.storage import to_xarray  # noqa: PLC0415

        return to_xarray(self)

    def save(self, path: str | Path) -> Path:
        """Write to `.npz`, `.nc` or `.zarr` with scene and settings, which `rerun` uses to repeat the run."""
        from dropper_jax.run.storage import save_run  # noqa: PLC0415

        return save_run(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Solution:
        """Read a saved run, `.npz`, `.nc` or `.zarr`.

        Raises:
            SceneError: one line, if the file is missing or is not a saved run.
        """
        from dropper_jax.run.storage import read_run  # noqa: PLC0415

        return read_run(path, cls)

    def rerun(self, **kwargs: Any) -> Solution:
        """Simulate again from the provenance; on the same machine the results are bit-identical.

        Raises:
            SceneError: the run continued another run, whose end is not in this file.
        """
        if self.continues:
            why = f"continued another run at {self.t[0]:g} s"
            raise SceneError(f"rerun: this run {why}. Run the first one again and continue it")
        return simulate(self.scene, **{**self._stepping(), **kwargs})

    def continued(self, duration: float | None = None, **kwargs: Any) -> Solution:
        """Continue from the last state: the further run, with times that continue.

        Two runs of 5 s are bit-identical to one of 10 s with the same saved times, on the same machine. The first row
        is the last one of this run.

        Args:
            duration: further time [s]; default: the remaining time of an interrupted run, else the duration of this
            run.
            **kwargs: of `simulate`: `dt`, `save_every`, `progress` and others. With an accuracy the time between saved
                states is that of this run, unless the scene or `save_interval` gives it.

        Raises:
            SceneError: this run failed, or has no final state.
        """
        settings = {**self._stepping(), **kwargs}
        return simulate(self.scene, start=self, duration=self.further if duration is None else duration, **settings)

    @property
    def further(self) -> float:
        """Default time [s] of a continued run: the remaining time, or its duration again."""
        whole = float(self.settings["duration"])
        left = whole - float(self.t[-1] - self.t[0])
        if left > 1e-9 * whole:
            return float(f"{left:.12g}")
        return whole

    def _stepping(self) -> Table:
        """The settings of the stepping that `simulate` takes."""
        keys = ["residual_tolerance", "halvings", "track_work"]
        if self.settings["solver"] != "none":
            keys.append("iterations")
        return {key: self.settings[key] for key in keys if key in self.settings}


def simulate(
    scene: SceneLike,
    *,
    dt: float | None = None,
    duration: float | None = None,
    integrator: str | None = None,
    solver: str | None = None,
    dtype: str | None = None,
    save_every: int | None = None,
    save_interval: float | None = None,
    accuracy: float | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    errors: bool = False,
    skip: float = 0.0,
    start: Solution | None = None,
    scratch: str | Path | None = None,
    companion: str | None = None,
    **settings: Any,
) -> Solution:
    """Simulate a scene; values that are not given are taken from its `[run]`.

    Args:
        scene: packaged name, TOML file, plain values or a `Scene`.
        dt, duration: length of equal steps, and simulated time [s], which is rounded up to whole saved steps. A scene
            that gives no step takes steps that follow an accuracy.
        integrator, solver: see `make_stepper`.
        dtype: `float64` or `float32`.
        save_every: equal steps between saved times. Extremes of tensions, end forces and loads of fixed points are kept
            over all steps, see `Solution.step_extremes`.
        save_interval: time between saved states [s].
        accuracy: required relative accuracy, above 0 and at most 1. Steps then follow the error of positions and
            tensions (see `stepping.step_control`) and end at the saved times; saved tensions are means over the
            interval, extremes are those of all steps.
        progress: called with the fraction done and a line of text.
        throw: raise `SimulationError` (with the partial solution) if the status is not `ok`.
        errors: run again finer and with more links (about 6 times the time), and store the loads with an
            estimate of their errors in `settings["load_errors"]` (see `study.load_errors`).
        skip: time at the start [s] that is left out of these loads.
        start: a run of the same scene to continue from its last state, with times that continue (see
            `Solution.continued`); values of `[run]` may differ except scheme and precision.
        scratch: an empty folder for the saved states of runs that are larger than memory; the arrays of the solution
            are mapped from it and are valid while it exists.
        companion: `coarser` or `finer`: a second run, for half more or two to three times the time, states the errors
            of the first (see `run.companion`).
        **settings: options of the scheme (gamma, rho_infinity) and further fields of `Stepper` (iterations,
            residual_tolerance, halvings).

    Raises:
        SceneError: for invalid input, before the run starts.
    """
    given = {
        "dt": dt,
        "duration": duration,
        "integrator": integrator,
        "solver": solver,
        "dtype": dtype,
        "save_every": save_every,
        "save_interval": save_interval,
        "accuracy": accuracy,
        **{name: settings.pop(name) for name in OPTIONS if name in settings},
    }
    check_settings(settings, [*given, *OPTIONS, "residual_tolerance", *stepper_settings()])
    if companion not in COMPANIONS:
        raise SceneError(f"companion: {companion!r} is unknown; allowed: {', '.join(map(repr, COMPANIONS))}")
    if errors and companion == "finer":
        raise SceneError("companion: 'finer' (--verify) is not used with errors (--errors), which run finer anyway")
    scene = load_scene(scene)
    changed = {f"run.{key}": value for key, value in given.items() if value is not None}
    if changed:
        scene = scene.with_values(changed)
    _check_skip(skip, errors, scene.run.duration)
    if start is not None:
        scene = _with_interval_of(scene, start)
        _check_continued(scene, start, errors)
    say = progress or silent
    prepared = _prepare(scene, settings, start, scratch, say)
    started = time.perf_counter()
    watch = step_signals(scene, prepared.stepper.integrator.tension_time)
    compiled = compile_run(prepared.stepper, prepared.model, prepared.first.carry, scene.run, watch)
    compile_s = time.perf_counter() - started
    outcome = run_chunks(compiled, scene.run.rows, say, prepared.rows)
    solution = build_solution(Solution, prepared, outcome)
    solution = replace(solution, compile_s=compile_s, run_s=outcome.run_s)
    if companion is not None and not errors:
        say(1.0, "stating its errors")
        solution = with_stated_errors(solution, compiled, outcome, finer=companion == "finer")
    if errors and is_finished(solution):
        solution = _with_errors(solution, scene, skip, settings, say)
    _log(solution)
    say(1.0, solution.status)
    if throw and solution.status != "ok":
        raise SimulationError(solution.failure, solution)
    return solution


def _with_interval_of(scene: Scene, start: Solution) -> Scene:
    """The scene with the saved times of a run that it continues, if it gives none: those that a scene suggests depend
    on its duration, and steps end at saved times."""
    run = scene.run
    both_follow = run.accuracy is not None and start.scene.run.accuracy is not None
    if both_follow and run.save_interval is None and start.settings["dt"] <= run.duration:
        return scene.with_values({"run.save_interval": start.settings["dt"]})
    return scene


def _check_continued(scene: Scene, start: Solution, errors: bool) -> None:
    """Reject a run that cannot continue another one."""
    if start.status not in ("ok", "interrupted"):
        raise SceneError(f"{RUN} failed, {start.failure}. Use a run with status ok or interrupted")
    same_scene(scene, start.scene)
    check_changing_lengths_until(scene, float(start.t[-1]) + scene.run.duration)
    if errors:
        raise SceneError("errors: restarts the scene, so it cannot be combined with a run to continue")


def _check_skip(skip: float, errors: bool, duration: float) -> None:
    """Reject a time left out of the errors that is not within the run."""
    if skip and not errors:
        raise SceneError(f"--skip: {skip:g} s can only be left out together with --errors")
    if not 0.0 <= skip < duration:
        raise SceneError(f"--skip: {skip:g} is out of range; allowed: 0 to less than the {duration:g} s of the run")


def _prepare(
    scene: Scene, settings: Table, start: Solution | None, scratch: str | Path | None, say: Progress
) -> PreparedRun:
    """Stepper, model and first state of a run, and the storage of its rows, in memory or in a folder."""
    model = build_model(scene)
    # an invalid combination is rejected before the start is solved
    stepper = stepper_of(model, scene.run, **stepper_fields(settings))
    say(0.0, "finding the start")
    first, origin = initial_carry(stepper, model, scene, start)
    folder = None if scratch is None else Path(scratch)
    if folder is not None and not folder.is_dir():
        raise SceneError(f"scratch: {folder} is not a folder; needed: an empty folder")
    check_memory(model, first.row, scene.run, folder)
    rows = InMemory()
    if folder is not None:
        about = {"scene": scene.as_written(), "settings": settings, "since": list(origin)}
        rows = OnDisk(folder, about, name_leaves(first))
    return PreparedRun(scene, stepper, model, first, origin, rows, settings)


def _log(solution: Solution) -> None:
    """Log the warnings of a run, and its status."""
    name = solution.scene.name
    for text in solution.warnings:
        LOG.warning("%s: %s", name, text)
    LOG.info("%s: %s at %g s, %.3g s run", name, solution.status, solution.t[-1], solution.run_s)


def _with_errors(solution: Solution, scene: Scene, skip: float, settings: Table, say: Progress) -> Solution:
    """The solution with its loads and their errors, and a warning for each line with unresolved peaks."""
    from dropper_jax.study.load_errors import load_errors  # noqa: PLC0415

    found = load_errors(
        scene, partial(simulate, **settings), skip, solution, lambda done, what: say(done, f"errors: {what}")
    )
    notes = tuple(f"{name}: peak tension not converged (see the errors)" for name in found["not_resolved"])
    known = {**solution.settings, "load_errors": found}
    return replace(solution, settings=known, warnings=(*solution.warnings, *notes))
