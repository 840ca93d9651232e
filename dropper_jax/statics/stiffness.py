"""Mooring stiffness: change of the forces on chosen points with their displacements, all else in equilibrium.

    S = K_aa - K_ae K_ee^-1 K_ea,    K = -dF/dx        (a: the chosen points, e: all other free nodes)

F holds all static forces: tensions, weight, buoyancy with its waterline, contact, drag of a current (which makes S
unsymmetric). On a fixed point F is the force of the lines, since no other force acts on a support. A rigid body has six
degrees of freedom: displacements of its reference point, and rotations about the scene's axes there. Computed on the
host, with a sparse K if there are no bodies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import first_names
from dropper_jax.base.records import names_of
from dropper_jax.model import Ends, Model, State
from dropper_jax.residual import Unknowns
from dropper_jax.statics.body_moves import BodyMoves
from dropper_jax.statics.host_stiffness import factor_softened, free_motion, stiffness
from dropper_jax.statics.moves import Moves, moves_of
from dropper_jax.statics.rest_problem import RestProblem, check_point_names, name_of, require_stretching_links, rest
from dropper_jax.statics.tangent import REFINEMENTS, UNSOLVABLE

if TYPE_CHECKING:
    from scipy.sparse import csc_array

#: Degrees of freedom of a body, [m] and [rad]; a point has the first three.
FREEDOMS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Stiffness:
    """Stiffness of points and bodies about an equilibrium.

    Attributes:
        names: of points and bodies, in the requested order.
        freedoms: degrees of freedom of all of them, `NAME.x` and so on (k,).
        matrix: minus the change of force by displacement (k, k) [N/m]; [N], [N m] for rotations of bodies.
        warnings: links on the verge of going slack, with a one-sided matrix.
    """

    names: tuple[str, ...]
    freedoms: tuple[str, ...]
    matrix: np.ndarray
    warnings: tuple[str, ...] = ()


def mooring_stiffness(model: Model, pose: State, names: Sequence[str], loads: Array | None = None) -> Stiffness:
    """The stiffness of points, fixed or free, and rigid bodies, by name.

    Args:
        pose: `equilibrium(...).state`.
        loads: additional forces of the equilibrium (free nodes, 3) [N].

    Raises:
        SceneError: unknown point; rigid links, whose tensions do not follow from lengths; unconstrained motions.
    """
    require_stretching_links(model)
    if loads is None:
        loads = jnp.zeros_like(pose.r)
    model = rest(model)
    rows_by_name = _rows_by_name(model, names)
    if model.constraints:
        matrix = _of_bodies(model, pose, loads)
    else:
        matrix = stiffness_with_held(model, pose, loads)
    picked = np.concatenate([np.zeros(0, int), *rows_by_name.values()])
    condensed = _condense(model, pose, loads, matrix, picked)
    freedoms = tuple(f"{name}.{axis}" for name, rows in rows_by_name.items() for axis in FREEDOMS[: len(rows)])
    return Stiffness(tuple(rows_by_name), freedoms, condensed, verges(model, pose))


#: A link with a strain, and a tension over the maximum tension, below this is on the verge of going slack.
VERGE_STRAIN = 1e-9


def verges(model: Model, pose: State) -> tuple[str, ...]:
    """Warnings about links at their unstretched length, which are in tension on one side only."""
    size = np.linalg.norm(np.asarray(model.links(pose.r, model.ends(pose.t))), axis=1)
    strain = size / np.asarray(model.line.length) - 1.0
    tension = np.abs(np.asarray(pose.tension))
    on_verge = (np.abs(strain) <= VERGE_STRAIN) & (tension <= VERGE_STRAIN * max(np.max(tension), 1e-300))
    numbers = [str(i + 1) for i in np.flatnonzero(on_verge)]
    if not numbers:
        return ()
    return (f"links {first_names(numbers, 5)} are on the verge of going slack: derivatives are one-sided",)


def _rows_by_name(model: Model, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Rows of K of each name: of a free or fixed point (3,), or of a body (6,)."""
    moves = moves_of(model)
    bodies = ()
    if isinstance(moves, BodyMoves):
        bodies = moves.constraint.names
    points = names_of(model.points[: len(model.points) - 4 * len(bodies)])  # corners of bodies come last
    check_point_names(names, [*points, *bodies])
    rows: dict[str, np.ndarray] = {}
    for name in names:
        if isinstance(moves, BodyMoves) and name in bodies:
            rows[name] = _rows_of_body(moves, bodies.index(name), name)
        else:
            rows[name] = _rows_of_point(moves, points.index(name))
    return rows


def _rows_of_body(moves: BodyMoves, body: int, name: str) -> np.ndarray:
    """Rows of K (6,) of the body of this number and name."""
    if moves.pinned[body]:
        raise SceneError(
            f"points: {name!r} is pinned and cannot be moved; allowed: free and fixed points, other bodies"
        )
    return moves.first_coordinate(body) + np.arange(6)


def _rows_of_point(moves: Moves, point: int) -> np.ndarray:
    """Rows of K (3,) of the point of this number, which is not on a body."""
    geometry = moves.model.geometry
    held = geometry.held_points.tolist()
    if point in held:
        return moves.size + 3 * held.index(point) + np.arange(3)
    index = np.flatnonzero(moves.retained_nodes == geometry.node_of_point(point))
    if not index.size:
        raise SceneError(f"points: {moves.model.points[point].name!r} is on a rigid body. Use the name of the body")
    return 3 * index[0] + np.arange(3)


