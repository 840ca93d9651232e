"""Simulation of all windows, with exact derivatives by their starts and the parameters; each runs by itself."""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import compile_program
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.halving import advance_over
from dropper_jax.stepping.integrate import advance, scan_steps
from dropper_jax.stepping.progress import begin
from dropper_jax.stepping.stepper import make_stepper
from fitting.estimate.normal_equations import Evaluation, drop_wild
from fitting.estimate.release import LEAST_STRETCH, Release, ReleaseState
from fitting.estimate.windows import ON_GRID, Starts, Windows, with_rows
from fitting.parameters.missing_forces import add_missing_forces
from fitting.parameters.observation import camera_angles, clock_rate, losses, recording
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.parameters.varied import Varied, split, stack_rows, vary
from fitting.traces import planar

#: Inputs of a window with a row for each sample, and its number of steps.
SAMPLES = slice(3, 7)
COUNT = 8
#: Position of a jump of the clock that a window does not have [steps].
NEVER = 1e9


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
        others: programs of the same model, stored by other objects.
        starts_only: whether derivatives by the parameters are not taken, but zero.
        compile_s: time spent compiling [s].
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
        self.stepper = stepper or choose_stepper(model)
        self.freedoms = 2 * planar.freedoms(model)
        self.tangents = tangents or max(self.freedoms + len(self.parameters), 1)
        self.starts_only = False
        self.compile_s = 0.0
        self.capacity = 0, 0
        self._plain = self.stepper.plain != self.stepper
        self._programs: dict[Key, jax.stages.Compiled] = {}
        self.others: dict[str, Any] = {}
        self._model: tuple[np.ndarray, Model] | None = None
        # a fit starts at the last evaluation of its preparation
        self._last: tuple[np.ndarray, Starts, Windows, Evaluation] | None = None

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
        enough_slots = len(losses(parameters)) <= len(losses(self.compiled))
        return enough_slots and all(p.is_lost or p.name in names for p in parameters)

    def _where(self) -> np.ndarray:
        """Numbers (k,) of the parameters among the compiled ones; lost frames use any of their slots."""
        index_of = {p.name: i for i, p in enumerate(self.compiled)}
        lost = iter(losses(self.compiled))
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
        found[list(losses(self.compiled))] = 0.0
        found[where] = values
        return found, where

    def jumps(self, windows: Windows) -> np.ndarray:
        """Position in every window, in steps, of each lost time of the programs (K, q); `NEVER` if it has none.

        A lost time at the end of a window, before the next one's first frame, belongs to that window.
        """
        found = np.full((windows.count, len(losses(self.compiled))), NEVER)
        for slot, where in enumerate(losses(self.parameters).values()):
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
        bases = planar.chart(self.model_at(values), starts.theta)
        inputs = (starts.theta, starts.omega, bases, windows.theta, windows.weight, windows.index, windows.fraction)
        inputs = (*inputs, self.jumps(windows), windows.step_counts.astype(np.int32))
        asked = values.copy()
        values, _ = self.all_values(values)
        if self.release and self._released:
            inputs = self.release.release_inputs(self._released, values, inputs, windows)
        found = self._run(values, inputs, windows, self._plain)
        if self._plain and found.failed.any():
            again = np.flatnonzero(found.failed)
            # fraction of a program's windows that its first, plain steps may leave unsolved before they are no longer
            # tried
            self._plain = len(again) <= 0.5 * windows.count
            better = self._run(values, [a[again] for a in inputs], windows, False)
            found = with_rows(found, again, better)
        found = drop_wild(found)
        self._last = asked, starts, windows, found
        return found

    def _run(self, values: np.ndarray, inputs: Sequence[np.ndarray], windows: Windows, plain: bool) -> Evaluation:
        """Inputs of all or some of the windows, each run by itself."""
        slots = windows.theta.shape[1]
        key = self._key(windows, plain)
        inputs = list(inputs)
        for i in range(len(inputs))[SAMPLES]:
            others = [(0, 0)] * (inputs[i].ndim - 2)
            inputs[i] = np.pad(inputs[i], [(0, 0), (0, key.slots - slots), *others])
        if key not in self._programs:
            self._programs[key] = self._compile(key, values, inputs)
        program = self._programs[key]
        substeps = np.int32(windows.substeps)
        seeds = self._seeds()
        jobs = list(product(seeds, zip(*inputs, strict=True)))

        def run(job: tuple[np.ndarray, tuple[np.ndarray, ...]]) -> list[np.ndarray]:
            directions, own = job
            return [np.asarray(a) for a in program(values, directions, substeps, own[COUNT], *own)]

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
            self._model = values.copy(), with_parameter_values(self.model, self.parameters, jnp.asarray(values, float))
        return self._model[1]

    def _key(self, windows: Windows, plain: bool) -> Key:
        """Key of a program that serves such windows: of one that is compiled, otherwise of a new one."""
        on_grid = self.release is None and not losses(self.compiled) and not windows.fraction.any()
        size = (windows.steps, windows.theta.shape[1])
        requested = Key(plain, windows.dt, on_grid, *size)
        for key in self._programs:
            if key.serves(requested):
                return key
        if isinstance(self.stepper.integrator, Embedded):  # these need all their steps in advance
            return requested
        return Key(plain, windows.dt, on_grid, *map(max, size, self.capacity))

    def _compile(self, key: Key, values: np.ndarray, inputs: Sequence[np.ndarray]) -> jax.stages.Compiled:
        """The program of a key, for windows with such inputs."""
        started = time.perf_counter()
        stepper = self.stepper.plain if key.plain else self.stepper
        one = partial(self.window, stepper=stepper, dt=key.dt, capacity=key.steps, on_grid=key.on_grid)
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
        program = compile_program(Simulator.window, known_by, (values, seeds, count, count, *like), one, kernel=True)
        self.compile_s += time.perf_counter() - started
        return program

    def window(
        self,
        values: Array,
        seeds: Array,
        substeps: Array,
        count: Array,
        *inputs: Array,
        stepper: Stepper,
        dt: float,
        capacity: int,
        on_grid: bool,
    ) -> tuple[Array, ...]:
        """Value and derivatives of one window along `seeds`, directions of its start and of the values.

        Args:
            count: number of steps taken, at most `capacity`: those of the window, which are among the inputs, or more
                where windows of a batch run together.
        """
        theta0, omega0, basis, measured, weight, index, fraction, jumps, steps, *more = inputs
        m = basis.shape[1]
        recordings = measured.shape[1] // len(theta0)

        def model_at(x: Array) -> Model:
            p = x[2 * m :]
            return add_missing_forces(with_parameter_values(self.model, self.compiled, p), self.compiled, p)

        def start_at(x: Array) -> Start:
            z = x[: 2 * m]
            p = x[2 * m :]
            model = model_at(x)
            # sums and not matrix products, which may call a library and so prevent one kernel
            theta = theta0 + jnp.sum(basis * z[:m], axis=1)
            h: Array | float = dt
            samples = (index, fraction)
            late: Array | float = 0.0
            if self.release:
                release_state = ReleaseState(*more)
                theta = theta + jnp.sum(release_state.slope * (p - values), axis=1)
                late = self.release.late(self.compiled, p, release_state)
            if self.release or losses(self.compiled):
                h, samples = self._clock(p, late, index + fraction, jumps, dt, steps)
            rate = clock_rate(self.compiled, p)
            if rate is not None:
                h = h * rate
            theta, omega = planar.close_chain(model, theta, omega0 + jnp.sum(basis * z[m:], axis=1))
            return Start(theta, omega, planar.to_state(model, theta, omega), jnp.asarray(h, theta.dtype), samples)

        def read_out(x: Array, start: Start, rows: tuple[Array, Array]) -> tuple[Array, ...]:
            p = x[2 * m :]
            model = model_at(x)
            angles, rates = jax.vmap(partial(planar.from_nodes, model))(*rows)
            shown = []
            for number in range(recordings):
                reading = recording(self.compiled, p, number, len(theta0))
                at = start.samples
                if number:  # the first recording's clock is that of the motion
                    position = at[0] + at[1] - reading.delay / dt
                    # the fraction of a sample just outside the window lies outside 0 to 1
                    whole = jnp.clip(jnp.floor(jax.lax.stop_gradient(position)), 0, steps - 1)
                    at = (whole.astype(jnp.int32), position - whole)
                first = (start.theta, start.omega)
                poses = at_samples(first, angles, rates, *at, start.h, on_grid and not number)
                seen = camera_angles(model, self.compiled, p, poses)
                if number:
                    mine = slice(number * len(theta0), (number + 1) * len(theta0))
                    seen = reading.read(seen, measured[:, mine])
                shown.append(seen)
            angle = jnp.concatenate(shown, axis=-1)
            end = jnp.concatenate([angles[steps - 1], rates[steps - 1]])
            return planar.wrap(angle - measured) * weight, jnp.concatenate([start.theta, start.omega]), end, angle

        point = jnp.concatenate([jnp.zeros(2 * m), values])
        start = vary(start_at, point, seeds)
        rows, failed = march(stepper, model_at, point, seeds, start, capacity, substeps, count, steps)
        found = vary(read_out, point, seeds, start, rows)
        residual, first, end, angle = found.tree
        by_residual, by_first, by_end = (jnp.moveaxis(slope, 0, -1) for slope in found.slopes[:3])
        return angle, residual, by_residual, first, end, by_first, by_end, failed

    def _clock(
        self,
        p: Array,
        late: Array | float,
        position: Array,
        jumps: Array,
        dt: float,
        steps: Array,
    ) -> tuple[Array, tuple[Array, Array]]:
        """A window's step [s] and the position of its samples in steps, integer and fraction, by its own clock.

        The steps are stretched so that the last one ends with the window, however much time is missing in it.

        Args:
            late: time from the start of the window to its release [s].
        """
        elapsed = position * dt
        total = steps * dt
        for slot, i in enumerate(losses(self.compiled)):
            elapsed = elapsed + jnp.where(position >= jumps[slot], p[i], 0.0)
            total = total + jnp.where(jumps[slot] < NEVER, p[i], 0.0)
        h = jnp.maximum((total - late) / steps, LEAST_STRETCH * dt)
        step_position = jnp.clip((elapsed - late) / h, 0.0, steps)  # before the release: at rest
        whole = jnp.minimum(jnp.floor(jax.lax.stop_gradient(step_position)), steps - 1)
        return h, (whole.astype(jnp.int32), step_position - whole)


