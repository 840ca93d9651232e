"""Running all windows at once, with exact derivatives by their starts and the parameters."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.integrators.projected import ProjectedRungeKutta
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model, State
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.controlled import advance_controlled, start_controlled
from dropper_jax.stepping.integrate import begin
from dropper_jax.stepping.integrate import failed as unsolved
from dropper_jax.stepping.step import step
from dropper_jax.stepping.stepper import Stepper
from fitting.estimate.release import Begun, Release
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter, apply, camera_offset, clock_rate
from fitting.traces import planar

#: Windows run side by side in one program: measured on the lab dropper, 4 to 24 cost the same per window; few keep all
#: cores busy and compile fastest.
CHUNK = 8
#: Newton iterations of a rattle_4 stage: its Jacobian is exact, three leave rounding at 1/60 s (residual 8e-16).
ITERATIONS = 3
#: Error of a step over the shortest link that schemes which hold their own allow: on the lab dropper angles are then
#: within 5e-5 rad after 3 s, a hundredth of the noise.
ERROR = 1e-4
#: Times the median over windows beyond which a window's derivative is taken for none. A joint that is just about to
#: stick has none (measured: 1e20), and one such window would hold all parameters fast; chaos makes 400 at most.
WILD = 1e4


#: Part of a program's windows that its first, plain steps may leave unsolved before they are given up for good.
UNSOLVED = 0.5


class Key(NamedTuple):
    """What a program is compiled for: the scheme with or without retries, windows in it, step [s], whether samples lie
    on whole steps, and room for steps and sample slots."""

    plain: bool
    size: int
    dt: float
    on_grid: bool
    steps: int
    slots: int

    def serves(self, other: Key) -> bool:
        """Whether a program compiled for this runs windows of the other too."""
        return self[:4] == other[:4] and self.steps >= other.steps and self.slots >= other.slots


class Evaluation(NamedTuple):
    """All windows at one point; derivatives are by the chart coordinates z (m angles, m rates) and the parameters.

    Attributes:
        theta: simulated angles less the camera's offset (K, S, n) [rad].
        residual: (simulated - measured)/sigma (K, S, n), 0 where there is no sample.
        jacobian: of `residual` (K, S, n, 2 m + k).
        start, end: angles and rates at both ends of each window (K, 2 n).
        start_jacobian, end_jacobian: (K, 2 n, 2 m + k).
        failed: steps above tolerance (K,).
    """

    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    start: np.ndarray
    end: np.ndarray
    start_jacobian: np.ndarray
    end_jacobian: np.ndarray
    failed: np.ndarray


def choose_stepper(model: Model, integrator: str | None = None) -> Stepper:
    """The scheme of the best price for its error: rattle_4 for point masses, else energy_momentum."""
    if integrator is None and Rattle4().refuse(model) is None:
        settings = {"extra": 0, "halvings": 0, "track_work": False, "reverse": False, "batched": True}
        return Stepper(Rattle4(), "condensed", "banded", ITERATIONS, **settings)
    # No halving: a window whose steps do not solve is a step too far of the fit, which then takes a smaller one. Not so
    # where joints stick: which of them do is found by the last resort alone, on the whole step or on half of it, and an
    # unsolved step's derivative is of no size at all (measured on three links: 1e20).
    settings = {"halvings": 1} if model.laws else {"halvings": 0, "extra": 0}
    return make_stepper(
        model, integrator or "energy_momentum", "auto", track_work=False, reverse=False, **settings
    )  # all derivatives of a fit are taken forwards


def trusted(e: Evaluation) -> Evaluation:
    """The evaluation with no derivative, and one failed step more, where a window's is beyond all measure."""
    size = np.abs(e.jacobian).max(axis=(1, 2, 3), initial=0.0)
    wild = ~(size <= WILD * max(float(np.median(size)), 1e-300))
    if not wild.any():
        return e
    keep = ~wild
    derivatives = ("jacobian", "start_jacobian", "end_jacobian")
    zeroed = {f: np.where(keep.reshape(-1, *[1] * (getattr(e, f).ndim - 1)), getattr(e, f), 0.0) for f in derivatives}
    return e._replace(failed=e.failed + wild, **zeroed)


