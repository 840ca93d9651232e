"""Nodes are eliminated first, one by one, which leaves a tridiagonal system for the tensions. Linear cost.

    K dx + D' G dy = r_x,    g . D dx + c dy = r_y    ->    (g D K^-1 D' G - c) dy = g D K^-1 r_x - r_y

K is local to the nodes (nodes, 3, 3), G the force of a unit tension, g and c are the derivatives of the axial law by
the link and by its tension, D takes differences over links. Of the stiffness against turning of its links a node keeps
a fraction (`TURNING_SHARE`), and nothing of that towards its neighbours. Newton therefore converges linearly to the
same solution, by a factor of about 0.1 per correction at h omega = 0.6.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.numerics import (
    Components,
    components,
    dot_components,
    each,
    inverse_rows,
    local_jacobian,
    store_once,
)
from dropper_jax.model import Graph, Model
from dropper_jax.residual import Implicit, Solver, StepProblem, Unknowns
from dropper_jax.solvers.links import LinkParts

#: Inverses of the node blocks: (nodes,), or three rows of three components (nodes,).
Inverse = Array | tuple[Components, Components, Components]
#: Fraction of the stiffness against turning of its links that a node keeps. Measured on the lab dropper at 0.01 s: rows
#: fall fastest between 0.4 and 0.6 (for smooth motions the neighbours' part cancels about half of it).
TURNING_SHARE = 0.5


class ConstraintMatrix(NamedTuple):
    """Rows (n,) of `g D K^-1 G'` of one line, tridiagonal: node i couples link i before it and link i + 1 after it."""

    lower: Array
    diagonal: Array
    upper: Array

    @classmethod
    def of(cls, inverse: Inverse, force: Components, gradient: Components) -> ConstraintMatrix:
        """From K^-1 of the free nodes; of each link the force G of a unit tension and the gradient g of its row."""
        links = len(force[0])
        free = len(jax.tree.leaves(inverse)[0])
        own = _times(inverse, _part(force, slice(free)))
        joined = slice(links - 1)  # nodes with a link after them: all of them between two fixed ends
        after = slice(1, None)
        following = _times(jax.tree.map(operator.itemgetter(joined), inverse), _part(force, after))
        zero = jnp.zeros_like(force[0][:1])
        far = dot_components(_part(gradient, slice(free)), own)
        if free < links:
            far = jnp.concatenate([far, zero])
        near = jnp.concatenate([zero, dot_components(_part(gradient, after), following)])
        upper = -dot_components(_part(gradient, joined), following)
        lower = -dot_components(_part(gradient, after), _part(own, joined))
        return cls(jnp.concatenate([zero, lower]), far + near, jnp.concatenate([upper, zero]))


def solve_multipliers(unit: Array, inverse: Array, rhs: Array) -> Array:
    """y of `(G M^-1 G') y = rhs`, the rows of G the vectors `unit` (n, 3); `inverse` are 1/m of the free nodes."""
    return solve_tridiagonal(*ConstraintMatrix.of(inverse, components(unit), components(unit)), rhs)


def _times(inverse: Inverse, x: Components) -> Components:
    """Inverses of the node blocks times vectors of the nodes."""
    if isinstance(inverse, tuple):
        first, second, third = inverse
        return dot_components(first, x), dot_components(second, x), dot_components(third, x)
    return each(lambda c: inverse * c, x)


def _part(x: Components, where: slice) -> Components:
    """Some of the vectors."""
    return each(operator.itemgetter(where), x)


class Tensions(NamedTuple):
    """The factored matrix."""

    geometry: Graph
    inverse: Inverse
    force: Components
    gradient: Components
    compliance: Array
    matrix: ConstraintMatrix

    @classmethod
    def of(
        cls, geometry: Graph, inverse: Inverse, force: Components, gradient: Components, compliance: Array
    ) -> Tensions:
        """The matrix that remains for the tensions."""
        matrix = ConstraintMatrix.of(inverse, force, gradient)
        matrix = matrix._replace(diagonal=matrix.diagonal - compliance)
        return cls(geometry, inverse, force, gradient, compliance, matrix)

    def apply(self, rows: Unknowns) -> Unknowns:
        loose = _times(self.inverse, components(rows.x))
        moved = each(lambda c: self.geometry.differences(c, None), loose)
        y = solve_tridiagonal(*store_once((*self.matrix, dot_components(self.gradient, moved) - rows.y)))
        back = _times(self.inverse, each(lambda p: self.geometry.gather(y * p), self.force))
        return Unknowns(jnp.stack([a + b for a, b in zip(loose, back, strict=True)], axis=-1), y)

    def transpose(self) -> Tensions:
        inverse = self.inverse
        if isinstance(inverse, tuple):
            first, second, third = zip(*inverse, strict=True)
            inverse = first, second, third
        return Tensions.of(self.geometry, inverse, self.gradient, self.force, self.compliance)


@dataclass(frozen=True)
class Condensed(Solver):
    """Condensed solver with a tridiagonal system of tensions."""

    name: str = "condensed"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        if not model.geometry.is_path:
            return "it follows one line, but the scene is a system of lines; use network or dense"
        if not integrator.condensable:
            return f"integrator {integrator.name!r} does not offer the pieces it needs; use dense or banded"
        if model.laws:
            return f"effect {model.laws[0].name!r} has its own unknowns; use dense"
        if model.reach > 0:
            if model.line.compound:
                what = "compound links couple"
            else:
                what = "a force in the scene couples"
            return f"it eliminates node by node, but {what} neighbouring nodes; use banded or dense"
        return None

    def linearise(self, problem: StepProblem, u: Unknowns) -> Tensions:
        geometry = problem.model.geometry
        node = local_jacobian(lambda x: problem.node_rows(x, ())[0], u.x)
        turn, force, gradient, compliance = LinkParts.of(problem, u)
        stiffness = TURNING_SHARE * jnp.maximum(jnp.trace(turn, axis1=1, axis2=2) / 3.0, 0.0)
        own = geometry.at_ends(stiffness, stiffness)
        node = node + own[:, None, None] * jnp.eye(3, dtype=node.dtype)
        inverse = inverse_rows(store_once(node))
        return Tensions.of(geometry, inverse, components(force), components(gradient), compliance)
