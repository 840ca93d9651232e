"""Statics of a system of lines: damped Newton descent from a rough guess to the stable pose.

    (K + kappa) dx = F(r),    r <- r + a dx

F holds all forces and the tensions of the links as they lie, K their stiffness (`tangent`). The share a is the largest
of a geometric series that does not overshoot: `F(r + a dx) . dx` may not turn far negative (the line search of
nonlinear finite elements; it needs no energy, so that a current may act). kappa falls while whole steps are taken and
rises when they are cut: descent far from rest, Newton near it. Descent ends in stable poses.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.axial import AxialLaw
from dropper_jax.base.programs import cached_jit
from dropper_jax.model import Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.statics.bodies import BodyMoves, moves_of
from dropper_jax.statics.rest_problem import SMALLEST, RestProblem, balanced, force_scale, name_of, soft_scale
from dropper_jax.statics.tangent import NodeMoves

#: Rounds until a pose counts as not found.
ROUNDS = 1000
#: Rounds that may pass without a pose better than the guess.
HOPELESS = 500
#: Largest move of a node in one round, in mean link lengths.
REACH = 1.0
#: Least share of a correction that is tried.
LEAST_SHARE = 2.0**-13
#: Kappa, over the weight of a link per its length, from which it rises where a correction was cut short.
FIRST = 1e-2
#: How far the force along a correction may turn against it, over its value at the start.
OVERSHOOT = 0.5
#: Shares of the axial stiffness that poses are found with on the way to a stiff one.
SOFTENING = (1e-5, 1e-3, 1e-1, 1.0)
#: Stretch of the springs that stand for rigid links.
GIVE = 1e-4
#: Factors on kappa after a whole, a good and a short step.
FALL, KEEP, RISE = 0.2, 0.7, 4.0


def correct_pose(
    moves: NodeMoves | BodyMoves, s: State, loads: jax.Array, kappa: jax.Array
) -> tuple[State, jax.Array, jax.Array]:
    """One correction of the pose s: the next pose, the largest force [N] that is left there, and the next kappa."""
    soft, reach = soft_scale(moves.model), REACH * jnp.mean(moves.model.line.length)
    rows_at = partial(moves.rows, s, loads)
    rows, linear = jax.linearize(rows_at, moves.none)
    dx = -moves.tangent.apply(moves.tangent.factor(linear, kappa, rows), rows)
    farthest = jnp.max(jnp.sum(dx.reshape(-1, 3) ** 2, axis=1), initial=0.0)
    dx = dx * jnp.minimum(1.0, reach / jnp.sqrt(jnp.maximum(farthest, 1e-300)))
    allowed = OVERSHOOT * jnp.sum(rows * dx)

    def overshoots(trial: tuple[jax.Array, ...]) -> jax.Array:
        share, along, _ = trial
        return ~(along >= allowed) & (share > LEAST_SHARE)

    def shorter(trial: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        share = 0.5 * trial[0]
        after = rows_at(share * dx)
        return share, -jnp.sum(after * dx), jnp.max(jnp.abs(after))

    # the whole correction is the first that is tried: the rows stand in the program once
    never = jnp.full((), -jnp.inf, dx.dtype)
    share, _, size = jax.lax.while_loop(overshoots, shorter, (jnp.full((), 2.0, dx.dtype), never, -never))
    harder = jnp.maximum(RISE * kappa, FIRST * soft)
    kappa = jnp.where(share == 1.0, FALL * kappa, jnp.where(share >= 0.25, KEEP * kappa, harder))
    return moves.move_pose(s, loads, share * dx), size, jnp.maximum(kappa, SMALLEST * soft)


@cached_jit(brief=True)
def unbalance(model: Model, s: State, loads: jax.Array) -> jax.Array:
    """Largest scaled unbalanced force of a pose."""
    moves = moves_of(model)
    return jnp.max(jnp.abs(moves.rows(s, loads, moves.none)), initial=0.0) / force_scale(model)


def guess(model: Model, t: float = 0.0) -> State:
    """Every line straight between its points, where the scene puts these."""
    geometry = model.geometry
    positions = np.array([np.asarray(p.position, float) for p in model.points])
    moved = np.asarray(model.ends(jnp.asarray(t, model.dtype)).positions, float)
    positions[geometry.held_points] = moved
    r = np.zeros((geometry.free, 3))
    if model.constraints:  # corners of bodies are on no line
        r[geometry.point_node[geometry.free_points]] = positions[geometry.free_points]
    length = np.asarray(model.line.length, float)
    for member, path, span in zip(geometry.members, geometry.paths, geometry.spans, strict=True):
        along = np.concatenate([[0.0], np.cumsum(length[span])]) / np.sum(length[span])
        line = positions[member.start] + along[:, None] * (positions[member.end] - positions[member.start])
        if np.array_equal(positions[member.start], positions[member.end]):  # a loop hangs below its point
            line[:, 2] -= 0.5 * np.sum(length[span]) * np.sin(np.pi * along)
        inner = (path >= 0) & (path < geometry.free)
        r[path[inner]] = line[inner]
    return state(model, jnp.asarray(r), t=t)


@cached_jit(static=("rounds",), brief=True)
def descend(
    model: Model, s: State, loads: jax.Array, tolerance: jax.Array, kappa: jax.Array, rounds: int
) -> tuple[State, jax.Array]:
    """The pose that descent from `s` reaches, and its largest scaled unbalanced force: of the best pose on the way.

    It ends with the second pose in a row within the tolerance: the last correction ends at rounding.
    """
    moves, scale = moves_of(model), force_scale(model)
    s = balanced(model, s, loads)
    first = jnp.max(jnp.abs(moves.rows(s, loads, moves.none)), initial=0.0) / scale

    def unfinished(carry: tuple[Any, ...]) -> jax.Array:
        _, size, _, reached, count, (_, least) = carry
        hopeless = (count > HOPELESS) & ~(least < first)
        return (reached < 2) & (count < rounds) & (jnp.isfinite(size) | (count == 0)) & ~hopeless

    def correct(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        s, _, kappa, reached, count, best = carry
        s, size, kappa = correct_pose(moves, s, loads, kappa)
        size = size / scale
        best = jax.tree.map(lambda new, old: jnp.where(size < best[1], new, old), (s, size), best)
        return s, size, kappa, jnp.where(size <= tolerance, reached + 1, 0), count + 1, best

    none = jnp.zeros((), jnp.int32)
    start = s, first, jnp.asarray(kappa, s.r.dtype), none, none, (s, first)
    return jax.lax.while_loop(unfinished, correct, start)[-1]


def find_rest(model: Model, s: State, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """The stable pose that descent from `s` reaches, and its largest scaled unbalanced force."""
    found, residual = descend(model, s, loads, tolerance, soft_scale(model), ROUNDS)
    return found, float(residual)


def find_softened(model: Model, s: State, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """The pose by way of softer lines: where slack links tauten one after another, stiff ones cut every step short.

    A weightless line of 200 links in a current is found in seconds this way, and not in `ROUNDS` rounds without.
    """
    residual = np.inf
    for share in SOFTENING:
        s, residual = find_rest(with_axial(model, model.line.axial.soften(share)), s, loads, tolerance)
    return s, residual


def with_axial(model: Model, axial: AxialLaw) -> Model:
    """The model with another law of its links."""
    return replace(model, lines=(replace(model.line, axial=axial),))


def springy(model: Model) -> Model:
    """The model with stiff springs in place of rigid links: they stretch by about `GIVE` of their length."""
    weight = force_scale(model) * model.line.links / GIVE
    return with_axial(model, model.line.axial.springs(jnp.broadcast_to(weight, model.line.length.shape)))


def describe_unbalance(model: Model, s: State, loads: jax.Array, residual: float, sought: str) -> str:
    """Which node is farthest from balance in a pose that was not found, and why; `sought` tells how far."""
    if model.constraints:
        return f"no equilibrium of lines and bodies found: largest scaled unbalanced force {residual:.1e}"
    rows = np.asarray(RestProblem(model, s, loads).residual(Unknowns(jnp.zeros_like(s.r), s.tension)).x)
    size = np.max(np.abs(rows), axis=1)
    node = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
    force = ", ".join(f"{x:.3g}" for x in rows[node])
    position = ", ".join(f"{x:.4g}" for x in np.asarray(s.r[node]))
    return (
        f"no equilibrium found {sought}: largest scaled unbalanced force {residual:.1e}, "
        f"{name_of(model, node)} at ({position}) m is left with ({force}) N"
    )