def _shifted_residual(model: Model, pose: State, loads: Array, x: Array, u: Array) -> tuple[Array, Array]:
    """Unbalanced forces, minus F, on free nodes (free, 3) and fixed points (held, 3) [N], displaced by x and u [m]."""
    problem = RestProblem(model, pose, loads)
    problem.ends = Ends(problem.ends.positions + u, problem.ends.velocities)
    tension = problem.tension(x)
    force, _ = problem.link_rows(problem.link_vectors(x), tension)
    return problem.residual(Unknowns(x, tension)).x, -model.geometry.held_force(force)


def forces_on_held(model: Model, pose: State) -> np.ndarray:
    """Forces (h, 3) [N] of the lines on the fixed points at rest."""
    free = jnp.zeros_like(pose.r)
    held = jnp.zeros((model.geometry.ends, 3), model.dtype)
    return -np.asarray(_shifted_residual(model, pose, free, free, held)[1])


@cached_jit()
def _of_held(model: Model, pose: State, loads: Array) -> tuple[Array, ...]:
    """Derivatives by displacements of fixed points: rows (3 free, h) and forces on these points (h, h); the latter by
    free nodes (h, 3 free)."""
    x = jnp.zeros_like(pose.r)
    u = jnp.zeros((model.geometry.ends, 3), model.dtype)
    rows, own = jax.jacfwd(lambda u: _shifted_residual(model, pose, loads, x, u))(u)
    back = jax.jacrev(lambda x: _shifted_residual(model, pose, loads, x, u)[1])(x)
    return rows.reshape(x.size, u.size), own.reshape(u.size, u.size), back.reshape(u.size, x.size)


def stiffness_with_held(model: Model, pose: State, loads: Array) -> csc_array:
    """K [N/m] of displacements of the free nodes, then of the fixed points (f + h, f + h). On the host."""
    from scipy.sparse import block_array, csc_array  # noqa: PLC0415

    rows, own, back = (csc_array(np.asarray(part)) for part in _of_held(model, pose, loads))
    return block_array([[stiffness(model, pose, loads), rows], [back, own]], format="csc")


def _condense(model: Model, pose: State, loads: Array, matrix: csc_array, picked: np.ndarray) -> np.ndarray:
    """K of some degrees of freedom, all other free ones in equilibrium, fixed points at rest.

    Raises:
        SceneError: the picked ones load a free motion of the others.
    """
    others = np.setdiff1d(np.arange(matrix.shape[0] - 3 * model.geometry.ends), picked)
    rows = matrix[picked]
    inner = matrix[others]
    whole = rows[:, picked].toarray()
    if not others.size:
        return whole
    right = inner[:, picked].toarray()
    inner = inner[:, others].tocsc()
    # refined, since the others may have a free motion: a slack chain on a seabed without friction moves freely across
    # it, which does not affect its fairlead
    factor = factor_softened(model, inner)
    x = np.zeros_like(right)
    left = right
    for _ in range(REFINEMENTS):
        x = x + factor.solve(left)
        left = right - inner @ x
        if np.max(np.abs(left), initial=0.0) <= UNSOLVABLE * np.max(np.abs(right), initial=0.0):
            return whole - rows[:, others] @ x
    reason = free_motion(model, pose, loads)
    if not reason:
        node = int(others[np.argmax(np.max(np.abs(left), axis=1))]) // 3
        reason = "nothing holds " + ("a body" if model.constraints else name_of(model, node))
    raise SceneError(f"points: the others have no equilibrium: {reason}. Use constrained points")


def _of_bodies(model: Model, pose: State, loads: Array) -> csc_array:
    """K in the coordinates of `statics.body_moves`, with displacement and rotation of bodies about their reference
    points."""
    from scipy.sparse import csc_array  # noqa: PLC0415

    matrix = np.asarray(_by_coordinates(model, pose, loads))
    moves = BodyMoves(model)
    reference = np.asarray(moves.constraint.pose(model, pose.r)[0])
    centre = np.mean(np.asarray(pose.r)[moves.corners], axis=1)
    turn = np.eye(len(matrix))
    for i in np.flatnonzero(~moves.pinned):
        first = moves.first_coordinate(i)
        # the centre moves by w x arm as the body turns about its reference
        turn[first : first + 3, first + 3 : first + 6] = np.cross(centre[i] - reference[i], np.eye(3))
    return csc_array(turn.T @ matrix @ turn)


@cached_jit()
def _by_coordinates(model: Model, pose: State, loads: Array) -> Array:
    """K in the coordinates of `statics.body_moves`, then displacements of the fixed points."""
    moves = BodyMoves(model)
    count = moves.size

    def rows_of(q: Array) -> Array:
        r, back = jax.vjp(partial(moves.positions, pose.r), q[:count])
        free, own = _shifted_residual(model, pose, loads, r - pose.r, q[count:].reshape(-1, 3))
        return jnp.concatenate([back(free)[0], own.ravel()])

    return jax.jacfwd(rows_of)(jnp.zeros(count + 3 * model.geometry.ends, model.dtype))
