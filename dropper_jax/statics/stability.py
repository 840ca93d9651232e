"""Whether a pose at rest is stable, and the way from one that is not to one that is."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.solvers.dense import residual_matrix
from dropper_jax.statics.bodies import moves_of
from dropper_jax.statics.rest_problem import RestProblem, force_scale
from dropper_jax.statics.tangent import stiffness_matrix

#: Free nodes up to which stability is looked at, how negative a stiffness (over the weight of a link per its length)
#: may be for rounding, and the first displacement from an unstable pose, in lengths of a link.
FEW, ROUNDING, NUDGE = 200, 1e-6, 0.1
#: Difference of a stiffness from its transpose, over its largest entry, beyond which it has no energy.
TURNING = 1e-8


@cached_jit(brief=True)
def stiffness_and_motions(model: Model, s: State) -> tuple[jax.Array, jax.Array]:
    """K (k, k) [N/m] of the motions (3 free, k) of lines that stretch and of rigid bodies, and these motions."""
    moves, loads = moves_of(model), jnp.zeros_like(s.r)
    motions = jax.jacfwd(lambda x: moves.move_pose(s, loads, x).r)(moves.none)
    return moves.tangent.dense(stiffness_matrix(moves, s, loads)), motions.reshape(s.r.size, -1)


def stiffness_of_motions(model: Model, s: State) -> tuple[np.ndarray, np.ndarray]:
    """The same on the host, and with rigid links: of the motions that leave these their lengths.

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
    """Whether no displacement that keeps rigid links' lengths lowers the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (least real part where drag makes it
    unsymmetric: every slow motion returns), against the mean weight of a link per length. A line whose links are all
    in tension under dead loads is stable, and systems of more than `FEW` nodes are not looked at.
    """
    if model.constant_force and np.all(np.asarray(s.tension) > 0.0) or model.free_nodes > FEW:
        return True
    scale = float(force_scale(model, np)) / np.mean(np.asarray(model.line.length))
    return softest(model, s)[0] > -ROUNDING * scale


def softest(model: Model, s: State) -> tuple[float, np.ndarray]:
    """The least stiffness [N/m] of a pose and the displacement (free nodes, 3), largest 1, that meets it."""
    k, motions = stiffness_of_motions(model, s)
    if not k.size:
        return np.inf, np.zeros(s.r.shape)
    values, vectors = np.linalg.eigh(0.5 * (k + k.T))
    if values[0] < 0.0 and np.max(np.abs(k - k.T)) > TURNING * np.max(np.abs(k)):
        # drag turns with the links: what it adds on one way it may take on the way back
        values, vectors = np.linalg.eig(k)
        values, vectors = values.real, vectors.real
    least = int(np.argmin(values))
    way = (motions @ vectors[:, least]).reshape(s.r.shape)
    return float(values[least]), way / np.max(np.abs(way))


def escape(
    model: Model, s: State, residual: float, tolerance: float, find: Callable[[State, float], tuple[State, float]]
) -> tuple[State, float]:
    """From an unstable pose to a stable one next to it, if there is one; else the pose as it is, with its residual.

    A rod may stand upright, a rope laid out along a current drift aside at the least push.

    Args:
        find: the pose, and its residual, that is reached from a start to either side of the softest displacement; it
            is given that one's stiffness [N/m].
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
