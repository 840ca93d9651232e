"""Whether a pose at rest is stable, and the way from one that is not to one that is."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.programs import kept
from dropper_jax.model import Model, State
from dropper_jax.residual import Unknowns
from dropper_jax.solvers import SOLVERS
from dropper_jax.solvers.dense import residual_matrix
from dropper_jax.statics.rest_problem import (
    DENSE_LIMIT,
    RestProblem,
    force_scale,
    polish,
    solve_statics,
    static_tolerance,
)

#: First displacement from an unstable pose, in lengths of a link, and steps of the fall that follows.
NUDGE = 0.1
FALL_STEPS = 80
#: Difference of a stiffness from its transpose, over its largest entry, beyond which it has no energy.
TURNING = 1e-8


def stable(model: Model, s: State) -> bool:
    """Whether no displacement that keeps rigid links' lengths lowers the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (least real part where drag makes it
    unsymmetric: every slow motion returns), against the mean tension, or weight, per length. A
    line whose links are all in tension under dead loads is stable, and long ones are not looked at further.
    """
    tension = np.asarray(s.tension)
    if (tension > 0).all() and model.constant_force:
        return True
    if SOLVERS["dense"].size(model) > DENSE_LIMIT:
        return True
    scale = max(np.abs(tension).mean(), float(force_scale(model, np))) / np.mean(np.asarray(model.line.length))
    return softest(model, s)[0] > -1e-6 * scale


def softest(model: Model, s: State) -> tuple[float, np.ndarray]:
    """The least stiffness [N/m] of a pose and the displacement (free nodes, 3) of size one that meets it."""
    stiffness = np.asarray(_stiffness(model, s))
    nodes = 3 * model.free_nodes
    k, g, c = stiffness[:nodes, :nodes], stiffness[nodes:, :nodes], stiffness[nodes:, nodes:]
    if model.line.axial.elastic:
        k, free = k - stiffness[:nodes, nodes:] @ np.linalg.solve(c, g), np.eye(nodes)
    else:
        free = _null_space(g)
        k = free.T @ k @ free
    if not k.size:
        return np.inf, np.zeros(s.r.shape)
    values, vectors = np.linalg.eigh(0.5 * (k + k.T))
    if values[0] < 0.0 and np.max(np.abs(k - k.T)) > TURNING * np.max(np.abs(k)):
        # drag turns with the links: what it adds on one way it may take on the way back
        values, vectors = np.linalg.eig(k)
        values, vectors = values.real, vectors.real
    least = int(np.argmin(values))
    return float(values[least]), (free @ vectors[:, least]).reshape(s.r.shape)


@kept(brief=True)
def _stiffness(model: Model, s: State) -> jax.Array:
    """The matrix of the static rows by places and tensions."""
    return residual_matrix(RestProblem(model, s, jnp.zeros_like(s.r)), Unknowns(jnp.zeros_like(s.r), s.tension))


def leave(model: Model, s: State, loads: jax.Array, residual: float) -> tuple[State, float]:
    """From an unstable pose down to a stable one, starting out to either side of the softest displacement."""
    stiffness, side = softest(model, s)
    nudge = NUDGE * float(np.mean(np.asarray(model.line.length))) / np.abs(side).max() * side
    for start in (s.r + nudge, s.r - nudge):
        drag = jnp.asarray(4.0 * abs(stiffness), model.dtype)
        fallen, _ = polish(model, replace(s, r=start), loads, drag, iterations=FALL_STEPS, damped=False)
        found, size = solve_statics(model, fallen, loads)
        if size <= static_tolerance(model) and stable(model, found):
            return found, size
    return s, residual


def _null_space(g: np.ndarray) -> np.ndarray:
    return np.linalg.svd(g)[2][len(g) :].T
