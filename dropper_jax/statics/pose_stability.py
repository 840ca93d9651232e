"""Stability of an equilibrium: its stiffness, its softest displacement, and the path away from an unstable one."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.solvers.dense import residual_matrix
from dropper_jax.statics.moves import moves_of, stiffness_matrix
from dropper_jax.statics.rest_problem import RestProblem, soft_scale


@cached_jit()
def stiffness_and_motions(model: Model, s: State) -> tuple[Array, Array]:
    """K (k, k) [N/m] of the motions (3 free, k) of lines that stretch and of rigid bodies, and these motions."""
    moves = moves_of(model)
    loads = jnp.zeros_like(s.r)
    motions = jax.jacfwd(lambda x: moves.move_pose(s, loads, x).r)(moves.zero_displacement)
    return moves.tangent.dense(stiffness_matrix(moves, s, loads)), motions.reshape(s.r.size, -1)


def stiffness_of_motions(model: Model, s: State) -> tuple[np.ndarray, np.ndarray]:
    """The stiffness on the host, also with rigid links: that of motions which keep their lengths.

    Of rows `f(x, T)` and lengths `y(x, T)`: T of a link that stretches follows from x, the others' y must not change.
    """
    from scipy.linalg import null_space  # noqa: PLC0415

    if model.line.axial.elastic:
        stiffness, motions = stiffness_and_motions(model, s)
        return np.asarray(stiffness), np.asarray(motions)
    matrix = np.asarray(_rows_by_unknowns(model, s))
    size = s.r.size
    is_soft = np.diag(matrix)[size:] != 0.0
    force_by_position = matrix[:size, :size]
    force_by_tension = matrix[:size, size:][:, is_soft]
    length_by_position = matrix[size:, :size]
    compliance = np.diag(matrix)[size:][is_soft, None]
    motions = null_space(length_by_position[~is_soft])
    stretching = force_by_tension @ (length_by_position[is_soft] / compliance)
    return motions.T @ (force_by_position - stretching) @ motions, motions


@cached_jit()
def _rows_by_unknowns(model: Model, s: State) -> Array:
    problem = RestProblem(model, s, jnp.zeros_like(s.r))
    return residual_matrix(problem, Unknowns(jnp.zeros_like(s.r), s.tension))


#: The check is too slow for more free nodes than this.
MAX_CHECKED_NODES = 200


def is_stable(model: Model, s: State) -> bool:
    """Whether no displacement that keeps the lengths of rigid links reduces the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (minimum real part if drag makes it
    unsymmetric: every slow motion returns), relative to the mean weight of a link per length. A line with all links in
    tension under dead loads is stable. Systems of more than 200 nodes are not checked.
    """
    if model.constant_force and np.all(np.asarray(s.tension) > 0.0):
        return True
    if model.free_nodes > MAX_CHECKED_NODES:
        return True
    return softest_displacement(model, s)[0] > -_rounding(model)


def is_stable_or_planar(model: Model, s: State) -> bool:
    """Whether an equilibrium is stable, or lies in one plane under dead loads and is stable against motions in it.

    A link in compression may tip out of the plane. A dropper lifted within its plane has no force that tips it: its
    motion after the release stays in the plane.
    """
    if is_stable(model, s):
        return True
    normal = None
    if model.constant_force:
        normal = plane_normal(model, s)
    return normal is not None and softest_displacement(model, s, normal)[0] > -_rounding(model)


#: Rounding error of a stiffness over the weight of a link per its length [-].
STIFFNESS_ROUNDING = 1e-6


def _rounding(model: Model) -> float:
    """Rounding error of a stiffness [N/m]."""
    return STIFFNESS_ROUNDING * float(soft_scale(model, np))


#: Third singular value of the links over the largest [-] below which they are in one plane.
PLANAR_RATIO = 1e-9
#: Second singular value of the links over the largest [-] up to which they are on one straight line.
STRAIGHT_RATIO = 1e-6


def plane_normal(model: Model, s: State) -> np.ndarray | None:
    """Unit normal of the one plane that contains all links; None if no plane or more than one does."""
    links = np.asarray(model.links(s.r, model.ends(s.t)))
    if len(links) == 2:
        links = np.vstack([links, np.zeros(3)])  # without a third row there is no third direction
    _, size, directions = np.linalg.svd(links, full_matrices=False)
    if len(size) < 3:  # a single link is in many planes
        return None
    is_planar = size[2] < PLANAR_RATIO * size[0]
    is_straight = size[1] <= STRAIGHT_RATIO * size[0]
    if is_planar and not is_straight:
        return directions[2]
    return None


#: Difference of a stiffness from its transpose, over its maximum entry, above which it has no energy.
UNSYMMETRIC = 1e-8


def softest_displacement(model: Model, s: State, normal: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    """Minimum stiffness [N/m] of an equilibrium and its displacement (free nodes, 3), maximum 1.

    With a `normal`, only displacements in the plane across it.
    """
    from scipy.linalg import null_space  # noqa: PLC0415

    k, motions = stiffness_of_motions(model, s)
    if normal is not None:
        across = motions.reshape(-1, 3, motions.shape[1])
        inside = null_space(np.einsum("a,nam->nm", normal, across), rcond=1e-9)
        k = inside.T @ k @ inside
        motions = motions @ inside
    if not k.size:
        return np.inf, np.zeros(s.r.shape)
    values, vectors = np.linalg.eigh(0.5 * (k + k.T))
    if values[0] < 0.0 and np.max(np.abs(k - k.T)) > UNSYMMETRIC * np.max(np.abs(k)):
        # drag turns with the links: a cycle of displacements may gain or lose energy
        values, vectors = np.linalg.eig(k)
    softest = np.argmin(values.real)
    motion = (motions @ vectors[:, softest].real).reshape(s.r.shape)
    return float(values[softest].real), motion / np.max(np.abs(motion))


#: The first displacement from an unstable equilibrium, in lengths of a link.
FIRST_DISPLACEMENT = 0.1


def escape_unstable_equilibrium(
    model: Model, s: State, residual: float, tolerance: float, find: Callable[[State, float], tuple[State, float]]
) -> tuple[State, float]:
    """From an unstable equilibrium to a stable one near it, if there is one; else the same equilibrium with its
    residual.

    Examples are an upright rod, and a rope along a current, which drifts sideways after any small disturbance.

    Args:
        find: returns the equilibrium and its residual from a start to either side along the softest displacement; it
            gets the stiffness [N/m] of this displacement.
    """
    if is_stable(model, s):
        return s, residual
    stiffness, side = softest_displacement(model, s)
    nudge = FIRST_DISPLACEMENT * float(np.mean(np.asarray(model.line.length))) * side
    for start in (s.r + nudge, s.r - nudge):
        found, size = find(state(model, start, tension=s.tension, t=s.t), stiffness)
        if size <= tolerance and is_stable(model, found):
            return found, size
    return s, residual
