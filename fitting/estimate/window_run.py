"""Run of one window: residuals with exact derivatives by its start and the parameters, as a program computes them.

Start, steps and camera are functions of the window's start and the parameters, differentiated one after the other
(`differentiate`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.model import Model, State
from dropper_jax.residual import Embedded, Stepper
from dropper_jax.stepping.halving import advance_over
from dropper_jax.stepping.integrate import advance, scan_steps
from dropper_jax.stepping.progress import begin
from fitting.estimate.release import LEAST_STRETCH, Release, ReleaseState
from fitting.estimate.windows import ArrayType
from fitting.parameters.forward_derivatives import WithSlopes, differentiate, split, swap_rows
from fitting.parameters.missing_forces import add_missing_forces
from fitting.parameters.observation import camera_angles, clock_rate, lost_frames, recording
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.traces import planar

#: Position of a jump of the clock that a window does not have [steps].
NEVER = 1e9


class WindowInputs(NamedTuple, Generic[ArrayType]):
    """What a program is given of a window, or of K windows with a row for each.

    Attributes:
        theta, omega: angles [rad] and rates [rad/s] at the start (n,).
        basis: N (n, m) of the start's chart, zero where the model determines the start.
        measured: angles (S, n) [rad]; of R recordings (S, R n).
        weight: 1/sigma (S, n) [1/rad], 0 where there is no sample.
        index, fraction: position of each sample in steps, integer and fraction (S,).
        jumps: position in steps of each lost time (q,); `NEVER` if the window does not have it.
        steps: number of steps of the window.
    """

    theta: ArrayType
    omega: ArrayType
    basis: ArrayType
    measured: ArrayType
    weight: ArrayType
    index: ArrayType
    fraction: ArrayType
    jumps: ArrayType
    steps: ArrayType


class Start(NamedTuple):
    """Start of a window: angles [rad] and rates [rad/s] (n,), the state, its step [s], and the position of its samples
    in steps, integer and fraction (S,)."""

    theta: Array
    omega: Array
    state: State
    h: Array
    samples: tuple[Array, Array]


def run_window(
    values: Array,
    seeds: Array,
    substeps: Array,
    count: Array,
    *inputs: Array,
    model: Model,
    parameters: Sequence[Parameter],
    release: Release | None,
    stepper: Stepper,
    dt: float,
    capacity: int,
    on_grid: bool,
) -> tuple[Array, ...]:
    """The fields of an `Evaluation` of one window, with derivatives along `seeds`, directions of its start and values.

    Args:
        values: of the parameters (k,).
        seeds: (d, m2 + k).
        substeps: number of parts of every step.
        count: number of steps taken, at most `capacity`: those of the window, which are among the inputs, or more
            where windows of a batch run together.
        inputs: `WindowInputs`, followed by `ReleaseState` if there is a release.
        dt: time step [s].
        on_grid: whether all samples lie on whole steps.
    """
    count_of_inputs = len(WindowInputs._fields)
    own = WindowInputs(*inputs[:count_of_inputs])
    release_state = None
    if release is not None:
        release_state = ReleaseState(*inputs[count_of_inputs:])
    window = WindowMotion(own, release_state, values, model, parameters, release, dt, on_grid)
    point = jnp.concatenate([jnp.zeros(2 * window.freedoms), values])
    start = differentiate(window.start_at, point, seeds)
    rows, failed = march(stepper, window.model_at, point, seeds, start, capacity, substeps, count, own.steps)
    found = differentiate(window.read_out, point, seeds, start, rows)
    residual, first, end, angle = found.tree
    by_residual, by_first, by_end = (jnp.moveaxis(slope, 0, -1) for slope in found.slopes[:3])
    return angle, residual, by_residual, first, end, by_first, by_end, failed


@dataclass(frozen=True)
class WindowMotion:
    """A window as functions of x: the coordinates (2 m,) of its start in its chart, then the parameters' values (k,).

    Attributes:
        values: around which the start of a released window follows the parameters (k,).
        others: as of `run_window`.
    """

    own: WindowInputs[Array]
    release_state: ReleaseState[Array] | None
    values: Array
    model: Model
    parameters: Sequence[Parameter]
    release: Release | None
    dt: float
    on_grid: bool

    @property
    def freedoms(self) -> int:
        """Number m of coordinates of the angles."""
        return self.own.basis.shape[1]

    def split(self, x: Array) -> tuple[Array, Array, Array]:
        """Coordinates of angles (m,) and rates (m,), and values of the parameters (k,)."""
        m = self.freedoms
        return x[:m], x[m : 2 * m], x[2 * m :]

    def model_at(self, x: Array) -> Model:
        """The model with its parameters set, and with the missing forces among them."""
        p = self.split(x)[2]
        return add_missing_forces(with_parameter_values(self.model, self.parameters, p), self.parameters, p)

    def start_at(self, x: Array) -> Start:
        """The start: closed angles and rates, and the window's clock."""
        own = self.own
        angles, rates, p = self.split(x)
        here = self.model_at(x)
        # sums and not matrix products, which may call a library and so prevent one kernel
        theta = own.theta + jnp.sum(own.basis * angles, axis=1)
        h: Array | float = self.dt
        samples = (own.index, own.fraction)
        late: Array | float = 0.0
        if self.release is not None and self.release_state is not None:
            theta = theta + jnp.sum(self.release_state.slope * (p - self.values), axis=1)
            late = self.release.late(self.parameters, p, self.release_state)
        if self.release is not None or lost_frames(self.parameters):
            h, samples = _clock(own, self.parameters, p, late, self.dt)
        rate = clock_rate(self.parameters, p)
        if rate is not None:
            h = h * rate
        theta, omega = planar.close_chain(here, theta, own.omega + jnp.sum(own.basis * rates, axis=1))
        return Start(theta, omega, planar.to_state(here, theta, omega), jnp.asarray(h, theta.dtype), samples)

    def read_out(self, x: Array, start: Start, rows: tuple[Array, Array]) -> tuple[Array, ...]:
        """Residuals (S, R n), angles and rates at both ends (2 n,), and angles as seen (S, R n), by those of the nodes
        after every step."""
        own = self.own
        here = self.model_at(x)
        angles, rates = jax.vmap(partial(planar.from_nodes, here))(*rows)
        recordings = own.measured.shape[1] // len(own.theta)
        shown = [self._reading(x, here, start, angles, rates, number) for number in range(recordings)]
        angle = jnp.concatenate(shown, axis=-1)
        residual = planar.wrap(angle - own.measured) * own.weight
        end = jnp.concatenate([angles[own.steps - 1], rates[own.steps - 1]])
        return residual, jnp.concatenate([start.theta, start.omega]), end, angle

    def _reading(self, x: Array, here: Model, start: Start, angles: Array, rates: Array, number: int) -> Array:
        """Angles (S, n) that a recording reads; the clock of the first one is that of the motion."""
        own = self.own
        p = self.split(x)[2]
        if not number:
            poses = at_samples(start, angles, rates, *start.samples, self.on_grid)
            return camera_angles(here, self.parameters, p, poses)
        links = len(own.theta)
        reading = recording(self.parameters, p, number, links)
        position = start.samples[0] + start.samples[1] - reading.delay / self.dt
        # the fraction of a sample just outside the window lies outside 0 to 1
        whole = jnp.clip(jnp.floor(jax.lax.stop_gradient(position)), 0, own.steps - 1)
        poses = at_samples(start, angles, rates, whole.astype(jnp.int32), position - whole, on_grid=False)
        seen = camera_angles(here, self.parameters, p, poses)
        return reading.read(seen, own.measured[:, number * links : (number + 1) * links])


