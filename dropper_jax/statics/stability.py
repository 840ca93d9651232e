"""Stability of an equilibrium, and the path from an unstable to a stable one."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.solvers.dense import residual_matrix
from dropper_jax.statics.bodies import moves_of
from dropper_jax.statics.rest_problem import RestProblem, force_scale
from dropper_jax.statics.tangent import stiffness_matrix

#: Maximum number of free nodes for the stability check, the negative stiffness (over the weight of a link per its
#: length)
#: that is rounding, and the first displacement from an unstable equilibrium, in lengths of a link.
FEW, ROUNDING, NUDGE = 200, 1e-6, 0.1
#: Difference of a stiffness from its transpose, over its maximum entry, above which it has no energy.
TURNING = 1e-8


@cached_jit(brief=True)
def stiffness_and_motions(model: Model, s: State) -> tuple[jax.Array, jax.Array]:
    """K (k, k) [N/m] of the motions (3 free, k) of lines that stretch and of rigid bodies, and these motions."""
    moves, loads = moves_of(model), jnp.zeros_like(s.r)
    motions = jax.jacfwd(lambda x: moves.move_pose(s, loads, x).r)(moves.none)
    return moves.tangent.dense(stiffness_matrix(moves, s, loads)), motions.reshape(s.r.size, -1)


def stiffness_of_motions(model: Model, s: State) -> tuple[np.ndarray, np.ndarray]:
    """The stiffness on the host, also with rigid links: that of motions which keep their lengths.

    Of rows `f(x, T)` and lengths `y(x, T)`: T of a link that stretches follows from x, the others' y must not change.
    """
    from scipy.linalg import null_space  # noqa: PLC0415

    if model.line.axial.elastic:
        return tuple(np.asarray(part) for part in stiffness_and_motions(model, s))
    matrix, size = np.asarray(_rows_by_unknowns(model, s)), s.r.size
    soft = np.diag(matrix)[size:] != 0.0
    force, lengths = matrix[:size, size:][:, soft], matrix[size:, :size]
    compliance = np.diag(matrix)[size:][soft, None]
    motions = null_space(lengths[~soft])
    return motions.T @ (matrix[:size, :size] - force @ (lengths[soft] / compliance)) @ motions, motions


@cached_jit(brief=True)
def _rows_by_unknowns(model: Model, s: State) -> jax.Array:
    problem = RestProblem(model, s, jnp.zeros_like(s.r))
    return residual_matrix(problem, Unknowns(jnp.zeros_like(s.r), s.tension))


def stable(model: Model, s: State) -> bool:
    """Whether no displacement that keeps the lengths of rigid links reduces the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (minimum real part if drag makes it
    unsymmetric: every slow motion returns), relative to the mean weight of a link per length. A line with all links in
    tension under dead loads is stable. Systems of more than `FEW` nodes are not checked.
    """
    if model.constant_force and np.all(np.asarray(s.tension) > 0.0) or model.free_nodes > FEW:
        return True
    scale = float(force_scale(model, np)) / np.mean(np.asarray(model.line.length))
    return softest(model, s)[0] > -ROUNDING * scale


def softest(model: Model, s: State) -> tuple[float, np.ndarray]:
    """Minimum stiffness [N/m] of an equilibrium and its displacement (free nodes, 3), maximum 1."""
    k, motions = stiffness_of_motions(model, s)
    if not k.size:
        return np.inf, np.zeros(s.r.shape)
    values, vectors = np.linalg.eigh(0.5 * (k + k.T))
    if values[0] < 0.0 and np.max(np.abs(k - k.T)) > TURNING * np.max(np.abs(k)):
        # drag turns with the links: a cycle of displacements may gain or lose energy
        values, vectors = np.linalg.eig(k)
        values, vectors = values.real, vectors.real
    least = int(np.argmin(values))
    way = (motions @ vectors[:, least]).reshape(s.r.shape)
    return float(values[least]), way / np.max(np.abs(way))


def escape(
    model: Model, s: State, residual: float, tolerance: float, find: Callable[[State, float], tuple[State, float]]
) -> tuple[State, float]:
    """From an unstable equilibrium to a stable one near it, if there is one; else the same equilibrium with its
    residual.

    Examples are an upright rod, and a rope along a current, which drifts sideways after any small disturbance.

    Args:
        find: returns the equilibrium and its residual from a start to either side along the softest displacement; it
            gets the stiffness [N/m] of this displacement.
    """
    if stable(model, s):
        return s, residual
    stiffness, side = softest(model, s)
    nudge = NUDGE * float(np.mean(np.asarray(model.line.length))) * side
    for start in (s.r + nudge, s.r - nudge):
        found, size = find(state(model, start, tension=s.tension, t=s.t), stiffness)
        if size <= tolerance and stable(model, found):
            return found, size
    return s, residual
