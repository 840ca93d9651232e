"""A window's motion step by step with its scheme, and its angles at the samples."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from dropper_jax.base.errors import SceneError
from dropper_jax.integrators.rattle_4 import Rattle4
from dropper_jax.model import Model, State
from dropper_jax.residual import Stepper
from dropper_jax.solvers import SOLVERS
from dropper_jax.stepping.control import advance_over
from dropper_jax.stepping.controlled import advance_controlled, start_controlled
from dropper_jax.stepping.integrate import begin, scan_steps
from dropper_jax.stepping.stepper import make_stepper
from fitting.traces import planar


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


def march(
    stepper: Stepper,
    model: Model,
    s: State,
    dt: jax.Array,
    capacity: int,
    substeps: jax.Array,
    steps: jax.Array | int,
    counted: jax.Array | int,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Angles and rates (capacity, n) after every step of dt, and the number of failed (sub)steps among the first
    `counted`; undefined beyond `steps`.

    Each step is divided into `substeps` parts. Both numbers are traced, so that one program serves every step size and
    windows of any length. Schemes with error control become more exact accordingly; their output interval is dt.
    """
    if stepper.integrator.controls_error:
        finer = jnp.asarray(substeps, model.dtype) ** -stepper.integrator.order
        # permitted step error relative to the shortest link for schemes with error control: on the lab dropper angles
        # are then within 5e-5 rad after 3 s, 1 % of the noise
        allowed = jax.lax.stop_gradient(1e-4 * jnp.min(model.line.length) * finer)
        start = start_controlled(stepper, model, s, allowed)
        end, (found, _) = advance_controlled(stepper, model, start, dt, allowed, capacity)
        return *jax.vmap(partial(planar.from_nodes, model))(found.r, found.v), end.bad

    def full_interval(carry: tuple[State, jax.Array], i: jax.Array) -> tuple[tuple[State, jax.Array], tuple[Any, ...]]:
        def part(_: jax.Array, carry: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
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
    a, ra, rb = angles[index], rates[index], rates[index + 1]
    turn = planar.wrap(angles[index + 1] - a)
    s = fraction[:, None]
    return a + turn * (3 * s**2 - 2 * s**3) + dt * ((s - 2 * s**2 + s**3) * ra + (s**3 - s**2) * rb)
