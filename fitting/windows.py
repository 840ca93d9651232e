"""Cutting traces into windows, and running all windows at once with exact derivatives.

A chaotic trace cannot be fitted as one run: its sensitivity to the start grows as exp(lambda t). Each window has a
start of its own (angles and rates, in a local chart, see `planar`), and only the parameters are shared.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.errors import SceneError
from dropper_jax.integrate import integrate
from dropper_jax.integrators import make_stepper
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model
from dropper_jax.stepping import Stepper
from fitting import planar
from fitting.parameters import Parameter, apply, camera_offset
from fitting.traces import Trace, local_polynomial

#: Windows run side by side in one program: measured on the lab dropper, 4 to 24 cost the same per window; few keep all
#: cores busy and compile fastest.
CHUNK = 8
#: Newton iterations of a rattle_4 stage: its Jacobian is exact, three leave rounding at 1/60 s (residual 8e-16).
ITERATIONS = 3
#: Departure from whole steps [steps] below which samples count as lying on the time grid.
ON_GRID = 1e-6


@dataclass(frozen=True)
class Windows:
    """K windows of S sample slots each, over any number of runs.

    Attributes:
        begin: start times (K,) [s].
        run: number of the trace of each window (K,).
        follows: whether a window begins where the one before it ends (K,).
        theta: measured angles (K, S, n) [rad], 0 where there is none.
        weight: 1/sigma (K, S, n) [1/rad], 0 where there is no sample.
        index, fraction: time of each slot in steps after the start, whole and rest, (K, S).
        dt, steps: time step [s] and steps of a window.
    """

    begin: np.ndarray
    run: np.ndarray
    follows: np.ndarray
    theta: np.ndarray
    weight: np.ndarray
    index: np.ndarray
    fraction: np.ndarray
    dt: float
    steps: int

    @property
    def count(self) -> int:
        return len(self.begin)

    @property
    def samples(self) -> int:
        """Measured angles in all."""
        return int((self.weight > 0).sum())

    @property
    def length(self) -> float:
        """Duration of a window [s]."""
        return self.steps * self.dt

    def times(self) -> np.ndarray:
        """Times of all slots (K, S) [s]."""
        return self.begin[:, None] + (self.index + self.fraction) * self.dt

    def padded(self, steps: int, slots: int) -> Windows:
        """The same windows simulated for at least `steps` and with at least `slots` sample slots, the rest empty.

        What has the shape of windows that ran before needs no compilation.
        """
        more = max(0, slots - self.theta.shape[1])
        pad = lambda a: np.pad(a, [(0, 0), (0, more), *[(0, 0)] * (a.ndim - 2)])  # noqa: E731
        part = {f: pad(getattr(self, f)) for f in ("theta", "weight", "index", "fraction")}
        return replace(self, steps=max(steps, self.steps), **part)

    def pick(self, which: np.ndarray) -> Windows:
        """Some of the windows, none of which follows another."""
        part = {f: getattr(self, f)[which] for f in ("begin", "run", "theta", "weight", "index", "fraction")}
        return replace(self, follows=np.zeros(len(part["begin"]), bool), **part)


def time_step(traces: Sequence[Trace], wanted: float) -> float:
    """The step [s] nearest below `wanted` that divides the sampling interval, where sampling is uniform."""
    intervals = {round(trace.interval, 12) for trace in traces}
    if max(intervals) - min(intervals) > 1e-9:
        return wanted
    interval = max(intervals)
    return interval / max(1, int(np.ceil(interval / wanted - 1e-6)))


def cut(
    traces: Sequence[Trace],
    length: float,
    dt: float,
    sigma: Sequence[np.ndarray],
    spans: Sequence[tuple[int, float, float]] | None = None,
) -> Windows:
    """Windows of `length` [s], one after another; a rest shorter than one is left out, as is a window without samples.

    Args:
        traces: runs in the model's convention.
        sigma: noise of each run's links (n,) [rad], used where the trace has no standard errors.
        spans: (run, from, to) to cut; default: each run as a whole.
    """
    steps = max(1, int(length / dt + 1e-6))
    length = steps * dt
    spans = spans or [(i, float(tr.t[0]), float(tr.t[-1]) + tr.interval) for i, tr in enumerate(traces)]
    begin, run, follows = [], [], []
    for i, low, high in spans:
        count = int((high - low) / length + 1e-6)
        begin += [low + k * length for k in range(count)]
        run += [i] * count
        follows += [k > 0 for k in range(count)]
    if not begin:
        longest = max((high - low for _, low, high in spans), default=0.0)
        raise SceneError(f"window: {length:g} s is longer than the trace; allowed: at most {longest:g} s")
    parts = [_fill(traces[i], t0, steps, dt, sigma[i]) for i, t0 in zip(run, begin, strict=True)]
    slots = max(len(part[0]) for part in parts)
    pad = lambda a: np.concatenate([a, np.zeros((slots - len(a), *a.shape[1:]), a.dtype)])  # noqa: E731
    theta, weight, index, fraction = (np.stack([pad(part[j]) for part in parts]) for j in range(4))
    windows = Windows(np.array(begin), np.array(run), np.array(follows), theta, weight, index, fraction, dt, steps)
    return _drop_empty(windows)


def _fill(trace: Trace, begin: float, steps: int, dt: float, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
    place = (trace.t - begin) / dt
    keep = (place > -ON_GRID) & (place < steps - ON_GRID)
    place, theta = place[keep], trace.theta[keep]
    index = np.floor(place + ON_GRID).astype(np.int32)
    fraction = place - index
    fraction = np.where(np.abs(fraction) < 10 * ON_GRID, 0.0, fraction)
    known = np.isfinite(theta)
    se = None if trace.se is None else trace.se[keep]
    error = np.broadcast_to(sigma, theta.shape) if se is None else np.where(np.isfinite(se), se, sigma)
    return np.where(known, theta, 0.0), np.where(known, 1.0 / error, 0.0), index, fraction


def _drop_empty(windows: Windows) -> Windows:
    """Without windows in which some link has too few samples to tell where it starts."""
    enough = (windows.weight > 0).sum(axis=1).min(axis=1) >= 2
    if enough.all():
        return windows
    if not enough.any():
        raise SceneError("window: no window has two samples of every link; allowed: longer windows or denser traces")
    follows = windows.follows & np.concatenate([[False], enough[:-1]])
    return replace(windows.pick(enough), follows=follows[enough])


class Starts(NamedTuple):
    """Window starts: angles and rates, each (K, n), which close."""

    theta: np.ndarray
    omega: np.ndarray


def first_starts(model: Model, traces: Sequence[Trace], windows: Windows, smooth: float) -> Starts:
    """Starts from the traces, smoothed over `smooth` [s] on either side of a window's first instant."""
    value = np.array(
        [
            [local_polynomial(traces[i].t, column, t0, smooth) for column in traces[i].theta.T]
            for i, t0 in zip(windows.run, windows.begin, strict=True)
        ]
    )
    theta, omega = jax.vmap(partial(planar.closed, model))(jnp.asarray(value[..., 0]), jnp.asarray(value[..., 1]))
    return Starts(np.asarray(theta), np.asarray(omega))


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
        return Stepper(Rattle4(), "condensed", "banded", ITERATIONS, extra=0, halvings=0, track_work=False)
    # No halving: a window whose steps do not solve is a step too far of the fit, which then takes a smaller one.
    extra = 24 if model.laws else 0
    return make_stepper(model, integrator or "energy_momentum", "auto", track_work=False, extra=extra, halvings=0)


