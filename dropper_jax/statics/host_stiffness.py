"""Tangent stiffness as a sparse matrix on the host: derivatives by parameters, and the softest and free motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model, State
from dropper_jax.statics.moves import NodeMoves, stiffness_matrix
from dropper_jax.statics.rest_problem import MIN_KAPPA, name_of, rest, soft_scale
from dropper_jax.statics.tangent import UNSOLVABLE, Tangent

if TYPE_CHECKING:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import SuperLU

Tree = TypeVar("Tree")


@cached_jit()
def _blocks(model: Model, s: State, loads: Array) -> Array:
    return stiffness_matrix(NodeMoves(model), s, loads)


def stiffness(model: Model, s: State, loads: Array) -> csc_array:
    """Minus the derivative of all forces by all positions (3 free, 3 free) [N/m], including drag and contact. On the
    host."""
    return Tangent.of(model).sparse(np.asarray(_blocks(model, s, loads)))


def factor_softened(model: Model, matrix: csc_array) -> SuperLU:
    """Factors of a stiffness, a little stiffer, so that it need not be regular. On the host."""
    from scipy.sparse import eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    return splu((matrix + MIN_KAPPA * float(soft_scale(model, np)) * eye_array(matrix.shape[0])).tocsc())


#: Number of inverse iterations for the softest motion; of several soft ones any may result.
INVERSE_ITERATIONS = 12
#: Stiffness, over the weight of a link per its length, below which a motion counts as free.
FREE_STIFFNESS = 1e-7


def free_motion(model: Model, s: State, loads: Array) -> str:
    """A note on the node that can move freely about an equilibrium; empty without any, and for inextensible links."""
    model = rest(model)
    if model.constraints or not model.line.axial.elastic:
        return ""
    matrix = stiffness(model, s, loads)
    factor = factor_softened(model, matrix)
    x = np.random.default_rng(0).normal(size=matrix.shape[0])
    for _ in range(INVERSE_ITERATIONS):
        x = factor.solve(x / np.linalg.norm(x))
    softest = float(np.linalg.norm(matrix @ (x / np.linalg.norm(x))))
    if softest > FREE_STIFFNESS * float(soft_scale(model, np)):
        return ""
    motion = x.reshape(-1, 3) / np.max(np.abs(x))
    node = int(np.argmax(np.max(np.abs(motion), axis=1)))
    along = ", ".join(f"{x:.2f}" for x in motion[node])
    return f"{name_of(model, node)} is unconstrained along ({along}), with a stiffness of {softest:.1e} N/m"


def follow_parameters(
    model: Model, count: int, slopes: Callable[[np.ndarray, np.ndarray], tuple[Array, Tree]]
) -> tuple[Tree, np.ndarray]:
    """Derivatives of an equilibrium by `count` parameters, `dx = -K^-1 dR/dp`, solved on the host.

    Args:
        slopes: derivatives of the unbalanced forces R (k, free, 3) [N] and of a tree along k directions of parameters
            (k, count) and positions (k, free, 3) [m]. One program serves K and R.

    Returns:
        the tree, whose last `count` directions are those of the parameters, and where there is no solution (count,).
    """
    tangent = Tangent.of(model)
    free = model.free_nodes
    seeds = tangent.seeds
    by_position = np.concatenate([seeds.reshape(-1, free, 3), np.zeros((count, free, 3))])
    by_value = np.concatenate([np.zeros((len(by_position) - count, count)), np.eye(count)])
    rows, found = slopes(by_value, by_position)
    blocks = tangent.blocks(np.asarray(rows[:-count]).reshape(seeds.shape))
    factor = factor_softened(model, tangent.sparse(blocks))
    right = rows[-count:]
    for _ in range(2):  # the second correction reduces the rounding error, and the error by the softening
        dx = factor.solve(np.asarray(rows[-count:]).reshape(count, -1).T)
        by_position[-count:] -= dx.T.reshape(count, -1, 3)
        rows, found = slopes(by_value, by_position)
    left = np.max(np.abs(rows[-count:]), axis=(1, 2))
    size = np.max(np.abs(right), axis=(1, 2))
    return found, left > UNSOLVABLE * size