class Simulator:
    """Runs windows of one model, a chunk at a time; a program serves all windows that are not longer than its own.

    Where the scheme retries steps that do not solve, windows run without retries first, whose program compiles in half
    the time (two rods with dry joints: 13 s of 22), and only those with unsolved steps run again. Measured pendulums
    have none.

    Attributes:
        release: how released windows begin; None where every window has a start of its own.
        room: steps and sample slots that programs are compiled for at least.
        compile_s: time spent compiling [s].
        evaluations: calls so far.
    """

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Parameter],
        stepper: Stepper | None = None,
        release: Release | None = None,
    ) -> None:
        self.model, self.parameters, self.release = model, tuple(parameters), release
        self.stepper = stepper or choose_stepper(model)
        self.freedoms = 2 * planar.freedoms(model)
        self.compile_s, self.evaluations = 0.0, 0
        self.room = 0, 0
        self._plain = self.stepper.plain != self.stepper
        self._programs: dict[Key, jax.stages.Compiled] = {}
        self._model: tuple[np.ndarray, Model] | None = None
        # a fit begins where its preparation looked last
        self._last: tuple[tuple[np.ndarray, Starts, Windows] | None, Evaluation | None] = None, None

    def __call__(self, values: np.ndarray, starts: Starts, windows: Windows) -> Evaluation:
        """Evaluate at parameter values (k,) and window starts; every window has its own line in the answer."""
        values = np.asarray(values, float)
        asked = self._last[0]
        if asked and asked[1] is starts and asked[2] is windows and np.array_equal(asked[0], values):
            return self._last[1]
        bases = planar.chart(self.model_at(values), starts.theta)
        inputs = (starts.theta, starts.omega, bases, windows.theta, windows.weight, windows.index, windows.fraction)
        if self.release:
            inputs = self.release.place(self.model, self.parameters, values, inputs, windows)
        self.evaluations += 1
        found = self._run(values, inputs, windows, self._plain)
        if self._plain and found.failed.any():
            again = np.flatnonzero(found.failed)
            self._plain = len(again) <= UNSOLVED * windows.count
            better = self._run(values, tuple(a[again] for a in inputs), windows, False)
            for old, new in zip(found, better, strict=True):
                old[again] = new
        self._last = (values.copy(), starts, windows), trusted(found)
        return self._last[1]

    def _run(self, values: np.ndarray, inputs: tuple[np.ndarray, ...], windows: Windows, plain: bool) -> Evaluation:
        """Inputs of all or some of the windows, a chunk at a time."""
        count, slots = len(inputs[0]), windows.theta.shape[1]
        wanted = self._key(windows, plain)
        key, program = self._program(wanted, values, inputs)
        more = key.slots - slots
        inputs = [
            np.pad(a, [(0, 0), (0, more), *[(0, 0)] * (a.ndim - 2)]) if 3 <= i <= 6 else a for i, a in enumerate(inputs)
        ]
        order = np.minimum(np.arange(-(-count // key.size) * key.size), count - 1).reshape(-1, key.size)
        chunks = [tuple(a[rows] for a in inputs) for rows in order]
        taken = np.int32(windows.substeps), np.int32(windows.steps)
        run = lambda chunk: [np.asarray(a) for a in program(values, *taken, *chunk)]  # noqa: E731
        # the compiled program leaves the interpreter, so that two threads use two cores
        with ThreadPoolExecutor(min(len(chunks), os.cpu_count() or 1)) as pool:
            parts = list(pool.map(run, chunks))
        whole = Evaluation(*(np.concatenate(column)[:count] for column in zip(*parts, strict=True)))
        seen = {f: getattr(whole, f)[:, :slots] for f in ("theta", "residual", "jacobian")}
        return whole._replace(**seen)

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these parameter values (k,)."""
        values = np.asarray(values, float)
        if self._model is None or not np.array_equal(self._model[0], values):
            self._model = values.copy(), apply(self.model, self.parameters, jnp.asarray(values))
        return self._model[1]

    def _chunk(self, windows: Windows) -> int:
        """Windows per program."""
        # A program of several windows takes all that any of them needs, and both sides of every choice. Joints that
        # stick are all choices: with a law windows run one by one, in 0.55 of the time (seven links), and compile in
        # 0.4 of it.
        # Windows that hold their own error take steps of their own, and side by side all of them the most of any.
        if self.model.laws or isinstance(self.stepper.integrator, ProjectedRungeKutta):
            return 1
        # two sizes only, every other one would be compiled anew; the small one not where the large one is there already
        large = windows.count > CHUNK // 2 or any(key.size == CHUNK for key in self._programs)
        return CHUNK if large else CHUNK // 2

    def _key(self, windows: Windows, plain: bool) -> Key:
        return Key(
            plain, self._chunk(windows), windows.dt, self._on_grid(windows), windows.steps, windows.theta.shape[1]
        )

    def _on_grid(self, windows: Windows) -> bool:
        return self.release is None and not windows.fraction.any()

    def _program(
        self, wanted: Key, values: np.ndarray, inputs: tuple[np.ndarray, ...]
    ) -> tuple[Key, jax.stages.Compiled]:
        """A program that serves such windows, compiled where there is none yet, and what it was compiled for."""
        for key, program in self._programs.items():
            if key.serves(wanted):
                return key, program
        begun = time.perf_counter()
        key = wanted
        if not isinstance(self.stepper.integrator, ProjectedRungeKutta):  # these are told all their steps beforehand
            key = wanted._replace(steps=max(wanted.steps, self.room[0]), slots=max(wanted.slots, self.room[1]))
        stepper = self.stepper.plain if key.plain else self.stepper
        one = partial(self.window, stepper=stepper, dt=key.dt, room=key.steps, on_grid=key.on_grid)
        batched = jax.vmap(one, in_axes=(None, None, None, *(0 for _ in inputs)))
        if key.size == 1:  # a batch of one is a batch, and would take both sides of every choice too
            batched = lambda v, n, m, *each: [a[None] for a in one(v, n, m, *(a[0] for a in each))]  # noqa: E731
        shape = lambda i, a: (key.size, key.slots, *a.shape[2:]) if 3 <= i <= 6 else (key.size, *a.shape[1:])  # noqa: E731
        like = [jax.ShapeDtypeStruct(shape(i, a), jnp.asarray(a[:0]).dtype) for i, a in enumerate(inputs)]
        count = jax.ShapeDtypeStruct((), jnp.int32)
        self._programs[key] = jax.jit(batched).lower(values, count, count, *like).compile()
        self.compile_s += time.perf_counter() - begun
        return key, self._programs[key]

    def window(
        self,
        values: jax.Array,
        substeps: jax.Array,
        steps: jax.Array,
        *inputs: jax.Array,
        stepper: Stepper,
        dt: float,
        room: int,
        on_grid: bool,
    ) -> tuple[jax.Array, ...]:
        """Value and Jacobian of one window of `steps` steps, at most `room`, all tangents in one batch."""
        theta0, omega0, basis, measured, weight, index, fraction, *more = inputs
        m = basis.shape[1]
        point = jnp.concatenate([jnp.zeros(2 * m), values])

        def outputs(x: jax.Array) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, jax.Array]]:
            z, p = x[: 2 * m], x[2 * m :]
            model = apply(self.model, self.parameters, p)
            theta, h, place = theta0 + basis @ z[:m], dt, (index, fraction)
            if self.release:
                begun = Begun(*more)
                theta = theta + begun.slope @ (p - values)
                h, place = self.release.clock(self.parameters, p, begun, index + fraction, dt, steps)
            rate = clock_rate(self.parameters, p)
            h = h if rate is None else h * rate
            start = planar.closed(model, theta, omega0 + basis @ z[m:])
            angles, rates, failed = march(stepper, model, planar.to_state(model, *start), h, room, substeps, steps)
            seen = _at_samples(start, angles, rates, *place, h, on_grid)
            seen = seen + camera_offset(self.parameters, p, seen.shape[1])
            residual = planar.wrap(seen - measured) * weight
            end = jnp.concatenate([angles[steps - 1], rates[steps - 1]])
            return (residual, jnp.concatenate(start), end), (seen, failed)

        push = lambda d: jax.jvp(outputs, (point,), (d,), has_aux=True)  # noqa: E731
        (residual, start, end), (jr, js, je), (seen, failed) = jax.vmap(push, out_axes=(None, -1, None))(
            jnp.eye(len(point))
        )
        return seen, residual, jr, start, end, js, je, failed


def march(
    stepper: Stepper, model: Model, s: State, dt: jax.Array, room: int, substeps: jax.Array, steps: jax.Array | int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Angles and rates (room, n) after every step of dt, and how many (sub)steps failed; of no use beyond `steps`.

    Each step is taken in `substeps` parts. Both numbers are traced, so that one program serves every fineness and
    windows of any length. Schemes that hold their own error are as much more exact, and dt is the interval of what is
    seen of them.
    """
    if isinstance(stepper.integrator, ProjectedRungeKutta):
        return _held(stepper, model, s, dt, room, substeps)

    def part(_: int, carry: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
        s, bad = carry
        s, report = step(stepper, model, s, dt / substeps, bad == 0)
        return s, bad + unsolved(stepper, model, s, report.residual)

    put = jax.lax.dynamic_update_index_in_dim

    def whole(i: int, carry: tuple[tuple[State, jax.Array], jax.Array, jax.Array]) -> tuple[Any, ...]:
        carry, r, v = carry
        carry = jax.lax.fori_loop(0, substeps, part, carry)
        return carry, put(r, carry[0].r, i, 0), put(v, carry[0].v, i, 0)

    first = begin(stepper, model, s).state, jnp.zeros((), jnp.int32)
    # what is not reached stays at the first pose: a link of no length would have no angle, nor a finite derivative
    shelf = lambda a: jnp.broadcast_to(a, (room, *a.shape))  # noqa: E731
    (_, bad), r, v = jax.lax.fori_loop(0, steps, whole, (first, shelf(first[0].r), shelf(first[0].v)))
    return *jax.vmap(partial(planar.from_nodes, model))(r, v), bad


def _held(
    stepper: Stepper, model: Model, s: State, dt: jax.Array, steps: int, substeps: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    finer = jnp.asarray(substeps, model.dtype) ** -stepper.integrator.order
    allowed = jax.lax.stop_gradient(ERROR * jnp.min(model.line.length) * finer)
    carry = start_controlled(stepper, model, s, allowed)
    carry, (found, _) = advance_controlled(stepper, model, carry, dt, allowed, steps)
    return *jax.vmap(partial(planar.from_nodes, model))(found.r, found.v), carry.bad


def _at_samples(
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
    a, ra, rb = angles[index], rates[index], rates[index + 1]
    turn = planar.wrap(angles[index + 1] - a)
    s = fraction[:, None]
    return a + turn * (3 * s**2 - 2 * s**3) + dt * ((s - 2 * s**2 + s**3) * ra + (s**3 - s**2) * rb)
