"""Simulation of all windows, each on its own, with exact derivatives by their starts and the parameters."""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import compile_program
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.stepper import make_stepper
from fitting.estimate.normal_equations import Evaluation, drop_undefined
from fitting.estimate.release import Release
from fitting.estimate.static_poses import StaticPoses
from fitting.estimate.window_run import NEVER, WindowInputs, run_window
from fitting.estimate.windows import ON_GRID, Starts, Windows, with_rows
from fitting.parameters.observation import camera_angles, lost_frames
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.traces import planar

#: Inputs of a window with a row for each sample slot, and the number of its steps, by their numbers.
SAMPLE_INPUTS = [WindowInputs._fields.index(name) for name in ("measured", "weight", "index", "fraction")]
STEPS_INPUT = WindowInputs._fields.index("steps")


#: Fraction of the windows that steps without retries may leave unsolved before they are no longer tried.
MOST_UNSOLVED = 0.5
#: Refusal of a scene whose line has no pose at rest.
NO_REST = "rest: the scene has no pose at rest: {}. Use a line that hangs"


class Key(NamedTuple):
    """Key of a program: the scheme with or without retries, step [s], whether samples lie on whole steps, and capacity
    for steps and sample slots."""

    plain: bool
    dt: float
    on_grid: bool
    steps: int
    slots: int

    def serves(self, other: Key) -> bool:
        """Whether a program compiled for this key also runs windows of the other key."""
        return self[:3] == other[:3] and self.steps >= other.steps and self.slots >= other.slots


class Program(NamedTuple):
    """A compiled program, and the time that its compilation took [s]."""

    run: jax.stages.Compiled
    compile_s: float


