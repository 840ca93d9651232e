"""Simulation of all windows together, with exact derivatives by their starts and the parameters."""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import compile_program
from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.adaptive import adaptive_start, advance_adaptively
from dropper_jax.stepping.control import advance_over
from dropper_jax.stepping.integrate import begin, scan_steps
from dropper_jax.stepping.stepper import make_stepper
from fitting.estimate.normal_equations import Evaluation, drop_wild
from fitting.estimate.release import LEAST_STRETCH, Release, ReleaseState
from fitting.estimate.windows import ON_GRID, Starts, Windows, with_rows
from fitting.parameters.missing_forces import add_missing_forces
from fitting.parameters.observation import camera_angles, clock_rate, losses, recording
from fitting.parameters.parameter import Parameter, apply
from fitting.traces import planar

#: Windows in one batched program: measured on the lab dropper, 4 to 24 cost the same per window; few keep all cores
#: busy and compile fastest.
CHUNK = 8


#: Number of the program input that holds the windows' own numbers of steps.
COUNTS = 8
#: Position of a jump of the clock that a window does not have [steps].
NEVER = 1e9


class Key(NamedTuple):
    """Key of a program: the scheme with or without retries, number of windows, step [s], whether samples lie on whole
    steps, and capacity for steps and sample slots."""

    plain: bool
    size: int
    dt: float
    on_grid: bool
    steps: int
    slots: int

    def serves(self, other: Key) -> bool:
        """Whether a program compiled for this key also runs windows of the other key."""
        return self[:4] == other[:4] and self.steps >= other.steps and self.slots >= other.slots


