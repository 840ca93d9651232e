"""The exact Jacobian of a system of lines: tensions and friction on their own nodes first, then all nodes by rounds.

    node rows:  A dx + D'(G D dx + p dy) = r_x,    link rows:  g . D dx + c dy = r_y

D takes differences over links. With `dy = (r_y - g . D dx)/c` a link is a 3x3 stiffness `S = G - p g'/c` between its
nodes; if some links are rigid (c = 0) tensions remain unknowns, see `saddle`. Unknowns of node-local laws (seabed
friction) are eliminated first, with the compliance `SOFT` if the node sticks. The matrix is then approximate, but
Newton still converges to the exact solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import local_jacobian
from dropper_jax.model import ElementForce, Model
from dropper_jax.residual import Implicit, Solver, StepProblem, Unknowns
from dropper_jax.solvers.bodies import BodyFactor, factor_bodies
from dropper_jax.solvers.coupling import coupling
from dropper_jax.solvers.elimination import apply, inverse, multiply, optimization_barrier
from dropper_jax.solvers.links import LinkParts
from dropper_jax.solvers.saddle import Saddle, factor_lines
from dropper_jax.solvers.stretching import Stretching

#: Compliance of the friction of a sticking node relative to its inertia.
SOFT = 1e-8


class LawBlocks(NamedTuple):
    """A node-local law in the Jacobian: force rows by z (free, 3, 2), its rows by x (free, 2, 3) and z (free, 2, 2)."""

    force: Array
    position: Array
    law: Array

    def transpose(self) -> LawBlocks:
        return LawBlocks(self.position.mT, self.force.mT, self.law.mT)


@dataclass(frozen=True)
class NetworkFactor:
    """The factored Jacobian: of nodes and links, and the blocks of the law with its own block inverted, or None."""

    system: Stretching | Saddle | BodyFactor
    law: LawBlocks | None

    def transpose(self) -> NetworkFactor:
        law = self.law
        if law is not None:
            law = law.transpose()
        return NetworkFactor(self.system.transpose(), law)

    def apply(self, rows: Unknowns) -> Unknowns:
        gaps = ()
        if isinstance(self.system, BodyFactor):
            gaps = rows.z[-1:]
        law = self.law
        force = rows.x
        if law is not None:
            force = force - apply(law.force, apply(law.law, rows.z[0]))
        x, y, *z = self.system.solve(force, rows.y, *gaps)
        if law is not None:
            z = [apply(law.law, rows.z[0] - apply(law.position, x)), *z]
        return Unknowns(x, y, tuple(z))


@dataclass(frozen=True)
class Network(Solver):
    """Eliminates nodes that are not neighbours at once."""

    name: str = "network"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        if model.geometry.is_path:
            return "it is for systems of lines, but the scene is one line; use condensed, banded or dense"
        if not integrator.networkable:
            return f"integrator {integrator.name!r} does not offer the pieces it needs; use dense"
        if model.node_reach > 0:
            return "a force in the scene couples neighbouring nodes in addition to the tensions; use dense"
        if len(model.laws) > 1 or any(not law.node_local for law in model.laws):
            return f"effect {model.laws[0].name!r} couples nodes through its unknowns; use dense"
        return None

    def linearise(self, problem: StepProblem, u: Unknowns) -> NetworkFactor:
        dtype = u.x.dtype
        model = problem.model
        law = None
        own = problem
        between = coupling(problem, u)
        if model.constraints or between is not None:
            own = problem.acting(tuple(e for e in model.without_slot(ElementForce).effects if not e.bodily))
        if model.laws and u.z:  # the equations of an instant have no such unknowns
            node, law = optimization_barrier(_law_blocks(own, u))
            law = law._replace(law=inverse(law.law + SOFT * jnp.eye(2, dtype=dtype)))
            node = node - multiply(law.force, multiply(law.law, law.position))
        else:
            node = optimization_barrier(local_jacobian(lambda x: own.node_rows(x, ())[0], u.x))
        links = optimization_barrier(LinkParts.of(problem, u))
        if model.constraints:
            return NetworkFactor(factor_bodies(problem, u, node, links, between), law)
        return NetworkFactor(factor_lines(model, model.geometry, node, links, between), law)


def _law_blocks(problem: StepProblem, u: Unknowns) -> tuple[Array, LawBlocks]:
    """A, and the blocks of the one node-local law, from five directions of forward mode."""

    def rows(xz: Array) -> Array:
        force, (law,) = problem.node_rows(xz[:, :3], (xz[:, 3:],))
        return jnp.concatenate([force, law], axis=1)

    found = local_jacobian(rows, jnp.concatenate([u.x, u.z[0]], axis=1))
    return found[:, :3, :3], LawBlocks(found[:, :3, 3:], found[:, 3:, :3], found[:, 3:, 3:])
