"""The tangent stiffness of a pose at rest: its blocks, and linear solves with it that stay in a compiled program.

    K = -dF/dr,    K dr = dF        (F: all static forces on free nodes, tensions of the links as they lie included)

Exact: drag that turns with the links, contact and wetted shares stand in it. Its blocks come from a handful of
directional derivatives (nodes that no row has in common share one) and are eliminated in rounds (`solvers.elimination`)
in O(n). Where a node may move freely K is singular: what is eliminated is `K + kappa`, and the solution is refined with
K itself. That gives the shortest solution where there is one, and NaN where there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.model import Geometry, Model, State
from dropper_jax.residual import Unknowns
from dropper_jax.solvers.elimination import Elimination, eliminate, solve
from dropper_jax.solvers.order import Order, elimination_order
from dropper_jax.statics.calm import rest
from dropper_jax.statics.relaxation import Pattern, pattern, stiffness
from dropper_jax.statics.rest_problem import SMALLEST, RestProblem, force_scale
from dropper_jax.statics.system import name_of

Linear = Callable[[jax.Array], jax.Array]

#: Most corrections of a linear solve, and the share of the right side that may be left: else there is no solution.
REFINEMENTS, LEFT = 20, 1e-7
#: Stiffness, over the weight of a link per its length, below which a motion counts as free.
FREE = 1e-7
#: Inverse iterations that find the softest motion; they need not find the softest of several soft ones.
INVERSE_ITERATIONS = 12


@lru_cache(maxsize=64)
def _order(geometry: Geometry, reach: int) -> Order:
    near = pattern(geometry, reach)
    return elimination_order(geometry.free, list(zip(near.row.tolist(), near.column.tolist(), strict=True)))


@dataclass(frozen=True)
class Tangent:
    """How blocks of a model's K stand and are eliminated."""

    pattern: Pattern
    order: Order
    kappa: jax.Array

    @classmethod
    def of(cls, model: Model) -> Tangent:
        reach = max(model.reach, 1)
        kappa = SMALLEST * soft_scale(model)
        return cls(pattern(model.geometry, reach), _order(model.geometry, reach), jax.lax.stop_gradient(kappa))

    def blocks(self, linear: Linear, dtype: jnp.dtype) -> jax.Array:
        """Blocks (entries, 3, 3) [N/m] of a linear map of moves (free, 3) to forces, in the order of the pattern."""
        row, column, colour, colours = self.pattern
        picked = jnp.asarray(colour == np.arange(colours)[:, None], dtype)
        axes = jnp.eye(3, dtype=dtype)
        seeds = picked[:, None, :, None] * axes[None, :, None, :]
        answer = jax.vmap(jax.vmap(linear))(seeds)  # (colours, axes, free, 3)
        return jnp.swapaxes(answer[colour[column], :, row, :], -1, -2)

    def factor(self, linear: Linear, kappa: jax.Array, dtype: jnp.dtype) -> Elimination:
        """The factored map, stiffer by kappa [N/m]."""
        own = jnp.asarray(self.pattern.row == self.pattern.column, dtype)
        blocks = self.blocks(linear, dtype)
        return eliminate(self.order, blocks + kappa * own[:, None, None] * jnp.eye(3, dtype=dtype))

    def solve(self, linear: Linear, right: jax.Array) -> jax.Array:
        """dr (free, 3) [m] with `linear(dr) = right` [N]; differentiable in both modes; NaN where there is none."""
        factor = self.factor(linear, self.kappa, right.dtype)

        def forward(matrix: Linear, b: jax.Array) -> jax.Array:
            return refined(matrix, lambda rows: solve(factor, rows), b)

        def backward(matrix: Linear, b: jax.Array) -> jax.Array:
            turned = factor.transposed()
            return refined(matrix, lambda rows: solve(turned, rows), b)

        return jax.lax.custom_linear_solve(linear, right, forward, backward)


def refined(matrix: Linear, apply: Linear, b: jax.Array) -> jax.Array:
    """x of `matrix(x) = b` by `x <- x + apply(b - matrix(x))`, until that changes nothing any more."""
    enough = 1e2 * jnp.finfo(b.dtype).eps

    def unfinished(carry: tuple[jax.Array, ...]) -> jax.Array:
        x, _, change, before, count = carry
        falling = (change < 0.5 * before) | (count < 2)
        return (change > enough * jnp.max(jnp.abs(x))) & falling & (count < REFINEMENTS)

    def correct(carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        x, left, change, _, count = carry
        dx = apply(left)
        x = x + dx
        return x, b - matrix(x), jnp.max(jnp.abs(dx)), change, count + 1

    never = jnp.full((), jnp.inf, b.dtype)
    x, left, *_ = jax.lax.while_loop(unfinished, correct, (jnp.zeros_like(b), b, never, never, jnp.zeros((), int)))
    return jnp.where(jnp.max(jnp.abs(left)) <= LEFT * jnp.max(jnp.abs(b)), x, jnp.nan)


def soft_scale(model: Model) -> jax.Array:
    """What stiffnesses are measured against, a scalar [N/m]: the mean weight of a link per its length."""
    return force_scale(model) / jnp.mean(model.line.length)


def unbalanced_rows(model: Model, s: State, loads: jax.Array, x: jax.Array) -> jax.Array:
    """Unbalanced forces, minus F (free, 3) [N], at places s.r + x; tensions follow from the links' lengths."""
    problem = RestProblem(model, s, loads)
    return problem.residual(Unknowns(x, problem.tension(x))).x


def softest_motion(model: Model, s: State, loads: jax.Array) -> tuple[float, np.ndarray]:
    """The least stiffness [N/m] of a pose, and the motion (free, 3), largest 1, that meets it. On the host.

    Raises nothing: a pose with a free motion has stiffness 0 to rounding.
    """
    from scipy.sparse import eye_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    kappa = SMALLEST * float(soft_scale(model))
    matrix = stiffness(model, s, loads)
    factor = splu((matrix + kappa * eye_array(matrix.shape[0])).tocsc())
    x = np.random.default_rng(0).normal(size=matrix.shape[0])
    for _ in range(INVERSE_ITERATIONS):
        x = factor.solve(x / np.linalg.norm(x))
    x /= np.linalg.norm(x)
    way = x.reshape(-1, 3)
    return float(np.linalg.norm(matrix @ x)), way / np.max(np.abs(way))


def free_motion(model: Model, s: State, loads: jax.Array) -> str:
    """Which node moves freely about a pose, in words; empty where all are held, and for links that do not stretch."""
    model = rest(model)
    if model.ties or not model.line.axial.elastic:
        return ""
    least, way = softest_motion(model, s, loads)
    if least > FREE * float(soft_scale(model)):
        return ""
    node = int(np.argmax(np.max(np.abs(way), axis=1)))
    along = ", ".join(f"{x:.2f}" for x in way[node])
    return f"nothing holds {name_of(model, node)} along ({along}), where its stiffness is {least:.1e} N/m"