class Start(NamedTuple):
    """Start of a window: angles [rad] and rates [rad/s] (n,), the state, its step [s], and the position of its samples
    in steps, integer and fraction (S,)."""

    theta: Array
    omega: Array
    state: State
    h: Array
    samples: tuple[Array, Array]


def choose_stepper(model: Model, integrator: str | None = None, solver: str = "auto") -> Stepper:
    """The scheme with the best ratio of cost to error: rattle_4 for point masses, otherwise energy_momentum.

    Args:
        solver: as in the scene's `run.solver`; `auto` uses `condensed` where it applies.

    Raises:
        SceneError: a solver that does not support this scene or scheme.
    """
    if integrator is None and Rattle4().refuse(model) is None:
        if solver != "auto" and (reason := SOLVERS[solver].refuse(model, Rattle4())):
            raise SceneError(f"run.solver: {solver!r} cannot serve this fit: {reason}")
        if solver == "auto":
            solver = "condensed"
        # Newton iterations of a rattle_4 stage: its Jacobian is exact, three reach rounding at 1/60 s (residual 8e-16)
        return Stepper(integrator=Rattle4(), solver=SOLVERS[solver], iterations=3, track_work=False)
    # No halving: a window whose steps do not solve means that the fit's step was too long; it then tries a shorter one.
    # Sticking joints are different: a step in which they cannot be found is halved once, since an unsolved step has an
    # unbounded derivative (measured on three links: 1e20).
    halvings = 1 if model.laws else 0
    return make_stepper(model, integrator or "energy_momentum", solver, track_work=False, halvings=halvings)