class Simulator:
    """Runs windows of one model, in parallel; a program serves all windows up to its own length.

    A window is one kernel where its scheme allows it. Windows in a batch would not be, and would execute the steps that
    the longest of them needs: twice the time of a lab dropper's fit on one core, and three times on several.

    If the scheme retries steps that do not solve, windows first run without retries. That program compiles in half the
    time (two rods with dry joints: 13 s of 22). Only windows with unsolved steps run again; measured pendulums have
    none.

    Its programs may know more parameters than requested: `view_of` uses the same programs for some of them, with the
    others at their own values, so that parameters freed later need no new compilation. Derivatives are taken along
    `tangents` directions at a time, which are inputs of the program.

    Attributes:
        parameters: those of the requested values and derivatives.
        compiled: those that programs know.
        release: start of released windows; None if every window has a start of its own.
        capacity: minimum steps and sample slots that programs are compiled for.
        rest_poses: angles of the line at rest, as seen by the camera.
        starts_only: whether derivatives by the parameters are not taken, but zero.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        stepper: Stepper | None = None,
        release: Release | None = None,
        tangents: int | None = None,
        more: Sequence[Parameter] = (),
    ) -> None:
        self.model = model
        self.parameters = tuple(parameters)
        self.release = release
        self.compiled = (*self.parameters, *more)
        self._released = None if release is None else release.static_poses(model, self.compiled)
        self.rest_poses = StaticPoses(model, self.compiled, NO_REST, view=self._seen_by_camera)
        self.stepper = stepper or choose_stepper(model)
        self.freedoms = 2 * planar.freedoms(model)
        self.tangents = tangents or max(self.freedoms + len(self.parameters), 1)
        self.starts_only = False
        self.capacity = 0, 0
        self._plain = self.stepper.plain != self.stepper
        self._programs: dict[Key, Program] = {}  # the same for all views
        self._model: tuple[np.ndarray, Model] | None = None
        # a fit starts at the last evaluation of its preparation
        self._last: tuple[np.ndarray, Starts, Windows, Evaluation] | None = None

    def _seen_by_camera(self, model: Model, values: Array, theta: Array) -> Array:
        return camera_angles(model, self.compiled, values, theta)

    @property
    def compile_s(self) -> float:
        """Time spent compiling, also by views with the same programs [s]."""
        return sum(program.compile_s for program in self._programs.values())

    def view_of(self, parameters: Sequence[Parameter]) -> Simulator:
        """The same programs for some of the parameters that they know, or with other lost frames instead of theirs."""
        view = copy.copy(self)
        view.parameters = tuple(parameters)
        view._model = None
        view._last = None
        view._where()  # raises for an unknown name
        return view

    def view_of_starts(self) -> Simulator:
        """The same programs with derivatives by the starts alone, for fits with all parameters fixed."""
        view = copy.copy(self)
        view.starts_only = True
        view._last = None
        return view

    def knows(self, parameters: Sequence[Parameter]) -> bool:
        """Whether its programs know all of these."""
        names = {p.name for p in self.compiled}
        enough_slots = len(lost_frames(parameters)) <= len(lost_frames(self.compiled))
        return enough_slots and all(p.is_lost or p.name in names for p in parameters)

    def _where(self) -> np.ndarray:
        """Numbers (k,) of the parameters among the compiled ones; lost frames use any of their slots."""
        index_of = {p.name: i for i, p in enumerate(self.compiled)}
        lost = iter(lost_frames(self.compiled))
        found = []
        for p in self.parameters:
            if p.is_lost:
                found.append(next(lost))
            else:
                found.append(index_of[p.name])
        return np.array(found, int)

    def all_values(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of all parameters that programs know, and which of them are the requested ones (k,)."""
        where = self._where()
        found = np.array([p.value for p in self.compiled], float)
        found[list(lost_frames(self.compiled))] = 0.0
        found[where] = values
        return found, where

    def jumps(self, windows: Windows) -> np.ndarray:
        """Position in every window, in steps, of each lost time of the programs (K, q); `NEVER` if it has none.

        A lost time at the end of a window, before the next one's first frame, belongs to that window.
        """
        found = np.full((windows.count, len(lost_frames(self.compiled))), NEVER)
        for slot, where in enumerate(lost_frames(self.parameters).values()):
            step = (where.time - windows.begin) / windows.dt - ON_GRID
            inside = (windows.run == where.run) & (step > 0) & (step <= windows.step_counts)
            found[inside, slot] = step[inside]
        return found

    def __call__(self, values: np.ndarray, starts: Starts, windows: Windows) -> Evaluation:
        """Evaluate at parameter values (k,) and window starts; every window has its own row in the result."""
        values = np.asarray(values, float)
        last = self._last
        if last and last[1] is starts and last[2] is windows and np.array_equal(last[0], values):
            return last[3]
        window_inputs = WindowInputs(
            theta=starts.theta,
            omega=starts.omega,
            basis=planar.chart(self.model_at(values), starts.theta),
            measured=windows.theta,
            weight=windows.weight,
            index=windows.index,
            fraction=windows.fraction,
            jumps=self.jumps(windows),
            steps=windows.step_counts.astype(np.int32),
        )
        asked = values.copy()
        values, _ = self.all_values(values)
        inputs: tuple[np.ndarray, ...] = window_inputs
        if self.release and self._released:
            start = self.release.start_windows(self._released, values, starts, window_inputs.basis, windows)
            changed = window_inputs._replace(theta=start.theta, omega=start.omega, basis=start.basis)
            inputs = (*changed, *start.state)
        found = self._run(values, inputs, windows, self._plain)
        if self._plain and found.failed.any():
            again = np.flatnonzero(found.failed)
            self._plain = len(again) <= MOST_UNSOLVED * windows.count
            better = self._run(values, [a[again] for a in inputs], windows, False)
            found = with_rows(found, again, better)
        found = drop_undefined(found)
        self._last = asked, starts, windows, found
        return found

    def _run(self, values: np.ndarray, inputs: Sequence[np.ndarray], windows: Windows, plain: bool) -> Evaluation:
        """Inputs of all or some of the windows, each run by itself."""
        slots = windows.theta.shape[1]
        key = self._key(windows, plain)
        inputs = list(inputs)
        for i in SAMPLE_INPUTS:
            others = [(0, 0)] * (inputs[i].ndim - 2)
            inputs[i] = np.pad(inputs[i], [(0, 0), (0, key.slots - slots), *others])
        if key not in self._programs:
            self._programs[key] = self._compile(key, values, inputs)
        program = self._programs[key].run
        substeps = np.int32(windows.substeps)
        seeds = self._seeds()
        jobs = list(product(seeds, zip(*inputs, strict=True)))

        def run(job: tuple[np.ndarray, tuple[np.ndarray, ...]]) -> list[np.ndarray]:
            directions, own = job
            return [np.asarray(a) for a in program(values, directions, substeps, own[STEPS_INPUT], *own)]

        # the compiled program releases the interpreter lock, so that threads use all cores
        with ThreadPoolExecutor(min(len(jobs), os.cpu_count() or 1)) as pool:
            parts = list(pool.map(run, jobs))
        columns = self.freedoms + len(self.parameters)
        whole = []
        for field, rows in zip(Evaluation._fields, zip(*parts, strict=True), strict=True):
            blocks = np.split(np.stack(rows), len(seeds))
            found = blocks[0]
            if field.endswith("jacobian"):
                known = np.concatenate(blocks, axis=-1)[..., :columns]
                found = np.zeros((*known.shape[:-1], columns))
                found[..., : known.shape[-1]] = known
            if field in ("theta", "residual", "jacobian"):
                found = found[:, :slots]
            whole.append(found)
        return Evaluation(*whole)

    def _seeds(self) -> list[np.ndarray]:
        """Directions (tangents, m2 + compiled) of the derivatives, in as many blocks as starts and parameters need."""
        columns = np.arange(self.freedoms)
        if not self.starts_only:
            columns = np.append(columns, self.freedoms + self._where())
        blocks = -(-len(columns) // self.tangents)
        seeds = np.zeros((blocks * self.tangents, self.freedoms + len(self.compiled)))
        seeds[np.arange(len(columns)), columns] = 1.0
        return list(seeds.reshape(blocks, self.tangents, -1))

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these parameter values (k,)."""
        values = np.asarray(values, float)
        if self._model is None or not np.array_equal(self._model[0], values):
            self._model = values.copy(), with_parameter_values(self.model, self.parameters, jnp.asarray(values))
        return self._model[1]

    def _key(self, windows: Windows, plain: bool) -> Key:
        """Key of a program that serves such windows: of one that is compiled, otherwise of a new one."""
        on_grid = self.release is None and not lost_frames(self.compiled) and not windows.fraction.any()
        size = (windows.steps, windows.theta.shape[1])
        requested = Key(plain, windows.dt, on_grid, *size)
        for key in self._programs:
            if key.serves(requested):
                return key
        if isinstance(self.stepper.integrator, Embedded):  # these need all their steps in advance
            return requested
        return Key(plain, windows.dt, on_grid, *map(max, size, self.capacity))

    def _compile(self, key: Key, values: np.ndarray, inputs: Sequence[np.ndarray]) -> Program:
        """The program of a key, for windows with such inputs."""
        started = time.perf_counter()
        stepper = self.stepper.plain if key.plain else self.stepper
        one = partial(
            run_window,
            model=self.model,
            parameters=self.compiled,
            release=self.release,
            stepper=stepper,
            dt=key.dt,
            capacity=key.steps,
            on_grid=key.on_grid,
        )
        like = [jax.ShapeDtypeStruct(a.shape[1:], jax.dtypes.canonicalize_dtype(a.dtype)) for a in inputs]
        count = jax.ShapeDtypeStruct((), jnp.int32)
        directions = (self.tangents, self.freedoms + len(self.compiled))
        seeds = jax.ShapeDtypeStruct(directions, jax.dtypes.canonicalize_dtype(float))
        known_by = {
            "key": tuple(key),
            "stepper": stepper,
            "model": self.model,
            "release": self.release,
            "parameters": self.compiled,
            "freedoms": self.freedoms,
            "tangents": self.tangents,
        }
        program = compile_program(
            run_window, known_by, (values, seeds, count, count, *like), one, kernel=True, shared=True
        )
        return Program(program, time.perf_counter() - started)


def choose_stepper(model: Model, integrator: str | None = None, solver: str = "auto") -> Stepper:
    """The scheme with the best ratio of cost to error: rattle_4 for point masses, otherwise energy_momentum.

    Args:
        solver: as in the scene's `run.solver`; `auto` uses `condensed` where it applies.

    Raises:
        SceneError: a solver that does not support this scene or scheme.
    """
    if integrator is None and Rattle4().refuse(model) is None:
        if solver == "auto":
            solver = "condensed"
        elif reason := SOLVERS[solver].refuse(model, Rattle4()):
            raise SceneError(f"run.solver: {solver!r} cannot serve this fit: {reason}")
        # Newton iterations of a rattle_4 stage: its Jacobian is exact, three reach rounding at 1/60 s (residual 8e-16)
        return Stepper(integrator=Rattle4(), solver=SOLVERS[solver], iterations=3, track_work=False)
    # No halving: a window whose steps do not solve means that the fit's step was too long; it then tries a shorter one.
    # Sticking joints are different: a step in which they cannot be found is halved once, since an unsolved step has an
    # unbounded derivative (measured on three links: 1e20).
    halvings = 1 if model.laws else 0
    return make_stepper(model, integrator or "energy_momentum", solver, track_work=False, halvings=halvings)
