"""Statics of a system of lines: damped Newton descent from an approximate guess.

    (K + kappa) dx = F(r),    r <- r + a dx

F contains all forces and the tensions of the links, K is their stiffness (`tangent`). The step length a is the largest
of a geometric series that does not overshoot: `F(r + a dx) . dx` may not turn far negative (the line search of
nonlinear finite elements; it needs no energy, so that a current may act). kappa decreases after full steps and
increases after shortened ones: descent far from equilibrium, Newton near it. Descent ends in a stable equilibrium.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.numerics import safe_norm
from dropper_jax.effects.bending import CRUSHED_LENGTH
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.statics.moves import Moves, moves_of
from dropper_jax.statics.rest_problem import MIN_KAPPA, RestProblem, balanced, force_scale, name_of, soft_scale

#: Maximum number of corrections of a descent.
MAX_CORRECTIONS = 1000
#: Minimum fraction of a correction that is tried.
MIN_SHARE = 2.0**-13
#: Maximum force against a correction at its end, over the force along it at its start.
MAX_OPPOSING = 0.5
#: A shortened correction is good from this fraction on. Factors on kappa after a full, a good and a short correction.
GOOD_SHARE = 0.25
FULL_FACTOR = 0.2
GOOD_FACTOR = 0.7
SHORT_FACTOR = 4.0
#: Minimum kappa after a short correction, over the weight of a link per its length.
SHORT_FLOOR = 1e-2


def correct_pose(moves: Moves, s: State, loads: Array, kappa: Array) -> tuple[State, Array, Array, Array]:
    """One correction of the configuration s: the next one, its maximum unbalanced force [N], that of s, the next
    kappa."""
    soft = soft_scale(moves.model)
    reach = jnp.mean(moves.model.line.length)  # maximum displacement of a node in one correction
    rows_at = partial(moves.rows, s, loads)
    rows, linear = jax.linearize(rows_at, moves.zero_displacement)
    dx = -moves.tangent.factor(linear, kappa, rows)(rows, False)
    farthest_square = jnp.max(jnp.sum(dx.reshape(-1, 3) ** 2, axis=1), initial=0.0)
    # 1e-300: no division by zero if nothing moves
    dx = dx * jnp.minimum(1.0, reach / jnp.sqrt(jnp.maximum(farthest_square, 1e-300)))
    allowed = MAX_OPPOSING * jnp.sum(rows * dx)

    def overshoots(trial: tuple[Array, ...]) -> Array:
        share, along, _ = trial
        return ~(along >= allowed) & (share > MIN_SHARE)

    def shorter(trial: tuple[Array, ...]) -> tuple[Array, ...]:
        share = 0.5 * trial[0]
        after = rows_at(share * dx)
        return share, -jnp.sum(after * dx), jnp.max(jnp.abs(after))

    # the full correction is tried first in the same loop, so that the program contains the rows only once
    never = jnp.full((), -jnp.inf, dx.dtype)
    share, _, size = jax.lax.while_loop(overshoots, shorter, (jnp.full((), 2.0, dx.dtype), never, -never))
    harder = jnp.maximum(SHORT_FACTOR * kappa, SHORT_FLOOR * soft)
    shortened = jnp.where(share >= GOOD_SHARE, GOOD_FACTOR * kappa, harder)
    kappa = jnp.where(share == 1.0, FULL_FACTOR * kappa, shortened)
    s = moves.move_pose(s, loads, share * dx)
    return s, size, jnp.max(jnp.abs(rows), initial=0.0), jnp.maximum(kappa, MIN_KAPPA * soft)


@cached_jit()
def unbalance(model: Model, s: State, loads: Array) -> Array:
    """Maximum scaled unbalanced force of a configuration."""
    moves = moves_of(model)
    return jnp.max(jnp.abs(moves.rows(s, loads, moves.zero_displacement)), initial=0.0) / force_scale(model)


def straight_guess(model: Model, t: float = 0.0) -> State:
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


#: Maximum number of corrections without an improvement over the guess.
HOPELESS_CORRECTIONS = 500
#: Maximum number of descents from one guess.
MAX_DESCENTS = 12
#: A descent is continued if the unbalanced force falls below this fraction of the last.
IMPROVED_SHARE = 0.5


class _Descent(NamedTuple):
    """State of a descent.

    Attributes:
        s: the configuration.
        size: its maximum scaled unbalanced force.
        kappa: of the next correction [N/m].
        in_tolerance: number of successive configurations within the tolerance.
        count: number of corrections.
        guess_size: maximum scaled unbalanced force of the guess.
        best: the configuration with the minimum of these forces.
        best_size: its force.
    """

    s: State
    size: Array
    kappa: Array
    in_tolerance: Array
    count: Array
    guess_size: Array
    best: State
    best_size: Array


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
        hopeless = (now.count > HOPELESS_CORRECTIONS) & ~(now.best_size < now.guess_size)
        unfinished = (now.in_tolerance < 2) & (now.count < rounds)
        return unfinished & (jnp.isfinite(now.size) | (now.count == 0)) & ~hopeless

    def correct(now: _Descent) -> _Descent:
        s, size, before, kappa = correct_pose(moves, now.s, loads, now.kappa)
        size = size / scale
        # the guess is evaluated here, by its first correction, so that the program contains the rows once less
        is_guess = now.count == 0
        guess_size = jnp.where(is_guess, before / scale, now.guess_size)
        last_best_size = jnp.where(is_guess, before / scale, now.best_size)
        is_better = size < last_best_size
        best = jax.tree.map(lambda new, old: jnp.where(is_better, new, old), s, now.best)
        return _Descent(
            s=s,
            size=size,
            kappa=kappa,
            in_tolerance=jnp.where(size <= tolerance, now.in_tolerance + 1, 0),
            count=now.count + 1,
            guess_size=guess_size,
            best=best,
            best_size=jnp.where(is_better, size, last_best_size),
        )

    none = jnp.zeros((), jnp.int32)
    start = _Descent(s, never, jnp.asarray(kappa, s.r.dtype), none, none, never, s, never)
    end = jax.lax.while_loop(needs_correction, correct, start)
    return end.best, end.best_size


def find_rest(model: Model, s: State, loads: Array, tolerance: float) -> tuple[State, float]:
    """The stable equilibrium reached by descent from `s`, and its maximum scaled unbalanced force.

    The descent is continued while `MAX_CORRECTIONS` corrections make the force much smaller: lines that rest on each
    other slide slowly to where they balance.
    """
    residual = np.inf
    for _ in range(MAX_DESCENTS):
        before = residual
        s, left = descend(model, s, loads, tolerance, soft_scale(model, np), MAX_CORRECTIONS)
        residual = float(left)
        if residual <= tolerance or not residual < IMPROVED_SHARE * before:
            break
    return s, residual


def find_softened(model: Model, s: State, loads: Array, tolerance: float) -> tuple[State, float]:
    """Equilibrium by continuation from softer lines: if slack links become taut one after another, stiff links shorten
    every step.

    A weightless line of 200 links in a current is solved in seconds, but not within `MAX_CORRECTIONS` corrections
    without continuation.
    """
    residual = np.inf
    # fractions of the axial stiffness in the continuation to a stiff system
    for share in (1e-5, 1e-3, 1e-1, 1.0):
        s, residual = find_rest(model.with_axial(model.line.axial.soften(share)), s, loads, tolerance)
    return s, residual


#: Stretch of the springs that replace rigid links.
SPRING_STRETCH = 1e-4


def with_springs(model: Model, tension: Array | None = None, pushes: bool = False) -> Model:
    """The model with stiff ropes instead of rigid links.

    Args:
        tension: that under which they stretch by `SPRING_STRETCH`, a scalar [N]; default: the weight of all links.
        pushes: whether they are springs that also push.
    """
    if tension is None:
        tension = force_scale(model) * model.line.links
    stiffness = jnp.broadcast_to(tension / SPRING_STRETCH, model.line.length.shape)
    return model.with_axial(model.line.axial.springs(stiffness, pushes))


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
    if shortest >= CRUSHED_LENGTH:
        return ""
    return f". A link is compressed to {shortest:.1%} of its length: use axial law 'elastic' with bending"