#: Accuracy over the shortest link [1/m] for schemes with an embedded error: on the lab dropper angles are then within
#: 5e-5 rad after 3 s, 1 % of the noise.
ACCURACY_PER_LENGTH = 0.1


def march(
    stepper: Stepper,
    model_at: Callable[[Array], Model],
    x: Array,
    directions: Array,
    start: Varied,
    capacity: int,
    substeps: Array | int,
    steps: Array | int,
    counted: Array | int,
) -> tuple[Varied, Array]:
    """Positions and velocities (capacity, nodes, 3) after every step from a start, a `Start` as a function of x, with
    derivatives along the directions (k, len(x)), and the number of failed (sub)steps among the first `counted`;
    undefined beyond `steps`.

    Each step is divided into `substeps` parts. Both numbers are traced, so that one program serves every step size and
    windows of any length. Schemes with an embedded error become more exact accordingly; their output interval is h.
    """
    if isinstance(stepper.integrator, Embedded):

        def adapt(x: Array, start: Start) -> tuple[tuple[Array, Array], Array]:
            model = model_at(x)
            finer = jnp.asarray(substeps, model.dtype) ** -stepper.integrator.order
            accuracy = jax.lax.stop_gradient(ACCURACY_PER_LENGTH * jnp.min(model.line.length) * finer)
            first = begin(stepper, model, start.state, follows=True)
            end, found = advance(stepper, model, first, start.h, capacity, accuracy=accuracy)
            return (found.r, found.v), end.has_failed.astype(jnp.int32)

        found = vary(adapt, x, directions, start)
        return Varied(found.tree[0], found.slopes), found.tree[1]

    def save(now: Varied, i: Array) -> tuple[Varied, Varied]:
        def interval(x: Array, now: tuple[State, Array], start: Start) -> tuple[Any, Any]:
            model = model_at(x)

            def part(_: Array, now: tuple[State, Array]) -> tuple[State, Array]:
                s, failed = now
                taken = advance_over(stepper, model, s, start.h / substeps, failed == 0)
                return taken.state, failed + jnp.where(i < counted, taken.failed, 0)

            s, failed = jax.lax.fori_loop(0, substeps, part, now)
            return (s, failed), (s.r, s.v)

        return split(vary(interval, x, directions, now, start))

    def first(x: Array, start: Start) -> tuple[Any, Any]:
        s = begin(stepper, model_at(x), start.state).state
        # steps that are not reached keep the first pose: a link of zero length would have no angle
        shelf = tuple(jnp.broadcast_to(a, (capacity, *a.shape)) for a in (s.r, s.v))
        return (s, jnp.zeros((), jnp.int32)), shelf

    now, shelf = split(vary(first, x, directions, start))
    rows = Varied(shelf.tree, [jnp.swapaxes(slope, 0, 1) for slope in shelf.slopes])
    now, rows = scan_steps(save, now, steps, rows)
    return stack_rows(rows), now.tree[1]


def at_samples(
    start: tuple[Array, Array],
    angles: Array,
    rates: Array,
    index: Array,
    fraction: Array,
    dt: Array | float,
    on_grid: bool,
) -> Array:
    """Angles (S, n) at the sample times: cubic Hermite between steps, whose error is below the scheme's own."""
    angles = jnp.concatenate([start[0][None], angles])
    if on_grid:
        return angles[index]
    rates = jnp.concatenate([start[1][None], rates])
    a = angles[index]
    ra = rates[index]
    rb = rates[index + 1]
    turn = planar.wrap(angles[index + 1] - a)
    s = fraction[:, None]
    return a + turn * (3 * s**2 - 2 * s**3) + dt * ((s - 2 * s**2 + s**3) * ra + (s**3 - s**2) * rb)