class Simulator:
    """Runs windows of one model, a chunk at a time; compiles once per window length and sampling.

    Attributes:
        compile_s: time spent compiling [s].
        evaluations: calls so far.
    """

    def __init__(self, model: Model, parameters: Sequence[Parameter], stepper: Stepper | None = None):
        self.model, self.parameters = model, tuple(parameters)
        self.stepper = stepper or choose_stepper(model)
        self.freedoms = 2 * planar.freedoms(model)
        self.compile_s, self.evaluations = 0.0, 0
        self._programs: dict[tuple, Any] = {}

    def __call__(self, values: np.ndarray, starts: Starts, windows: Windows) -> Evaluation:
        """Evaluate at parameter values (k,) and window starts; every window has its own line in the answer."""
        bases = planar.chart(self.model_at(values), starts.theta)
        inputs = (starts.theta, starts.omega, bases, windows.theta, windows.weight, windows.index, windows.fraction)
        count = windows.count
        # two sizes only, every other one would be compiled anew; the small one not where the large one is there already
        size = CHUNK if count > CHUNK // 2 or self._key(CHUNK, windows) in self._programs else CHUNK // 2
        order = np.minimum(np.arange(-(-count // size) * size), count - 1).reshape(-1, size)
        chunks = [tuple(a[rows] for a in inputs) for rows in order]
        values = np.asarray(values, float)
        program = self._program(values, chunks[0], windows)
        self.evaluations += 1
        run = lambda chunk: [np.asarray(a) for a in program(values, *chunk)]  # noqa: E731
        # the compiled program leaves the interpreter, so that two threads use two cores
        with ThreadPoolExecutor(min(len(chunks), os.cpu_count() or 1)) as pool:
            parts = list(pool.map(run, chunks))
        return Evaluation(*(np.concatenate(column)[:count] for column in zip(*parts, strict=True)))

    def model_at(self, values: np.ndarray) -> Model:
        """The model with these parameter values (k,)."""
        return apply(self.model, self.parameters, jnp.asarray(values))

    def _key(self, size: int, windows: Windows) -> tuple:
        return size, windows.theta.shape[1], windows.dt, windows.steps, not windows.fraction.any()

    def _program(self, values: np.ndarray, chunk: tuple, windows: Windows) -> Any:
        on_grid, key = not windows.fraction.any(), self._key(len(chunk[0]), windows)
        if key not in self._programs:
            begun = time.perf_counter()
            one = partial(self._window, dt=windows.dt, steps=windows.steps, on_grid=on_grid)
            batched = jax.jit(jax.vmap(one, in_axes=(None, *(0 for _ in chunk))))
            self._programs[key] = batched.lower(values, *chunk).compile()
            self.compile_s += time.perf_counter() - begun
        return self._programs[key]

    def _window(self, values, theta0, omega0, basis, measured, weight, index, fraction, *, dt, steps, on_grid):  # noqa: ANN001, ANN202
        """Value and Jacobian of one window, all tangents in one batch."""
        m = basis.shape[1]
        point = jnp.concatenate([jnp.zeros(2 * m), values])

        def outputs(x):  # noqa: ANN001, ANN202
            z, p = x[: 2 * m], x[2 * m :]
            model = apply(self.model, self.parameters, p)
            start = planar.closed(model, theta0 + basis @ z[:m], omega0 + basis @ z[m:])
            _, run = integrate(self.stepper, model, planar.to_state(model, *start), dt, steps)
            angles, rates = jax.vmap(partial(planar.from_nodes, model))(run.r, run.v)
            seen = _at_samples(start, angles, rates, index, fraction, dt, on_grid)
            seen = seen + camera_offset(self.parameters, p)
            residual = planar.wrap(seen - measured) * weight
            end = jnp.concatenate([angles[-1], rates[-1]])
            return (residual, jnp.concatenate(start), end), (seen, jnp.sum(run.failed))

        push = lambda d: jax.jvp(outputs, (point,), (d,), has_aux=True)  # noqa: E731
        (residual, start, end), (jr, js, je), (seen, failed) = jax.vmap(push, out_axes=(None, -1, None))(
            jnp.eye(len(point))
        )
        return seen, residual, jr, start, end, js, je, failed


def _at_samples(start, angles, rates, index, fraction, dt, on_grid):  # noqa: ANN001, ANN202
    """Angles (S, n) at the sample times: cubic Hermite between steps, whose error is below the scheme's own."""
    angles = jnp.concatenate([start[0][None], angles])
    if on_grid:
        return angles[index]
    rates = jnp.concatenate([start[1][None], rates])
    a, ra, rb = angles[index], rates[index], rates[index + 1]
    turn = planar.wrap(angles[index + 1] - a)
    s = fraction[:, None]
    return a + turn * (3 * s**2 - 2 * s**3) + dt * ((s - 2 * s**2 + s**3) * ra + (s**3 - s**2) * rb)