def _clock(
    own: WindowInputs[Array], parameters: Sequence[Parameter], p: Array, late: Array | float, dt: float
) -> tuple[Array, tuple[Array, Array]]:
    """A window's step [s] and the position of its samples in steps, integer and fraction, by its own clock.

    The steps are stretched so that the last one ends with the window, however much time is missing in it.

    Args:
        p: values of the parameters (k,).
        late: time from the start of the window to its release [s].
    """
    position = own.index + own.fraction
    elapsed = position * dt
    total = own.steps * dt
    for slot, i in enumerate(lost_frames(parameters)):
        elapsed = elapsed + jnp.where(position >= own.jumps[slot], p[i], 0.0)
        total = total + jnp.where(own.jumps[slot] < NEVER, p[i], 0.0)
    h = jnp.maximum((total - late) / own.steps, LEAST_STRETCH * dt)
    step_position = jnp.clip((elapsed - late) / h, 0.0, own.steps)  # before the release: at rest
    whole = jnp.minimum(jnp.floor(jax.lax.stop_gradient(step_position)), own.steps - 1)
    return h, (whole.astype(jnp.int32), step_position - whole)


#: Accuracy over the shortest link [1/m] for schemes with an embedded error: on the lab dropper angles are then within
#: 5e-5 rad after 3 s, 1 % of the noise.
ACCURACY_PER_LENGTH = 0.1


