"""Stochastic linearisation of drag: the force of normally distributed velocities as a linear damping D of each node.

    D = -E[R(v) z'] L^-1,    v = L z ~ N(0, S),    S = E[v v']

R(v) is what the force on nodes with velocity v relative to the waves, in the mean current, has beyond its linear part
at rest. By Stein's lemma D is the mean derivative of -R; `sqrt(8/pi) b sigma` for `b |v| v`. S follows from the motion,
so D is found by iteration. The mean force changes by E[R].

Source: Krolikowski and Gay (1980), for drag in irregular waves and a current.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import permutations, product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Model, State
from dropper_jax.model.slots import Prepared


def _normal_points() -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) and weights (k,) of means over a standard normal vector: two radii, exact for powers up to 3, and
    directions symmetric in every coordinate, whose mean of |cos| is right within 3 %."""
    # the vector whose permutations and signs have the most even |cos|
    even = (0.878084, 0.235282, 0.416667)
    directions = np.array([np.multiply(p, s) for p in permutations(even) for s in product((1, -1), repeat=3)])
    mean = 2.0 * np.sqrt(2.0 / np.pi)
    far, near = np.roots([1.0, -mean / (3.0 - mean**2), mean**2 / (3.0 - mean**2) - 3.0])
    share = (mean - near) / (far - near)
    weights = np.repeat([share, 1.0 - share], len(directions)) / len(directions)
    return np.concatenate([far * directions, near * directions]), weights


def dragging_effects(still: Model) -> tuple[Model, Model]:
    """The model with the effects of the water, without contact, and with those that do not know the waves."""
    wet = []
    other = []
    for effect in still.without_slot(Seabed).effects:
        if effect.needs_water or isinstance(effect, Prepared):
            wet.append(effect)
        else:
            other.append(effect)
    return replace(still, effects=tuple(wet)), replace(still, effects=tuple(other))


def linear_drag(dragging: tuple[Model, Model], pose: State, v: Array, flow: Array) -> tuple[Array, Array]:
    """D (2, free, 3, 3) of the water and of the other effects, and the change of the mean force (free, 3), for complex
    velocities (c, free, 3)."""
    points, weights = map(jnp.asarray, _normal_points())

    def drag_of(model: Model, velocity: Array) -> tuple[Array, Array]:
        ends = model.ends(pose.t)
        covariance = 0.5 * jnp.einsum("cni,cnj->nij", velocity, velocity.conj()).real
        # the root of a covariance of plane motion needs a small one in the third direction
        size = jnp.trace(covariance, axis1=1, axis2=2)[:, None, None]
        root = jnp.linalg.cholesky(covariance + (1e-9 * size + 1e-12) * jnp.eye(3))

        def force(x: Array) -> Array:
            return model.force(model.instant(pose.r, x, pose.t, ends))

        at_rest, linear = jax.linearize(force, jnp.zeros_like(pose.r))

        def beyond(z: Array) -> Array:
            x = root @ z
            return force(x) - at_rest - linear(x)

        found = jax.vmap(beyond)(points)
        moment = jnp.einsum("kni,kj->nji", found, weights[:, None] * points)
        drag = -jnp.swapaxes(solve_triangular(jnp.swapaxes(root, 1, 2), moment), 1, 2)
        return drag, jnp.tensordot(weights, found, 1)

    wet, dry = dragging
    water, shift = drag_of(wet, v - flow)
    other, more = drag_of(dry, v)
    return jnp.stack([water, other]), shift + more


#: Iterations after which D counts as not converged.
MAX_ITERATIONS = 60


class _DragIteration(NamedTuple):
    """D, the change of the mean force, the last relative change of D, the number of iterations, the share of the last
    correction that was applied, and the residual `g(D) - D` that it was applied to."""

    drag: Array
    shift: Array
    change: Array
    count: Array
    share: Array
    residual: Array


def iterate_drag(
    drag_of: Callable[[Array, Array], tuple[Array, Array]], start: Array, tolerance: float
) -> tuple[Array, Array, Array]:
    """D with `drag_of(D, number of the iteration) = D`, the change of the mean force, and the last relative change
    of D."""

    def keep_iterating(at: _DragIteration) -> Array:
        return (at.change > tolerance) & (at.count < MAX_ITERATIONS)

    def correct(at: _DragIteration) -> _DragIteration:
        after, shift = drag_of(at.drag, at.count)
        residual = after - at.drag
        # Aitken's share of the correction: the root of the secant through this residual and the one before
        turn = residual - at.residual
        slope = jnp.sum(at.residual * turn) / jnp.maximum(jnp.sum(turn**2), 1e-300)
        secant = jnp.clip(-at.share * slope, 0.1, 1.0)
        share = jnp.where(at.count > 1, secant, jnp.where(at.count > 0, 0.5, 1.0))
        change = jnp.linalg.norm(residual) / jnp.maximum(jnp.linalg.norm(after), 1e-300)
        return _DragIteration(at.drag + share * residual, shift, change, at.count + 1, share, residual)

    at_rest = jnp.zeros(start.shape[1:3])
    begin = _DragIteration(start, at_rest, jnp.inf, 0, jnp.ones(()), jnp.zeros_like(start))
    end = jax.lax.while_loop(keep_iterating, correct, begin)
    return end.drag, end.shift, end.change


def no_drag(pose: State) -> Array:
    """D = 0."""
    return jnp.zeros((2, *pose.r.shape, 3))
