"""Statics of a system of lines: damped Newton descent from an approximate guess, and the path away from unstable poses.

    (K + kappa) dx = F(r),    r <- r + a dx

F contains all forces and the tensions of the links, K is their stiffness (`tangent`). The step length a is the largest
of a geometric series that does not overshoot: `F(r + a dx) . dx` may not turn far negative (the line search of
nonlinear finite elements; it needs no energy, so that a current may act). kappa decreases after full steps and
increases after shortened ones: descent far from equilibrium, Newton near it. Descent ends in a stable equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial import AxialLaw
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.bending import CRUSHED
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.solvers.dense import residual_matrix
from dropper_jax.statics.bodies import BodyMoves, moves_of, stiffness_matrix
from dropper_jax.statics.rest_problem import SMALLEST, RestProblem, balanced, force_scale, name_of, soft_scale
from dropper_jax.statics.tangent import NodeMoves


@cached_jit()
def stiffness_and_motions(model: Model, s: State) -> tuple[Array, Array]:
    """K (k, k) [N/m] of the motions (3 free, k) of lines that stretch and of rigid bodies, and these motions."""
    moves = moves_of(model)
    loads = jnp.zeros_like(s.r)
    motions = jax.jacfwd(lambda x: moves.move_pose(s, loads, x).r)(moves.none)
    return moves.tangent.dense(stiffness_matrix(moves, s, loads)), motions.reshape(s.r.size, -1)


def stiffness_of_motions(model: Model, s: State) -> tuple[np.ndarray, np.ndarray]:
    """The stiffness on the host, also with rigid links: that of motions which keep their lengths.

    Of rows `f(x, T)` and lengths `y(x, T)`: T of a link that stretches follows from x, the others' y must not change.
    """
    from scipy.linalg import null_space  # noqa: PLC0415

    if model.line.axial.elastic:
        return tuple(map(np.asarray, stiffness_and_motions(model, s)))
    matrix = np.asarray(_rows_by_unknowns(model, s))
    size = s.r.size
    soft = np.diag(matrix)[size:] != 0.0
    force = matrix[:size, size:][:, soft]
    lengths = matrix[size:, :size]
    compliance = np.diag(matrix)[size:][soft, None]
    motions = null_space(lengths[~soft])
    return motions.T @ (matrix[:size, :size] - force @ (lengths[soft] / compliance)) @ motions, motions


@cached_jit()
def _rows_by_unknowns(model: Model, s: State) -> Array:
    problem = RestProblem(model, s, jnp.zeros_like(s.r))
    return residual_matrix(problem, Unknowns(jnp.zeros_like(s.r), s.tension))


#: The check is too slow for more free nodes than this.
MOST_CHECKED = 200


def stable(model: Model, s: State) -> bool:
    """Whether no displacement that keeps the lengths of rigid links reduces the energy to second order.

    Smallest eigenvalue of the stiffness on the null space of the constraints (minimum real part if drag makes it
    unsymmetric: every slow motion returns), relative to the mean weight of a link per length. A line with all links in
    tension under dead loads is stable. Systems of more than 200 nodes are not checked.
    """
    if model.constant_force and np.all(np.asarray(s.tension) > 0.0) or model.free_nodes > MOST_CHECKED:
        return True
    return softest(model, s)[0] > -_rounding(model)


def holds(model: Model, s: State) -> bool:
    """Whether an equilibrium is stable, or lies in one plane under dead loads and is stable against motions in it.

    A link in compression may tip out of the plane. A dropper lifted within its plane has no force that tips it: its
    motion after the release stays in the plane.
    """
    if stable(model, s):
        return True
    normal = None
    if model.constant_force:
        normal = plane_normal(model, s)
    return normal is not None and softest(model, s, normal)[0] > -_rounding(model)


def _rounding(model: Model) -> float:
    """Rounding error of a stiffness [N/m]: this fraction of the weight of a link per its length."""
    return 1e-6 * float(soft_scale(model, np))


def plane_normal(model: Model, s: State) -> np.ndarray | None:
    """Unit normal of the one plane that contains all links; None without such a plane."""
    _, size, directions = np.linalg.svd(model.links(s.r, model.ends(s.t)), full_matrices=False)
    # distance of the links from a plane, or a line, relative to their length
    if len(size) > 2 and size[2] < 1e-9 * size[0] < 1e-3 * size[1]:
        return directions[2]
    return None


#: Difference of a stiffness from its transpose, over its maximum entry, above which it has no energy.
UNSYMMETRIC = 1e-8


def softest(model: Model, s: State, normal: np.ndarray | None = None) -> tuple[float, np.ndarray]:
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
    least = np.argmin(values.real)
    motion = (motions @ vectors[:, least].real).reshape(s.r.shape)
    return float(values[least].real), motion / np.max(np.abs(motion))


#: The first displacement from an unstable equilibrium, in lengths of a link.
NUDGE = 0.1


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


#: Maximum number of iterations.
ROUNDS = 1000


#: Minimum fraction of a correction that is tried.
LEAST_SHARE = 2.0**-13


def correct_pose(
    moves: NodeMoves | BodyMoves, s: State, loads: Array, kappa: Array
) -> tuple[State, Array, Array, Array]:
    """One correction of the configuration s: the next one, its maximum unbalanced force [N], that of s, the next
    kappa."""
    # maximum displacement of a node in one iteration, in mean link lengths
    soft = soft_scale(moves.model)
    reach = jnp.mean(moves.model.line.length)
    rows_at = partial(moves.rows, s, loads)
    rows, linear = jax.linearize(rows_at, moves.none)
    dx = -moves.tangent.factor(linear, kappa, rows)(rows, False)
    farthest = jnp.max(jnp.sum(dx.reshape(-1, 3) ** 2, axis=1), initial=0.0)
    dx = dx * jnp.minimum(1.0, reach / jnp.sqrt(jnp.maximum(farthest, 1e-300)))
    # maximum opposing force along a correction, relative to its initial value
    allowed = 0.5 * jnp.sum(rows * dx)

    def overshoots(trial: tuple[Array, ...]) -> Array:
        share, along, _ = trial
        return ~(along >= allowed) & (share > LEAST_SHARE)

    def shorter(trial: tuple[Array, ...]) -> tuple[Array, ...]:
        share = 0.5 * trial[0]
        after = rows_at(share * dx)
        return share, -jnp.sum(after * dx), jnp.max(jnp.abs(after))

    # the full correction is tried first in the same loop, so that the program contains the rows only once
    never = jnp.full((), -jnp.inf, dx.dtype)
    share, _, size = jax.lax.while_loop(overshoots, shorter, (jnp.full((), 2.0, dx.dtype), never, -never))
    harder = jnp.maximum(4.0 * kappa, 1e-2 * soft)
    # factors on kappa after a full, a good and a short step, and its minimum after a short one over the weight of a
    # link per its length
    kappa = jnp.where(share == 1.0, 0.2 * kappa, jnp.where(share >= 0.25, 0.7 * kappa, harder))
    s = moves.move_pose(s, loads, share * dx)
    return s, size, jnp.max(jnp.abs(rows), initial=0.0), jnp.maximum(kappa, SMALLEST * soft)


@cached_jit()
def unbalance(model: Model, s: State, loads: Array) -> Array:
    """Maximum scaled unbalanced force of a configuration."""
    moves = moves_of(model)
    return jnp.max(jnp.abs(moves.rows(s, loads, moves.none)), initial=0.0) / force_scale(model)


def guess(model: Model, t: float = 0.0) -> State:
    """Every line straight between its points at their positions in the scene."""
    geometry = model.geometry
    nodes = np.zeros((geometry.free + geometry.ends, 3))
    nodes[geometry.point_node] = [p.position for p in model.points]
    nodes[geometry.free :] = model.ends(jnp.asarray(t, model.dtype)).positions
    for path, span in zip(geometry.paths, geometry.spans, strict=True):
        length = np.asarray(model.line.length[span], float)
        along = np.cumsum(length)[:-1, None] / np.sum(length)
        start = nodes[path[0]]
        line = start + along * (nodes[path[-1]] - start)
        if np.array_equal(start, nodes[path[-1]]):  # a loop hangs below its point
            line[:, 2:] -= 0.5 * np.sum(length) * np.sin(np.pi * along)
        nodes[path[1:-1]] = line
    return state(model, nodes[: geometry.free], t=t)


#: Maximum number of iterations without an improvement over the guess.
HOPELESS = 500
#: How often a descent is continued, and the fraction of the unbalanced force that it must leave at most for that.
CONTINUED = 12
IMPROVED = 0.5


class _Descent(NamedTuple):
    """A configuration and its scaled unbalanced force, the next kappa, how many successive ones were within the
    tolerance, the number of corrections, the force of the guess, and the best configuration with its force."""

    s: State
    size: Array
    kappa: Array
    reached: Array
    count: Array
    first: Array
    best: State
    least: Array


@cached_jit(static=("rounds",))
def descend(
    model: Model, s: State, loads: Array, tolerance: Array | float, kappa: Array, rounds: int
) -> tuple[State, Array]:
    """Result of the descent from `s`: the best configuration and its maximum scaled unbalanced force.

    It stops after two successive configurations within the tolerance: the last correction then reaches rounding.
    """
    moves = moves_of(model)
    scale = force_scale(model)
    s = balanced(model, s, loads)
    never = jnp.full((), jnp.inf, model.dtype)

    def needs_correction(now: _Descent) -> Array:
        hopeless = (now.count > HOPELESS) & ~(now.least < now.first)
        unfinished = (now.reached < 2) & (now.count < rounds)
        return unfinished & (jnp.isfinite(now.size) | (now.count == 0)) & ~hopeless

    def correct(now: _Descent) -> _Descent:
        s, _, kappa, reached, count, first, best, least = now
        s, size, before, kappa = correct_pose(moves, s, loads, kappa)
        size = size / scale
        # the guess is evaluated here, by its first correction, so that the program contains the rows once less
        first = jnp.where(count == 0, before / scale, first)
        least = jnp.where(count == 0, before / scale, least)
        best, least = jax.tree.map(lambda new, old: jnp.where(size < least, new, old), (s, size), (best, least))
        return _Descent(s, size, kappa, jnp.where(size <= tolerance, reached + 1, 0), count + 1, first, best, least)

    none = jnp.zeros((), jnp.int32)
    start = _Descent(s, never, jnp.asarray(kappa, s.r.dtype), none, none, never, s, never)
    end = jax.lax.while_loop(needs_correction, correct, start)
    return end.best, end.least


def find_rest(model: Model, s: State, loads: Array, tolerance: float) -> tuple[State, float]:
    """The stable equilibrium reached by descent from `s`, and its maximum scaled unbalanced force.

    The descent is continued while `ROUNDS` iterations make the force much smaller: lines that rest on each other slide
    slowly to where they balance.
    """
    residual = np.inf
    for _ in range(CONTINUED):
        before = residual
        s, left = descend(model, s, loads, tolerance, soft_scale(model, np), ROUNDS)
        residual = float(left)
        if residual <= tolerance or not residual < IMPROVED * before:
            break
    return s, residual


def find_softened(model: Model, s: State, loads: Array, tolerance: float) -> tuple[State, float]:
    """Equilibrium by continuation from softer lines: if slack links become taut one after another, stiff links shorten
    every step.

    A weightless line of 200 links in a current is solved in seconds, but not within `ROUNDS` iterations without
    continuation.
    """
    residual = np.inf
    # fractions of the axial stiffness in the continuation to a stiff system
    for share in (1e-5, 1e-3, 1e-1, 1.0):
        s, residual = find_rest(with_axial(model, model.line.axial.soften(share)), s, loads, tolerance)
    return s, residual


def with_axial(model: Model, axial: AxialLaw) -> Model:
    """The model with another axial law."""
    return replace(model, lines=(replace(model.line, axial=axial),))


#: Stretch of the springs that replace rigid links.
SPRING_STRETCH = 1e-4


def springy(model: Model, pushes: bool = False) -> Model:
    """The model with stiff ropes, or springs that also push, instead of rigid links; they stretch by about 0.01 %."""
    weight = force_scale(model) * model.line.links / SPRING_STRETCH
    return with_axial(model, model.line.axial.springs(jnp.broadcast_to(weight, model.line.length.shape), pushes))


def describe_unbalance(model: Model, s: State, loads: Array, residual: float, extent: str) -> str:
    """The node with the maximum unbalanced force after a failed search; `extent` describes the extent of the search."""
    if model.constraints:
        return f"no equilibrium of lines and bodies found: maximum scaled unbalanced force {residual:.1e}"
    rows = np.asarray(RestProblem(model, s, loads).residual(Unknowns(jnp.zeros_like(s.r), s.tension)).x)
    size = np.max(np.abs(rows), axis=1)
    node = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
    force = ", ".join(f"{x:.3g}" for x in rows[node])
    position = ", ".join(f"{x:.4g}" for x in np.asarray(s.r[node]))
    return (
        f"no equilibrium found {extent}: maximum scaled unbalanced force {residual:.1e}, "
        f"{name_of(model, node)} at ({position}) m has ({force}) N{_advise_elastic(model, s)}"
    )


def _advise_elastic(model: Model, s: State) -> str:
    """What to do about links that collapse because lines with bending stiffness have none in compression; or empty."""
    if model.effect("bending") is None:
        return ""
    shortest = float(jnp.min(safe_norm(model.links(s.r, model.ends(s.t))) / model.line.length))
    if shortest >= CRUSHED:
        return ""
    return f". A link is compressed to {shortest:.1%} of its length: use axial law 'elastic' with bending"