def march(
    stepper: Stepper,
    model_at: Callable[[Array], Model],
    x: Array,
    directions: Array,
    start: WithSlopes,
    capacity: int,
    substeps: Array | int,
    steps: Array | int,
    counted: Array | int,
) -> tuple[WithSlopes, Array]:
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

        found = differentiate(adapt, x, directions, start)
        return WithSlopes(found.tree[0], found.slopes), found.tree[1]

    def save(now: WithSlopes, i: Array) -> tuple[WithSlopes, WithSlopes]:
        def interval(x: Array, now: tuple[State, Array], start: Start) -> tuple[Any, Any]:
            model = model_at(x)

            def part(_: Array, now: tuple[State, Array]) -> tuple[State, Array]:
                s, failed = now
                taken = advance_over(stepper, model, s, start.h / substeps, failed == 0)
                return taken.state, failed + jnp.where(i < counted, taken.failed, 0)

            s, failed = jax.lax.fori_loop(0, substeps, part, now)
            return (s, failed), (s.r, s.v)

        return split(differentiate(interval, x, directions, now, start))

    def first(x: Array, start: Start) -> tuple[Any, Any]:
        s = begin(stepper, model_at(x), start.state).state
        # steps that are not reached keep the first pose: a link of zero length would have no angle
        shelf = tuple(jnp.broadcast_to(a, (capacity, *a.shape)) for a in (s.r, s.v))
        return (s, jnp.zeros((), jnp.int32)), shelf

    now, shelf = split(differentiate(first, x, directions, start))
    now, rows = scan_steps(save, now, steps, swap_rows(shelf))
    return swap_rows(rows), now.tree[1]


def at_samples(start: Start, angles: Array, rates: Array, index: Array, fraction: Array, on_grid: bool) -> Array:
    """Angles (S, n) at positions in steps (S,), integer and fraction, by those after every step (steps, n).

    Between steps they are cubics with the steps' rates (Hermite), whose error is below the scheme's own.
    """
    angles = jnp.concatenate([start.theta[None], angles])
    if on_grid:
        return angles[index]
    rates = jnp.concatenate([start.omega[None], rates])
    before = angles[index]
    rate_before = rates[index]
    rate_after = rates[index + 1]
    turn = planar.wrap(angles[index + 1] - before)
    s = fraction[:, None]
    by_rates = start.h * ((s - 2 * s**2 + s**3) * rate_before + (s**3 - s**2) * rate_after)
    return before + turn * (3 * s**2 - 2 * s**3) + by_rates
