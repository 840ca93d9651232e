"""Node blocks eliminated first, one scalar tridiagonal system in the tensions left. Linear cost, whole-array work.

The matrix is `[[K, -G], [g', -c]]`: K node-local (nodes, 3, 3), G the pull of a unit tension, g the gradient of the
axial law, c its compliance. What K leaves out of the Jacobian (the geometric stiffness between neighbours) makes
Newton converge linearly, to the same solution: by a factor of about 0.1 per iteration at h omega = 0.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax.linalg import tridiagonal_solve

from dropper_jax.kinematics import gather_links, link_differences
from dropper_jax.system import Unknowns

if TYPE_CHECKING:
    from dropper_jax.model import Model
    from dropper_jax.problem import StepProblem


class CondensedParts(NamedTuple):
    """The matrix, in pieces.

    Attributes:
        node: K, (nodes, 3, 3), or (nodes,) where it is a multiple of the unit matrix.
        pull: nodal force of unit tensions along (n, 3).
        gradient: derivative of the axial rows with respect to link differences of x, (n, 3).
        compliance: minus their derivative with respect to the tensions, (n,).
    """

    node: jax.Array
    pull: jax.Array
    gradient: jax.Array
    compliance: jax.Array


def inverse3(m: jax.Array) -> jax.Array:
    """Inverse of 3x3 matrices (..., 3, 3) by cofactors: elementwise work that fuses, no LAPACK call per block."""
    a, b, c = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    bc, ca, ab = jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)
    determinant = jnp.sum(a * bc, axis=-1)
    return jnp.stack([bc, ca, ab], axis=-1) / determinant[..., None, None]


def _times(node: jax.Array, x: jax.Array) -> jax.Array:
    if node.ndim == 1:
        return node[:, None] * x
    return jnp.sum(node * x[:, None, :], axis=-1)


class _Factor(NamedTuple):
    inverse: jax.Array
    pull: jax.Array
    gradient: jax.Array
    lower: jax.Array
    diagonal: jax.Array
    upper: jax.Array


def _eliminate(inverse: jax.Array, pull: jax.Array, gradient: jax.Array, compliance: jax.Array) -> _Factor:
    free = inverse.shape[0]
    links = pull.shape[0]
    dot = lambda p, q: jnp.sum(p * q, axis=-1)  # noqa: E731
    own = _times(inverse, pull[:free])  # node i moved by its link i
    diagonal = -dot(gradient[:free], own)
    zero = jnp.zeros_like(compliance[:1])
    if free == links:  # free end: the last node has no next link
        following = _times(inverse[:-1], pull[1:])
        near = jnp.concatenate([zero, -dot(gradient[1:], following)])
        crossing, back = dot(gradient[:-1], following), dot(gradient[1:], own[:-1])
    else:
        following = _times(inverse, pull[1:])
        diagonal = jnp.concatenate([diagonal, zero])
        near = jnp.concatenate([zero, -dot(gradient[1:], following)])
        crossing, back = dot(gradient[:-1], following), dot(gradient[1:], own)
    diagonal = diagonal + near - compliance
    return _Factor(
        inverse, pull, gradient, jnp.concatenate([zero, back]), diagonal, jnp.concatenate([crossing, zero])
    )


def _solve(f: _Factor, rows: Unknowns) -> Unknowns:
    held = f.inverse.shape[0] < f.pull.shape[0]
    loose = _times(f.inverse, rows.x)
    b = rows.y - jnp.sum(f.gradient * link_differences(loose, None, None, held), axis=-1)
    y = tridiagonal_solve(f.lower, f.diagonal, f.upper, b[:, None])[:, 0]
    return Unknowns(loose + _times(f.inverse, gather_links(y[:, None] * f.pull, held)), y)


@dataclass(frozen=True)
class Condensed:
    """Tridiagonal in the tensions."""

    name: str = "condensed"

    def refuse(self, model: Model, integrator: Any) -> str | None:
        if not integrator.condensable:
            return f"integrator {integrator.name!r} does not offer the pieces it needs; use dense or banded"
        if model.laws:
            return f"effect {model.laws[0].name!r} brings unknowns of its own; use dense"
        if model.reach > 0:
            what = "compound links couple" if model.line.compound else "a force in the scene couples"
            return f"it eliminates node by node, but {what} neighbouring nodes; use banded or dense"
        return None

    def factor(self, problem: StepProblem, u: Unknowns) -> Any:
        parts = problem.condensed(u)
        node = 1.0 / parts.node if parts.node.ndim == 1 else inverse3(parts.node)
        return _eliminate(node, parts.pull, parts.gradient, parts.compliance), parts.compliance

    def apply(self, factor: Any, rows: Unknowns) -> Unknowns:
        return _solve(factor[0], rows)

    def apply_transposed(self, factor: Any, rows: Unknowns) -> Unknowns:
        f, compliance = factor
        node = f.inverse if f.inverse.ndim == 1 else jnp.swapaxes(f.inverse, -1, -2)
        return _solve(_eliminate(node, f.gradient, f.pull, compliance), rows)