class Simulator:
    """Runs windows of one model, a chunk at a time; a program serves all windows up to its own length.

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
        self.release = release and replace(release)  # its poses belong to one model and one list of parameters
        self.compiled = (*self.parameters, *more)
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
        return np.array([next(lost) if p.is_lost else index_of[p.name] for p in self.parameters], int)

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
        if self.release:
            inputs = self.release.release_inputs(self.model, self.compiled, values, inputs, windows)
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
        """Inputs of all or some of the windows, a chunk at a time."""
        slots = windows.theta.shape[1]
        key, program = self._program(self._key(windows, plain), values, inputs)
        padding = (0, key.slots - slots)
        inputs = [
            np.pad(a, [(0, 0), padding, *[(0, 0)] * (a.ndim - 2)]) if 3 <= i <= 6 else a for i, a in enumerate(inputs)
        ]
        # windows of similar length run together: a chunk takes as many steps as its longest window, so that copies of
        # the shortest one fill the first chunk
        order = np.argsort(inputs[COUNTS], kind="stable")
        more = -len(order) % key.size
        rows = np.pad(order, (more, 0), mode="edge").reshape(-1, key.size)
        chunks = [[a[some] for a in inputs] for some in rows]
        substeps = np.int32(windows.substeps)
        run = lambda job: [  # noqa: E731
            np.asarray(a) for a in program(values, job[0], substeps, job[1][COUNTS].max(), *job[1])
        ]
        jobs = [(seeds, chunk) for seeds in self._seeds() for chunk in chunks]
        # the compiled program releases the interpreter lock, so that two threads use two cores
        with ThreadPoolExecutor(min(len(jobs), os.cpu_count() or 1)) as pool:
            parts = list(pool.map(run, jobs))
        back = more + np.argsort(order, kind="stable")
        joined = []
        for i in range(0, len(parts), len(chunks)):
            columns = zip(*parts[i : i + len(chunks)], strict=True)
            joined.append([np.concatenate(column)[back] for column in columns])
        columns = self.freedoms + len(self.parameters)
        whole = []
        for i, field in enumerate(Evaluation._fields):
            found = joined[0][i]
            if field.endswith("jacobian"):
                found = np.concatenate([some[i] for some in joined], axis=-1)[..., :columns]
                found = np.pad(found, [(0, 0)] * (found.ndim - 1) + [(0, columns - found.shape[-1])])
            whole.append(found[:, :slots] if field in ("theta", "residual", "jacobian") else found)
        return Evaluation(*whole)

    def _seeds(self) -> list[np.ndarray]:
        """Directions (tangents, m2 + compiled) of the derivatives, in as many blocks as starts and parameters need."""
        more = []
        if not self.starts_only:
            more = self.freedoms + self._where()
        columns = np.concatenate([np.arange(self.freedoms), more]).astype(int)
        blocks = -(-len(columns) // self.tangents)
        seeds = np.zeros((blocks * self.tangents, self.freedoms + len(self.compiled)))
        seeds[np.arange(len(columns)), columns] = 1.0
        return list(seeds.reshape(blocks, self.tangents, -1))

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these parameter values (k,)."""
        values = np.asarray(values, float)
        if self._model is None or not np.array_equal(self._model[0], values):
            self._model = values.copy(), apply(self.model, self.parameters, jnp.asarray(values, float))
        return self._model[1]

    def _key(self, windows: Windows, plain: bool) -> Key:
        # two sizes only, because each one is compiled separately; the small one is not used if the large one exists
        large = windows.count > CHUNK // 2 or any(key.size == CHUNK for key in self._programs)
        size = CHUNK if large else CHUNK // 2
        # A program of several windows executes the steps that any of them needs, and both sides of every branch.
        # Sticking joints have many branches: with a set-valued law windows run one by one, in 0.55 of the time (seven
        # links), and compile in 0.4 of it.
        # Windows with an embedded error choose their own steps; in a batch all of them would take the maximum number.
        if self.model.laws or isinstance(self.stepper.integrator, Embedded):
            size = 1
        on_grid = self.release is None and not losses(self.compiled) and not windows.fraction.any()
        return Key(plain, size, windows.dt, on_grid, windows.steps, windows.theta.shape[1])

    def _program(
        self, requested: Key, values: np.ndarray, inputs: Sequence[np.ndarray]
    ) -> tuple[Key, jax.stages.Compiled]:
        """A program that serves such windows, compiled if necessary, and its key."""
        for key, program in self._programs.items():
            if key.serves(requested):
                return key, program
        started = time.perf_counter()
        key = requested
        if not isinstance(self.stepper.integrator, Embedded):  # these need all their steps in advance
            key = requested._replace(
                steps=max(requested.steps, self.capacity[0]), slots=max(requested.slots, self.capacity[1])
            )
        stepper = self.stepper
        if key.plain:
            stepper = self.stepper.plain
        one = partial(self.window, stepper=stepper, dt=key.dt, capacity=key.steps, on_grid=key.on_grid)
        batched = jax.vmap(one, in_axes=(None, None, None, None, *(0 for _ in inputs)))
        if key.size == 1:  # a batch of one would also execute both sides of every branch
            batched = lambda v, d, n, m, *each: [a[None] for a in one(v, d, n, m, *(a[0] for a in each))]  # noqa: E731
        shape = lambda i, a: (key.size, key.slots, *a.shape[2:]) if 3 <= i <= 6 else (key.size, *a.shape[1:])  # noqa: E731
        like = [jax.ShapeDtypeStruct(shape(i, a), jax.dtypes.canonicalize_dtype(a.dtype)) for i, a in enumerate(inputs)]
        count = jax.ShapeDtypeStruct((), jnp.int32)
        seeds = jax.ShapeDtypeStruct(
            (self.tangents, self.freedoms + len(self.compiled)), jax.dtypes.canonicalize_dtype(float)
        )
        known_by = {
            "key": tuple(key),
            "stepper": stepper,
            "model": self.model,
            "release": self.release,
            "parameters": self.compiled,
            "freedoms": self.freedoms,
            "tangents": self.tangents,
        }
        arguments = (values, seeds, count, count, *like)
        # several windows in one batch run as fast without the kernel and compile in half of the time
        kernel = key.size == 1
        self._programs[key] = compile_program(Simulator.window, known_by, arguments, batched, kernel)
        self.compile_s += time.perf_counter() - started
        return key, self._programs[key]

    def window(
        self,
        values: jax.Array,
        seeds: jax.Array,
        substeps: jax.Array,
        steps: jax.Array,
        *inputs: jax.Array,
        stepper: Stepper,
        dt: float,
        capacity: int,
        on_grid: bool,
    ) -> tuple[jax.Array, ...]:
        """Value and derivatives along `seeds` of one window, in one batch.

        Args:
            steps: number of steps, at most `capacity`, of all windows that run together; a window's own number of
                steps is among the inputs, and its end is read there.
        """
        theta0, omega0, basis, measured, weight, index, fraction, jumps, own_steps, *more = inputs
        m = basis.shape[1]
        recordings = measured.shape[1] // len(theta0)
        point = jnp.concatenate([jnp.zeros(2 * m), values])

        def outputs(x: jax.Array) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, jax.Array]]:
            z = x[: 2 * m]
            p = x[2 * m :]
            model = add_missing_forces(apply(self.model, self.compiled, p), self.compiled, p)
            theta = theta0 + basis @ z[:m]
            h: jax.Array | float = dt
            samples = (index, fraction)
            late: jax.Array | float = 0.0
            if self.release:
                release_state = ReleaseState(*more)
                theta = theta + release_state.slope @ (p - values)
                late = self.release.late(self.compiled, p, release_state)
            if self.release or losses(self.compiled):
                h, samples = self._clock(p, late, index + fraction, jumps, dt, own_steps)
            rate = clock_rate(self.compiled, p)
            h = h if rate is None else h * rate
            start = planar.close_chain(model, theta, omega0 + basis @ z[m:])
            state = planar.to_state(model, *start)
            angles, rates, failed = march(stepper, model, state, h, capacity, substeps, steps, own_steps)
            shown = []
            for number in range(recordings):
                reading = recording(self.compiled, p, number, len(theta0))
                at = samples
                if number:  # the first recording's clock is that of the motion
                    position = samples[0] + samples[1] - reading.delay / dt
                    # the fraction of a sample just outside the window lies outside 0 to 1
                    whole = jnp.clip(jnp.floor(jax.lax.stop_gradient(position)), 0, own_steps - 1)
                    at = (whole.astype(jnp.int32), position - whole)
                poses = at_samples(start, angles, rates, *at, h, on_grid and not number)
                seen = camera_angles(model, self.compiled, p, poses)
                if number:
                    mine = slice(number * len(theta0), (number + 1) * len(theta0))
                    seen = reading.read(seen, measured[:, mine])
                shown.append(seen)
            angle = jnp.concatenate(shown, axis=-1)
            end = jnp.concatenate([angles[own_steps - 1], rates[own_steps - 1]])
            return (planar.wrap(angle - measured) * weight, jnp.concatenate(start), end), (angle, failed)

        push = lambda d: jax.jvp(outputs, (point,), (d,), has_aux=True)  # noqa: E731
        (residual, start, end), (jr, js, je), (angle, failed) = jax.vmap(push, out_axes=(None, -1, None))(seeds)
        return angle, residual, jr, start, end, js, je, failed

    def _clock(
        self,
        p: jax.Array,
        late: jax.Array | float,
        position: jax.Array,
        jumps: jax.Array,
        dt: float,
        steps: jax.Array,
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
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
        chosen = SOLVERS["condensed" if solver == "auto" else solver]
        # Newton iterations of a rattle_4 stage: its Jacobian is exact, three reach rounding at 1/60 s (residual 8e-16)
        return Stepper(integrator=Rattle4(), solver=chosen, iterations=3, track_work=False)
    # No halving: a window whose steps do not solve means that the fit's step was too long; it then tries a shorter one.
    # Sticking joints are different: a step in which they cannot be found is halved once, since an unsolved step has an
    # unbounded derivative (measured on three links: 1e20).
    halvings = 1 if model.laws else 0
    return make_stepper(model, integrator or "energy_momentum", solver, track_work=False, halvings=halvings)


#: Accuracy over the shortest link [1/m] for schemes with an embedded error: on the lab dropper angles are then within
#: 5e-5 rad after 3 s, 1 % of the noise.
ACCURACY_PER_LENGTH = 0.1


#: A state and the number of failed steps before it.
Counted = tuple[State, jax.Array]


def march(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: jax.Array | float,
    capacity: int,
    substeps: jax.Array,
    steps: jax.Array | int,
    counted: jax.Array | int,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Angles and rates (capacity, n) after every step of dt, and the number of failed (sub)steps among the first
    `counted`; undefined beyond `steps`.

    Each step is divided into `substeps` parts. Both numbers are traced, so that one program serves every step size and
    windows of any length. Schemes with an embedded error become more exact accordingly; their output interval is dt.
    """
    if isinstance(stepper.integrator, Embedded):
        finer = jnp.asarray(substeps, model.dtype) ** -stepper.integrator.order
        accuracy = jax.lax.stop_gradient(ACCURACY_PER_LENGTH * jnp.min(model.line.length) * finer)
        start = adaptive_start(stepper, model, begin(stepper, model, s))
        end, (found, _) = advance_adaptively(stepper, model, start, dt, accuracy, capacity)
        return *jax.vmap(partial(planar.from_nodes, model))(found.r, found.v), end.has_failed.astype(jnp.int32)

    def full_interval(carry: Counted, i: jax.Array) -> tuple[Counted, tuple[jax.Array, jax.Array]]:
        def part(_: jax.Array, carry: Counted) -> Counted:
            taken = advance_over(stepper, model, carry[0], dt / substeps, carry[1] == 0)
            return taken.state, carry[1] + jnp.where(i < counted, taken.failed, 0)

        s, bad = jax.lax.fori_loop(0, substeps, part, carry)
        return (s, bad), (s.r, s.v)

    first = begin(stepper, model, s).state, jnp.zeros((), jnp.int32)
    # steps that are not reached keep the first pose: a link of zero length would have no angle and no finite derivative
    shelf = lambda a: jnp.broadcast_to(a, (capacity, *a.shape))  # noqa: E731
    (_, bad), (r, v) = scan_steps(full_interval, first, steps, (shelf(first[0].r), shelf(first[0].v)))
    return *jax.vmap(partial(planar.from_nodes, model))(r, v), bad


def at_samples(
    start: tuple[jax.Array, jax.Array],
    angles: jax.Array,
    rates: jax.Array,
    index: jax.Array,
    fraction: jax.Array,
    dt: jax.Array | float,
    on_grid: bool,
) -> jax.Array:
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
