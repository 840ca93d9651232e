"""The local error of a step, and the length of the next one, so that a run follows the accuracy asked for.

    e = c h^3 (a1 - a0)/(h + lag (h - h0))                       error of positions (nodes, 3) [m], see `LocalError`
    J f = m M e/h^2,    J the matrix of the step                 the same as far as the step resolves it
    |f|/h <= 0.1 accuracy V                                      error of positions per unit of time
    EA/L |u . (f_b - f_a)| <= accuracy T                         error of the tensions of links that stretch

V is the largest speed of a node so far, T the largest tension of the line so far, u the direction of the link. The
matrix takes out of e what rigid links forbid, and divides a vibration of frequency w by `1 + (w h)^2/4`: without it the
stiffest vibration, which the scheme does not resolve, would set the step. Error per unit of time makes the errors of
results go with the accuracy. The change of tension over a step is no measure: with rigid links it alternates by `1/h`.

Explicit schemes with an embedded error estimate (`residual.Embedded`) keep that estimate below 0.001 accuracy, of
positions in m and of velocities in m/s.

The next step follows by PI control (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2) from the
errors e of this step and e0 of the last accepted one, relative to what is allowed, of order q in the step:

    h' = 0.9 e^(-0.7/q) e0^(0.4/q) h  after an accepted step,    0.9 e^(-1/q) h  after a rejected step
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import Graph, Model, State
from dropper_jax.residual import Embedded, Filter, Stepper, Unknowns

#: Order of the error of positions per unit of time.
ORDER = 2
#: Error of positions per unit of time, as a fraction of accuracy times speed: a motion turns several times, and errors
#: of its periods add up.
DRIFT = 0.1
#: Fraction of the predicted length of a step that is taken, and exponents of both errors times the order.
SAFETY = 0.9
NOW = 0.7
BEFORE = 0.4
#: Ratios of a step to the previous one.
SHORTER = 0.2
LONGER = 2.0
#: Bounds of the error relative to what is allowed; the upper one is that of a step that does not converge.
LEAST = 1e-4
MOST = 1e6
#: The shortest step, as a fraction of the period of the stiffest vibration along a line, and of the swing of the
#: shortest link.
AXIAL_SHARE = 1e-2
SWING_SHARE = 1e-3
#: The shortest step of an embedded estimate, which needs no safety from vibrations, over that share of the swing.
EMBEDDED_SHARE = 1e-3
#: Error of a step of an embedded estimate [m], [m/s] over the accuracy, and its floor over rounding.
TOLERANCE_SHARE = 1e-3
TOLERANCE_ROUNDING = 100.0
#: Speed [m/s] below which a line counts as at rest, over that of a fall by its mean link: errors there are rounding.
STILL = 1e-4
#: Tension of a line below which its errors do not count, over the largest of all lines at the start.
SMALL = 0.1


class Control(NamedTuple):
    """What the controller remembers.

    Attributes:
        wanted, before: the next step, and the last accepted one, 0 before there is one [s].
        excess: error of the last accepted step relative to what is allowed.
        rejected: whether the last step was rejected.
        level: largest tension of the line of each link so far (n,) [N].
        speed: largest speed of a node so far [m/s].
        refused: number of rejected steps.
        shortest: number of steps of the shortest length that were accepted with a larger error.
        changed: energy that changes of the step have added so far [J], see `Integrator.change_step`.
    """

    wanted: Array
    before: Array
    excess: Array
    rejected: Array
    level: Array
    speed: Array
    refused: Array
    shortest: Array
    changed: Array


def start_control(stepper: Stepper, model: Model, s: State) -> Control:
    """The controller at the start of a run. The first step is the shortest: it gives the first acceleration."""
    model, s = jax.lax.stop_gradient((model, s))
    zero = jnp.zeros((), model.dtype)
    none = jnp.zeros((), jnp.int32)
    level = _line_maximum(model.geometry, jnp.abs(s.tension))
    # a line without tension anywhere is going to carry its weights
    largest = jnp.where(jnp.max(level) > 0.0, jnp.max(level), GRAVITY * jnp.max(model.node_mass))
    still = STILL * jnp.sqrt(GRAVITY * jnp.mean(model.line.length))
    return Control(
        wanted=shortest_step(stepper, model),
        before=zero,
        excess=zero + 1.0,
        rejected=jnp.zeros((), bool),
        level=jnp.maximum(level, SMALL * largest),
        speed=jnp.maximum(still, _largest(s.v)),
        refused=none,
        shortest=none,
        changed=zero,
    )


def shortest_step(stepper: Stepper, model: Model) -> Array:
    """The shortest step [s] that is chosen: `w^2 <= 2 EA/L (1/m_a + 1/m_b)` bounds the stiffest vibration."""
    model = jax.lax.stop_gradient(model)
    fastest = jnp.max(2.0 * (model.line.axial.axial_stiffness() / model.line.length) * model.inverse_reduced_mass)
    swing = SWING_SHARE * 2.0 * jnp.pi * jnp.sqrt(jnp.min(model.line.length) / GRAVITY)
    if isinstance(stepper.integrator, Embedded):
        return (EMBEDDED_SHARE * swing).astype(model.dtype)
    axial = AXIAL_SHARE * 2.0 * jnp.pi / jnp.sqrt(jnp.maximum(fastest, jnp.finfo(model.dtype).tiny))
    return jnp.minimum(swing, axial).astype(model.dtype)


def error_rows(stepper: Stepper, before: Array) -> Filter:
    """Rows of which the matrix of a step makes the error of positions (nodes, 3) [m], as far as the step resolves it.

    Args:
        before: the last step [s].
    """
    about = stepper.integrator.local_error
    if about is None:
        raise ValueError(f"integrator: {stepper.integrator.name!r} does not know the error of its step")

    def rows(problem: Any, u: Unknowns) -> Unknowns:
        h = problem.h
        change = problem.finish(u).acceleration - problem.s.acceleration
        e = about.constant * h**3 * change / (h + about.lag * (h - before))
        force = problem.model.inertia(problem.instant(u.x), about.inertia / h**2 * e)
        return Unknowns(force, jnp.zeros_like(u.y), jax.tree.map(jnp.zeros_like, u.z))

    return rows


def allowed_error(accuracy: Array | float, dtype: Any) -> Array:
    """Error of a step [m], [m/s] that schemes with an embedded estimate allow."""
    return jnp.maximum(TOLERANCE_SHARE * accuracy, TOLERANCE_ROUNDING * float(jnp.finfo(dtype).eps)).astype(dtype)


def relative_error(
    model: Model, s: State, s1: State, h: Array, error: Array, control: Control, accuracy: Array
) -> Array:
    """The error of a step relative to what the accuracy allows, of second order in h, a scalar; not differentiated.

    Args:
        s, s1, h: start and end of the step, and its length [s].
        error: of the positions (nodes, 3) [m], see `error_rows`.
    """
    speed = jnp.maximum(control.speed, _largest(s1.v))
    drift = _largest(error) / h / (DRIFT * accuracy * speed)
    links = model.links(s1.r, model.ends(s1.t))
    direction = links / safe_norm(links)[:, None]
    elongation = jnp.sum(direction * model.geometry.differences(error, None), axis=-1)
    taut = (s.tension != 0.0) | (s1.tension != 0.0)
    tension = jnp.where(taut, (model.line.axial.axial_stiffness() / model.line.length) * jnp.abs(elongation), 0.0)
    of_tension = jnp.max(tension / control.level) / accuracy
    # an error of a step is of third order
    excess = jnp.maximum(drift, jnp.cbrt(of_tension) ** ORDER)
    # there is nothing to compare the first acceleration with
    return jnp.where(control.before > 0.0, jax.lax.stop_gradient(excess), LEAST)


def next_length(h: Array, excess: Array, control: Control, accepted: Array) -> Array:
    """The next step [s] after one of h [s], which is repeated if it is not accepted; not bounded."""
    h, now = jax.lax.stop_gradient((h, jnp.clip(excess, LEAST, MOST)))
    most = jnp.where(control.rejected | ~accepted, 1.0, LONGER)
    onward = now ** (-NOW / ORDER) * jnp.maximum(control.excess, LEAST) ** (BEFORE / ORDER)
    again = now ** (-1.0 / ORDER)
    return h * jnp.clip(SAFETY * jnp.where(accepted, onward, again), SHORTER, most)


def after_step(model: Model, s1: State, h: Array, excess: Array, wanted: Array, control: Control) -> Control:
    """The controller after an accepted step of h [s] to s1."""
    h, s1 = jax.lax.stop_gradient((h, s1))
    return control._replace(
        wanted=wanted,
        before=h,
        excess=jnp.clip(excess, LEAST, MOST),
        rejected=jnp.zeros((), bool),
        level=jnp.maximum(control.level, _line_maximum(model.geometry, jnp.abs(s1.tension))),
        speed=jnp.maximum(control.speed, _largest(s1.v)),
    )


def _largest(vectors: Array) -> Array:
    return jnp.max(safe_norm(vectors), initial=0.0)


def _line_maximum(geometry: Graph, values: Array) -> Array:
    """The largest value of the line of each link (n,). A gather: a scatter prevents a single kernel."""
    lengths = [member.links for member in geometry.members]
    starts = np.cumsum([0, *lengths[:-1]])
    within = np.minimum(np.arange(max(lengths)), np.array(lengths)[:, None] - 1)
    largest = jnp.max(values[starts[:, None] + within], axis=1)
    return largest[np.repeat(np.arange(len(lengths)), lengths)]
