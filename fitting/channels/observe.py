"""One uninterrupted run as observed by every channel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import GRAVITY
from dropper_jax.model import State, state
from dropper_jax.modelling.build import from_angles
from dropper_jax.residual import Stepper
from dropper_jax.statics.loads import nodal_loads
from dropper_jax.statics.static_pose import settle
from dropper_jax.stepping.integrate import integrate
from fitting.channels.channel import Channel, SavedMotion
from fitting.channels.setup import Setup


@dataclass(frozen=True)
class RunPlan:
    """Static settings of a run: scheme, kind of start, channels, and number of saved states."""

    stepper: Stepper
    start: str
    zero: str | None
    release_nodes: tuple[int, ...] | None
    channels: tuple[Channel, ...]
    saves: int
    every: int


def start_state(plan: RunPlan, setup: Setup, near: State) -> State:
    """The start, which follows the model: a static pose is solved from a nearby one, angles keep their values.

    `initial_state` also gives the first tensions, whose derivatives compile three times as long.
    """
    model = setup.model
    given = setup.start
    if plan.start == "static":
        return settle(model, near, nodal_loads(model, plan.release_nodes, given.get("release_force")))
    if plan.start == "angles":
        s = from_angles(model, given["polar"], given["azimuth"], given["polar_rate"], given["azimuth_rate"], plan.zero)
    elif plan.start == "positions":
        free = slice(1, 1 + model.free_nodes)
        s = state(model, given["positions"][free], given["velocities"][free])
    else:
        s = state(model, near.r, near.v)
    return state(model, s.r, s.v, jax.lax.stop_gradient(near.tension))


def at_times(y: Array, first: Array, spacing: Array, t: Array) -> Array:
    """Values (k, m) at times t (k,) [s] of rows y (S, m) at `first + i spacing`: cubics through four rows."""
    row = (t - first) / spacing
    i = jax.lax.stop_gradient(jnp.clip(jnp.floor(row) - 1, 0, y.shape[0] - 4)).astype(int)
    a, b, c, d = (row - i - k for k in range(4))
    shares = (-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6)
    return sum(share[:, None] * y[i + k] for k, share in enumerate(shares))


def observe_channels(
    plan: RunPlan, setup: Setup, near: State, dt: Array, times: tuple[Array, ...]
) -> tuple[tuple[Array, ...], State, Array]:
    """Channel values at the stamps `times`, (k, m) each [SI]; the start; the first failed step (-1: none)."""
    model = setup.model
    s = start_state(plan, setup, near)
    # tangents in all that a step changes, so that JAX differentiates the loop over the steps once
    zero = 0.0 * jnp.sum(s.r)
    s = replace(s, v=s.v + zero, tension=s.tension + zero)
    _, run = integrate(plan.stepper, model, s, dt, plan.saves * plan.every, plan.every, warn=False)
    spacing = dt * plan.every
    t = jnp.arange(plan.saves + 1) * spacing
    nodes = jax.vmap(lambda r, t: model.nodes(r, model.ends(t)))(jnp.concatenate([s.r[None], run.r]), t)
    early = (1 - plan.stepper.integrator.tension_time) / plan.every
    gravity = next((effect.gravity for effect in model.effects if effect.name == "weight"), GRAVITY)
    motion = SavedMotion(nodes, nodes[1:] - early * jnp.diff(nodes, axis=0), run.tension, spacing, gravity)
    shown = []
    for channel, reading, stamps in zip(plan.channels, setup.readings, times, strict=True):
        when = stamps
        if channel.camera is not None:
            clock = setup.clocks[channel.camera]
            when = clock.rate * stamps - clock.delay
        when = jnp.maximum(when - reading.delay, 0.0)
        first = spacing * (1 - early) if channel.of_tension else channel.margin * spacing
        perfect = channel.mounted(reading.position, reading.turn).see(motion)
        shown.append(reading.offset + reading.gain * at_times(perfect, first, spacing, when))
    return tuple(shown), s, run.first_bad[-1]


def shift_setup(setup: Setup, tangents: Setup, e: Array) -> Setup:
    """The setup after a step (k,) along each direction."""
    return jax.tree.map(lambda a, d: a + jnp.tensordot(e, d, 1), setup, tangents)


@cached_jit(static=("plan",), kernel=True)
def differentiate_channels(
    plan: RunPlan, setup: Setup, tangents: Setup, near: State, dt: Array, times: tuple[Array, ...]
) -> tuple[tuple[Array, ...], tuple[Array, ...], State, Array]:
    """Channel values, their derivatives (k, m, directions), the start, and the first failed step."""

    def observe(e: Array) -> tuple[tuple[Array, ...], tuple[tuple[Array, ...], State, Array]]:
        shown, s, bad = observe_channels(plan, shift_setup(setup, tangents, e), near, dt, times)
        return shown, (shown, s, bad)

    slopes, (shown, s, bad) = jax.jacfwd(observe, has_aux=True)(jnp.zeros(len(jax.tree.leaves(tangents)[0]), dt.dtype))
    return shown, slopes, s, bad
