"""Velocities that agree with rigid links: the smallest change, in the mass metric, after which none of them stretches.

    M x = G' y,    d/L . (rate of the links at v + x) = 0  (y = 0 of links that stretch)

y are the impulses [N s] that do it. A midpoint scheme holds lengths, not their rates: a velocity along a link that
comes in by a jump of a held point (its velocity or its acceleration) changes its sign at every step and never decays,
and tensions alternate by `2 m w/h`. So steps that contain a jump end with this projection (`docs/physics.md`).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.model import AddedMass, Ends, Graph, Kinematics, Model
from dropper_jax.residual import CondensedParts, StepProblem, Unknowns, couples_inertia, node_blocks
from dropper_jax.solvers import SOLVERS


class ProjectionProblem(StepProblem):
    """Unknowns: x, the change of velocities (nodes, 3) [m/s], and impulses y (n,) [N s]; linear."""

    def __init__(self, k: Kinematics, added: bool) -> None:
        self.model, self.h = k.model, jnp.ones((), k.r.dtype)
        self.k, self.added = k, added
        self.pull = k.links / k.line.length[:, None]
        self.rigid = k.line.axial.rigid(k.line.links)

    def _inertia(self, x: jax.Array) -> jax.Array:
        return self.model.inertia(self.k, x) if self.added else self.model.own_inertia(x)

    def residual(self, u: Unknowns) -> Unknowns:
        pull, rows = self.link_rows(self.link_vectors(u.x), u.y)
        return Unknowns(self.node_rows(u.x, ())[0] - self.model.gather(pull), rows)

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        return self._inertia(x), ()

    def link_vectors(self, x: jax.Array) -> jax.Array:
        """Rates of the links, for the network solver."""
        return self.model.rates(self.k.v + x, self.k.ends)

    def link_rows(self, d: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        rows = jnp.sum(self.pull * d, axis=-1)
        return y[:, None] * self.pull, rows if self.rigid.all() else jnp.where(self.rigid, rows, -y)

    def node_matrix(self, u: Unknowns) -> jax.Array:
        return node_blocks(self._inertia, self.k.free, u.x.dtype) if self.added else self.model.node_mass

    def condensed(self, u: Unknowns) -> CondensedParts:
        return CondensedParts(self.pull, self.pull, jnp.zeros_like(self.k.line.length))


def consistent(k: Kinematics, added: bool = False) -> tuple[jax.Array, jax.Array]:
    """Velocities (nodes, 3) [m/s] on the constraints, and the impulses (n,) [N s] that lead there.

    Args:
        k: places, velocities and held points of one instant; with `added` prepared, as added mass asks for it.
        added: whether added mass counts.
    """
    model = k.model
    added = added and bool(model.having(AddedMass))
    problem = ProjectionProblem(k, added)
    u = Unknowns(jnp.zeros_like(k.r), jnp.zeros_like(k.line.length))
    coupled = k.line.compound or (added and couples_inertia(model))
    solver = SOLVERS["network" if isinstance(model.geometry, Graph) else "banded" if coupled else "condensed"]
    found = solver.apply(solver.factor(problem, u), problem.residual(u))
    return k.v - found.x, -found.y


def jumps(model: Model, t: jax.Array, h: jax.Array) -> jax.Array | None:
    """Whether held points jump in a step from t: within it or at either end; None where they never do."""
    kinks = model.kinks
    if kinks is None or model.line.axial.elastic:
        return None
    near = 1e-6 * jnp.abs(h)
    low, high = jnp.minimum(t, t + h) - near, jnp.maximum(t, t + h) + near
    return jnp.any((kinks >= low) & (kinks <= high))


def begun(model: Model, r: jax.Array, v: jax.Array, t: jax.Array, ends: Ends | None = None) -> jax.Array:
    """Velocities (nodes, 3) [m/s] at the start of a run: with ends that move at once, those that links can have."""
    if model.line.axial.elastic:
        return v
    return consistent(model.instant(r, v, t, ends), added=True)[0]
