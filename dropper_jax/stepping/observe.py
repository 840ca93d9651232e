"""What is reported of states: energies, closure, and velocities that agree with the constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import safe_norm
from dropper_jax.model import Frozen, Graph, Model, Parted, State, as_parted, state
from dropper_jax.residual import CondensedParts, StepProblem, Unknowns
from dropper_jax.solvers import SOLVERS


class Observed(NamedTuple):
    """One instant as reported: all nodes' positions and velocities (n + 1, 3), energies [J], length error [m]."""

    positions: jax.Array
    velocities: jax.Array
    kinetic: jax.Array
    potential: jax.Array
    closure: jax.Array


class ProjectionProblem(StepProblem):
    """Smallest change x of the velocities (in the mass metric) that stops rigid links from stretching.

    M x - G' y = 0,    d/L . (rate of the links) = 0  (y = 0 of links that stretch)
    """

    def __init__(self, model: Model, s: State) -> None:
        super().__init__(model, s, jnp.ones((), model.dtype))
        self.ends = model.ends(s.t)
        self.pull = model.links(s.r, self.ends) / model.line.length[:, None]
        self.rigid = model.line.axial.rigid(model.line.links)

    def residual(self, u: Unknowns) -> Unknowns:
        pull, rows = self.link_rows(self.link_vectors(u.x), u.y)
        return Unknowns(self.node_rows(u.x, ())[0] - self.model.gather(pull), rows)

    def node_rows(self, x: jax.Array, z: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        return self.model.own_inertia(x), ()

    def link_vectors(self, x: jax.Array) -> jax.Array:
        """Rates of the links, for the network solver."""
        return self.model.rates(self.s.v + x, self.ends)

    def link_rows(self, d: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        rows = jnp.sum(self.pull * d, axis=-1)
        return y[:, None] * self.pull, rows if self.rigid.all() else jnp.where(self.rigid, rows, -y)

    def node_matrix(self, u: Unknowns) -> jax.Array:
        return self.model.node_mass

    def condensed(self, u: Unknowns) -> CondensedParts:
        return CondensedParts(self.pull, self.pull, jnp.zeros_like(self.model.line.length))


def consistent_velocity(model: Model, s: State) -> jax.Array:
    """Velocities (nodes, 3) [m/s] on the constraints: a midpoint scheme's own ring a little off them.

    For output, restart and hand-over only: projecting inside the steps would cost energy.
    """
    if model.line.axial.elastic:
        return s.v
    problem = ProjectionProblem(model, s)
    u = Unknowns(jnp.zeros_like(s.r), jnp.zeros_like(s.tension))
    solver = SOLVERS[
        "network" if isinstance(model.geometry, Graph) else "banded" if model.line.compound else "condensed"
    ]
    return s.v - solver.apply(solver.factor(problem, u), problem.residual(u)).x


def observe(
    model: Model,
    r: jax.Array,
    v: jax.Array,
    t: jax.Array,
    parted: Parted | None = None,
    own: Mapping[str, Frozen] | None = None,
) -> Observed:
    """Report on one instant; energies are those of the scheme's raw velocities, which it conserves."""
    model = as_parted(model, parted).entered(own or {})
    s = replace(state(model, r), v=v, t=t)
    ends = model.ends(t)
    k = model.instant(r, v, t, ends)
    line = model.line
    rigid = np.flatnonzero(line.axial.rigid(line.links))
    closure = jnp.max(jnp.abs(safe_norm(k.links) - line.length)[rigid], initial=0.0)
    return Observed(
        positions=k.nodes,
        velocities=model.nodes(consistent_velocity(model, s), ends, rates=True),
        kinetic=model.kinetic_energy(k),
        potential=model.potential_energy(k),
        closure=closure,
    )
