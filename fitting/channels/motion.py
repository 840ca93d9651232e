"""One uninterrupted run as observed by every channel, with exact derivatives in directions of all of its numbers.

All numbers that a parameter may change are in one pytree (`Setup`). The host specifies how each parameter changes it
(`tangents`, with one more axis in front), so that one compiled program serves every choice of free parameters:

    y(e) = channels(run(setup + sum_i e_i tangents_i)),      values y(0), derivatives dy/de at 0 by forward mode
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.run.build import from_angles
from dropper_jax.statics.static_pose import nodal_loads, settle
from dropper_jax.stepping.integrate import integrate
from dropper_jax.stepping.stepper import Stepper
from fitting.channels.channel import Channel, SavedMotion


class Reading(NamedTuple):
    """Sensor of one channel: offset (m,) [SI], gain () [-], delay () [s]."""

    offset: jax.Array
    gain: jax.Array
    delay: jax.Array


class Clock(NamedTuple):
    """Clock of one camera: a stamp t is taken at `rate t - delay` of the scene's time."""

    delay: jax.Array
    rate: jax.Array


class Setup(NamedTuple):
    """All numbers of a run.

    Attributes:
        model: the model with its parameters.
        start: fields of the scene's start, by name.
        readings: one per channel.
        clocks: one per camera.
    """

    model: Model
    start: dict[str, jax.Array]
    readings: tuple[Reading, ...]
    clocks: tuple[Clock, ...]


@dataclass(frozen=True)
class Plan:
    """Static settings of a run: scheme, kind of start, channels, and number of saved states."""

    stepper: Stepper
    start: str
    zero: str | None
    release_nodes: tuple[int, ...] | None
    channels: tuple[Channel, ...]
    saves: int
    every: int


def begin(plan: Plan, setup: Setup, near: State) -> State:
    """The start, which follows the model: a static pose is solved from a nearby one, angles keep their values."""
    model, given = setup.model, setup.start
    if plan.start == "static":
        return settle(model, near, nodal_loads(model, plan.release_nodes, given.get("release_force")))
    if plan.start == "angles":
        s = from_angles(model, *(given[key] for key in ("polar", "azimuth", "polar_rate", "azimuth_rate")), plan.zero)
    elif plan.start == "positions":
        free = slice(1, 1 + model.free_nodes)
        s = state(model, given["positions"][free], given["velocities"][free])
    else:
        s = state(model, near.r, near.v)
    return state(model, s.r, s.v, jax.lax.stop_gradient(near.tension))


def at_times(y: jax.Array, first: jax.Array, spacing: jax.Array, t: jax.Array) -> jax.Array:
    """Values (k, m) at times t (k,) [s] of rows y (S, m) at `first + i spacing`: cubics through four rows."""
    row = (t - first) / spacing
    i = jax.lax.stop_gradient(jnp.clip(jnp.floor(row) - 1, 0, y.shape[0] - 4)).astype(int)
    u = row - i
    a, b, c, d = u, u - 1, u - 2, u - 3
    shares = (-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6)
    return sum(share[:, None] * y[i + k] for k, share in enumerate(shares))


def observe_channels(
    plan: Plan, setup: Setup, near: State, dt: jax.Array, times: tuple[jax.Array, ...]
) -> tuple[tuple[jax.Array, ...], State, jax.Array]:
    """Channel values at the stamps `times`, (k, m) each [SI]; the start; the first failed step (-1: none)."""
    model = setup.model
    s = begin(plan, setup, near)
    # tangents in all that a step changes, so that JAX differentiates the loop over the steps once
    zero = 0.0 * jnp.sum(s.r)
    s = replace(s, v=s.v + zero, tension=s.tension + zero)
    _, run = integrate(plan.stepper, model, s, dt, plan.saves * plan.every, plan.every)
    spacing = dt * plan.every
    t = jnp.arange(plan.saves + 1) * spacing
    nodes = jax.vmap(lambda r, t: model.nodes(r, model.ends(t)))(jnp.concatenate([s.r[None], run.r]), t)
    early = (1 - plan.stepper.integrator.tension_time) / plan.every
    motion = SavedMotion(nodes, nodes[1:] - early * jnp.diff(nodes, axis=0), run.tension)
    shown = []
    for channel, reading, stamps in zip(plan.channels, setup.readings, times, strict=True):
        when = stamps
        if channel.camera is not None:
            clock = setup.clocks[channel.camera]
            when = clock.rate * stamps - clock.delay
        when = jnp.maximum(when - reading.delay, 0.0)
        first = spacing * (1 - early) if channel.of_tension else jnp.zeros_like(spacing)
        shown.append(reading.offset + reading.gain * at_times(channel.see(motion), first, spacing, when))
    return tuple(shown), s, run.first_bad[-1]


def shift_setup(setup: Setup, tangents: Setup, e: jax.Array) -> Setup:
    """The setup after a step (k,) along each direction."""
    return jax.tree.map(lambda a, d: a + jnp.tensordot(e, d, 1), setup, tangents)


def differentiate_channels(
    plan: Plan, setup: Setup, tangents: Setup, near: State, dt: jax.Array, times: tuple[jax.Array, ...]
) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...], State, jax.Array]:
    """Channel values, their derivatives (k, m, directions), the start, and the first failed step."""
    # one kernel takes twice as long to compile, which pays for single lines only
    program = _differentiate_system if plan.stepper.until_converged else _differentiate_line
    return program(plan, setup, tangents, near, dt, times)


def _differentiate(
    plan: Plan, setup: Setup, tangents: Setup, near: State, dt: jax.Array, times: tuple[jax.Array, ...]
) -> tuple[tuple[jax.Array, ...], tuple[jax.Array, ...], State, jax.Array]:
    def of(e: jax.Array) -> Any:
        shown, s, bad = observe_channels(plan, shift_setup(setup, tangents, e), near, dt, times)
        return shown, (shown, s, bad)

    slopes, (shown, s, bad) = jax.jacfwd(of, has_aux=True)(jnp.zeros(len(jax.tree.leaves(tangents)[0]), dt.dtype))
    return shown, slopes, s, bad


_differentiate_line = cached_jit(static=("plan",))(_differentiate)
_differentiate_system = cached_jit(static=("plan",), brief=True)(_differentiate)
