"""Node blocks are eliminated first, which leaves a scalar tridiagonal system for the tensions. Linear cost, array
operations.

The matrix is `[[K, -G], [g', -c]]`: K node-local (nodes, 3, 3), G the force of a unit tension, g the gradient of the
axial law, c its compliance. K omits the geometric stiffness between neighbours. Newton therefore converges linearly to
the same solution, by a factor of about 0.1 per iteration at h omega = 0.6.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.numerics import Components, components, dot_components, inverse_rows, store_once
from dropper_jax.model import Graph, Model
from dropper_jax.residual import CondensedParts, Implicit, StepProblem, Unknowns

#: Inverses of the node blocks: (nodes,), or three rows of three components (nodes,).
Inverse = jax.Array | tuple[Components, Components, Components]


class ConstraintMatrix(NamedTuple):
    """Rows (n,) of `g M^-1 G'` of one line, tridiagonal: node i couples link i before it and link i + 1 after it."""

    lower: jax.Array
    diagonal: jax.Array
    upper: jax.Array

    @classmethod
    def of(cls, inverse: Inverse, force: Components, gradient: Components) -> ConstraintMatrix:
        """From M^-1 of the free nodes; of each link the force G of a unit tension and the gradient g of its row."""
        links, free = len(force[0]), len(jax.tree.leaves(inverse)[0])
        held = free < links
        own = _times(inverse, _part(force, slice(free)))
        joined = slice(None) if held else slice(-1)  # nodes with a link after them
        after = slice(1, None)
        following = _times(jax.tree.map(operator.itemgetter(joined), inverse), _part(force, after))
        zero = jnp.zeros_like(force[0][:1])
        far = dot_components(_part(gradient, slice(free)), own)
        far = jnp.concatenate([far, zero]) if held else far
        near = jnp.concatenate([zero, dot_components(_part(gradient, after), following)])
        upper = -dot_components(_part(gradient, slice(links - 1)), following)
        lower = -dot_components(_part(gradient, after), _part(own, joined))
        return cls(jnp.concatenate([zero, lower]), far + near, jnp.concatenate([upper, zero]))


class _Factor(NamedTuple):
    geometry: Graph
    inverse: Inverse
    force: Components
    gradient: Components
    matrix: ConstraintMatrix


def _times(inverse: Inverse, x: Components) -> Components:
    if isinstance(inverse, tuple):
        return tuple(dot_components(row, x) for row in inverse)
    return tuple(inverse * c for c in x)


def _part(x: Components, where: slice) -> Components:
    return tuple(c[where] for c in x)


def _eliminate(
    geometry: Graph, inverse: Inverse, force: Components, gradient: Components, compliance: jax.Array
) -> _Factor:
    """The matrix that remains for the tensions."""
    matrix = ConstraintMatrix.of(inverse, force, gradient)
    return _Factor(geometry, inverse, force, gradient, matrix._replace(diagonal=matrix.diagonal + compliance))


def _solve(f: _Factor, rows: Unknowns) -> Unknowns:
    loose = _times(f.inverse, components(rows.x))
    moved = tuple(f.geometry.differences(c, None) for c in loose)
    y = solve_tridiagonal(*store_once((*f.matrix, dot_components(f.gradient, moved) - rows.y)))
    back = _times(f.inverse, tuple(f.geometry.gather(y * p) for p in f.force))
    return Unknowns(jnp.stack([a + b for a, b in zip(loose, back, strict=True)], axis=-1), y)


@dataclass(frozen=True)
class Condensed:
    """Condensed solver with a tridiagonal system of tensions."""

    name: str = "condensed"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        if model.geometry.branched:
            return "it follows one line, but the scene is a system of lines; use network or dense"
        if not integrator.condensable:
            return f"integrator {integrator.name!r} does not offer the pieces it needs; use dense or banded"
        if not model.line.axial.condensable:
            return "the damper of its slack links is not in the condensed matrix; use banded or dense"
        if model.laws:
            return f"effect {model.laws[0].name!r} has its own unknowns; use dense"
        if model.reach > 0:
            what = "compound links couple" if model.line.compound else "a force in the scene couples"
            return f"it eliminates node by node, but {what} neighbouring nodes; use banded or dense"
        return None

    def prepare(self, problem: StepProblem, u: Unknowns) -> Inverse:
        """Inverses of the node blocks, reused in the iterations of a step: they change little, and cost most."""
        node = problem.node_matrix(u)
        return 1.0 / node if node.ndim == 1 else inverse_rows(store_once(node))

    def factor(
        self, problem: StepProblem, u: Unknowns, prepared: Inverse | None = None
    ) -> tuple[_Factor, CondensedParts]:
        inverse = self.prepare(problem, u) if prepared is None else prepared
        parts = problem.condensed_parts(u)
        force, gradient = components(parts.force), components(parts.gradient)
        return _eliminate(problem.model.geometry, inverse, force, gradient, parts.compliance), parts

    def apply(self, factor: tuple[_Factor, CondensedParts], rows: Unknowns) -> Unknowns:
        return _solve(factor[0], rows)

    def apply_transposed(self, factor: tuple[_Factor, CondensedParts], rows: Unknowns) -> Unknowns:
        f, parts = factor
        inverse = tuple(zip(*f.inverse, strict=True)) if isinstance(f.inverse, tuple) else f.inverse
        return _solve(_eliminate(f.geometry, inverse, f.gradient, f.force, parts.compliance), rows)
