"""One implicit step as a set of unknowns, residual rows and the resulting state."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.model import Effect, ElementForce, Ends, Kinematics, Model, State, Works

GRAVITY_SCALE = GRAVITY  # [m/s^2]; only scales residuals, the gravity of the scene is a parameter of an effect


#: One array per law of an effect: its unknowns (joints, c), or the rows that determine them.
PerLaw = tuple[Array, ...]
#: Force rows of the nodes (nodes, 3) [N], and the rows of laws.
NodeRows = tuple[Array, PerLaw]


class Unknowns(NamedTuple):
    """Unknowns of a step, or its rows, or scales of either.

    Attributes:
        x: per free node, (nodes, 3).
        y: per link, (n,): tensions; as rows: the axial laws.
        z: per law of an effect, (joints, c) each.
    """

    x: Array
    y: Array
    z: PerLaw = ()


class StepProblem:
    """The equations of one step from state `s` over `h`; created again in each trace."""

    #: Smoothing of set-valued laws, 1 to 0; None means the laws themselves.
    easing: Array | None = None

    def __init__(self, model: Model, s: State, h: Array) -> None:
        self.model, self.s, self.h = model.lump_mass(), s, h

    @property
    def pieces(self) -> tuple[ElementForce, ...]:
        """Forces in the rows that couple nodes element by element."""
        return self.model.pieces

    def guess(self) -> Unknowns:
        raise NotImplementedError

    def residual(self, u: Unknowns) -> Unknowns:
        """Rows in physical units: forces [N], elongations [m], torques [N m]."""
        force, axial = self.link_rows(self.link_vectors(u.x), u.y)
        rows, laws = self.node_rows(u.x, u.z)
        return Unknowns(rows - self.model.gather(force), axial, laws)

    def with_smoothing(self, easing: Array) -> StepProblem:
        """The same equations with smoothed laws."""
        other = copy(self)
        other.easing = easing
        return other

    def acting(self, effects: tuple[Effect, ...]) -> StepProblem:
        """The same equations with only these effects of the model, with their frozen values."""
        other = copy(self)
        other.model = replace(self.model, effects=effects)
        return other

    def instant(self, x: Array) -> Kinematics:
        """Positions and velocities at which forces act at the unknowns x; those of each node depend only on its own
        x."""
        raise NotImplementedError

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        """Force rows (nodes, 3) without the links' tensions, and the rows of laws; each node's depend on its own x
        only."""
        raise NotImplementedError

    def law_rows(self, k: Kinematics, z: PerLaw) -> NodeRows:
        """Forces (nodes, 3) [N] of the unknowns of laws at an instant, and the rows that determine these."""
        pairs = tuple(zip(self.model.laws, z, strict=False))
        force = sum((law.law_force(k, unknown) for law, unknown in pairs), jnp.zeros_like(k.r))
        return force, tuple(law.law_residual(k, unknown, self.h, self.easing) for law, unknown in pairs)

    def link_vectors(self, x: Array) -> Array:
        """Link vectors (n, 3) at the unknowns, in a unit in which they change as the differences of x do."""
        raise NotImplementedError

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        """Force of each link (n, 3) [N] and its axial row (n,) [m], from its own vector and tension only."""
        raise NotImplementedError

    def finish(self, u: Unknowns) -> State:
        """The state at the end of the step."""
        raise NotImplementedError

    def end_state(self, r: Array, v: Array, tension: Array, work: Callable[[], Array], **more: Any) -> State:
        """The state at the end of the step from its positions and velocities (nodes, 3), tensions (n,) and work
        (k,)."""
        model = self.model
        s = self.s
        t = self.s.t + self.h
        own = s.own
        if own:
            own = model.advance_internal_state(
                model.kinematics(s.r, s.v, s.t), model.kinematics(r, v, t), tension, self.h
            )
        done = s.work + work() if s.work.size else s.work
        return replace(s, r=r, v=v, tension=tension, t=t, work=done, own=own, **{"angles": None, **more})

    def force_works(self, k: Kinematics, v: Array, share: Array | float = 1.0) -> Works:
        """Work [J] over the step, by name, of this share of the forces of an instant on nodes that move at v (nodes, 3)
        [m/s]."""
        forces = self.model.working_forces(k)
        return {name: share * self.h * jnp.sum(force * v) for name, force in forces.items()}

    def end_works(self, pull: Array, rates: Ends, share: float = 1.0, k: Kinematics | None = None) -> Works:
        """Work [J] over the step, by name, of this share of `Model.end_powers`."""
        return {name: share * self.h * power for name, power in self.model.end_powers(pull, rates, k).items()}

    def row_scale(self) -> Unknowns:
        """Sizes of the rows: max(m g, m L/h^2) on nodes, L on links, and those of the laws."""
        model = self.model
        h = self.h
        line = model.line
        force = model.node_mass * jnp.maximum(GRAVITY_SCALE, model.node_length / h**2)
        laws = zip(model.laws, self.s.law, strict=False)  # then multipliers
        z = tuple(jnp.broadcast_to(law.law_scale(line, h), guess.shape) for law, guess in laws)
        return Unknowns(
            force[:, None], line.length, z + tuple(constraint.gap_size(model) for constraint in model.constraints)
        )

    def column_scale(self) -> Unknowns:
        """Sizes of the unknowns: x by `unknown_size`, tensions by mean weights or inertia, those of the laws as their
        rows."""
        line = self.model.line
        force = jnp.mean(line.mass) * jnp.maximum(GRAVITY_SCALE, jnp.mean(line.length) / self.h**2)
        laws = self.row_scale().z[: len(self.model.laws)]
        pulls = tuple(constraint.force_size(self.model) for constraint in self.model.constraints)
        return Unknowns(self.unknown_size(), jnp.broadcast_to(force, line.length.shape), laws + pulls)

    def unknown_size(self) -> Array:
        """Size of x, (nodes, 1): a length [m]."""
        return self.model.node_length[:, None]


class SpeedProblem(StepProblem):
    """Equations of rigid links between point masses whose unknown x is a speed, with tensions along the first links."""

    def __init__(self, model: Model, s: State, h: Array) -> None:
        super().__init__(model, s, h)
        self.ends0, self.ends1 = model.ends(s.t), model.ends(s.t + h)
        self.mass = model.line.node_mass
        self.pull0 = self.unit_forces(model.links(s.r, self.ends0))
        #: Link vectors (n, 3) [m] of nodes that do not move between ends that do.
        self.waiting = model.links(s.r, self.ends1)

    def unit_forces(self, links: Array) -> Array:
        """Forces (n, 3) of unit tensions in links (n, 3) [m]."""
        return links / self.model.line.length[:, None]

    def link_vectors(self, x: Array) -> Array:
        """Differences (n, 3) [m/s] of the speeds; fixed points count as at rest."""
        return self.model.geometry.differences(x, None)

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        line = self.model.line
        return y[:, None] * self.pull0, line.axial.at_rest(self.waiting + self.h * d, y, line.length)

    def unknown_size(self) -> Array:
        """Size of x, (nodes, 1) [m/s]: a link's length per step."""
        return self.model.line.length[: self.model.free_nodes, None] / jnp.abs(self.h)


def local_jacobian(f: Callable[[Array], Any], x: Array) -> Any:
    """Blocks (n, ..., c) of a map that acts on each row of x (n, c), or each entry (n,), by itself.

    All rows move together, so `jax.jacfwd` needs one direction per column.
    """
    return jax.jacfwd(lambda e: f(x + e))(jnp.zeros(x.shape[1:], x.dtype))
