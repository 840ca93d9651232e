"""The equilibrium of a single line: it hangs under dead loads, or follows growing loads from a catenary."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.weight import Weight
from dropper_jax.model import Ends, Model, State, state
from dropper_jax.residual import GRAVITY_SCALE
from dropper_jax.statics.catenary import catenary_guess
from dropper_jax.statics.dead_loads import hang_under_loads
from dropper_jax.statics.rest_problem import polish, solve_statics, system_tolerance

#: Number of times that a line hangs again, under the forces at its last configuration.
REHANGINGS = 4


def hang_and_solve(model: Model, loads: Array, t: float) -> tuple[State, float]:
    """The stable equilibrium under the forces on a straight guess, updated if they depend on the configuration."""
    s = _hang(model, loads, None, t)
    if not model.constant_force:
        for _ in range(REHANGINGS):
            s = _hang(model, loads, s.r, t)
    return solve_statics(model, s, loads)


def _host_ends(ends: Ends) -> tuple[np.ndarray, np.ndarray | None]:
    """Start and end (3,) [m] of a line on the host; None for a free end."""
    end = None if ends.end is None else np.asarray(ends.end, float)
    return np.asarray(ends.start, float), end


def _hang(model: Model, loads: Array, r: Array | None, t: float) -> State:
    """The equilibrium under the forces at the positions r, as dead loads."""
    line = model.line
    ends, force = _forces(model, r, jnp.asarray(t, model.dtype))
    total = np.asarray(force, float) + np.asarray(loads, float)
    if not np.any(total):
        raise SceneError(
            "start.kind: 'static' needs a load that gives the line its shape; add [effects.weight] or start from "
            "'angles' or 'positions'"
        )
    flexibility = np.zeros(line.links)
    if line.axial.elastic:
        flexibility += 1.0 / line.axial.axial_stiffness()
    nodes, tension = hang_under_loads(*_host_ends(ends), np.asarray(line.length, float), total, flexibility)
    return state(model, nodes, tension=tension, t=t)


@cached_jit()
def _forces(model: Model, r: Array | None, t: Array) -> tuple[Ends, Array]:
    """The fixed ends, and the forces (free nodes, 3) [N] on nodes at rest at positions r, or at the start of the
    line."""
    ends = model.ends(t)
    if r is None:
        r = jnp.broadcast_to(ends.start, (model.free_nodes, 3))
    return ends, model.force(model.instant(r, jnp.zeros_like(r), t, ends))


#: First and minimum load increment of the continuation, as fractions of the loads.
FIRST_INCREMENT = 1.0 / 8
MIN_INCREMENT = 1.0 / 1024
#: Displacement of a node, over the length of the line, at which an increment may have jumped to another branch.
JUMP_DISPLACEMENT = 0.5


def follow_growing_loads(model: Model, loads: Array, t: float) -> tuple[State, float, float]:
    """Load continuation from the catenary; returns the fraction of the loads that was reached."""
    s, residual = solve_statics(model, _catenary(model, t), jnp.zeros_like(loads))
    if not np.any(np.asarray(loads)):
        return s, residual, 1.0
    share = 0.0
    increment = FIRST_INCREMENT
    tolerance = system_tolerance(model)
    while residual <= tolerance and share < 1.0 and increment >= MIN_INCREMENT:
        step = min(increment, 1.0 - share)
        trial, trial_residual = solve_statics(model, s, (share + step) * loads)
        jumps = jnp.max(jnp.abs(trial.r - s.r)) >= JUMP_DISPLACEMENT * jnp.sum(model.line.length)
        if trial_residual <= tolerance and not jumps:
            s = trial
            residual = trial_residual
            share += step
            increment = 2.0 * step
        else:
            increment = step / 2.0
    return s, residual, share


def _catenary(model: Model, t: float) -> State:
    """The line at time t as a catenary under its weight."""
    ends = model.ends(jnp.asarray(t, model.dtype))
    line = model.line
    weight = model.effect("weight")
    links = weight.per_link(line) if isinstance(weight, Weight) else GRAVITY_SCALE * line.mass
    total = float(jnp.sum(links))
    nodes, tension = catenary_guess(*_host_ends(ends), np.asarray(line.length, float), total)
    return state(model, nodes[1 : 1 + model.free_nodes], tension=tension, t=t)


#: Corrections of the descent from an unstable equilibrium.
FALL_ITERATIONS = 80


def fall_from(model: Model, loads: Array, s: State, stiffness: float) -> tuple[State, float]:
    """The equilibrium reached by descent from `s`, next to one with a (negative) stiffness [N/m]."""
    kappa = jnp.asarray(4.0 * abs(stiffness), model.dtype)
    fallen, _ = polish(model, s, loads, kappa, iterations=FALL_ITERATIONS, damped=False)
    return solve_statics(model, fallen, loads)
