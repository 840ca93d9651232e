"""One implicit step as a set of unknowns, residual rows and the resulting state."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.model import (
    Effect,
    ElementForce,
    Ends,
    Kinematics,
    Model,
    State,
    Works,
    end_powers,
    non_conservative_forces,
)

#: Scale of residuals [m/s^2]; the gravity of the scene is a parameter of an effect.
GRAVITY_SCALE = GRAVITY
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
        self.model = model.with_known_mass()
        self.s = s
        self.h = h

    @property
    def pieces(self) -> tuple[ElementForce, ...]:
        """Forces in the rows that couple nodes element by element."""
        return self.model.effects_with(ElementForce)

    def guess(self) -> Unknowns:
        """The unknowns from which Newton's method starts."""
        raise NotImplementedError

    def residual(self, u: Unknowns) -> Unknowns:
        """Rows in physical units: forces [N], elongations [m], torques [N m]."""
        force, axial = self.link_rows(self.link_vectors(u.x), u.y)
        rows, laws = self.node_rows(u.x, u.z)
        return Unknowns(rows - self.model.geometry.gather(force), axial, laws)

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
        """Positions and velocities at which forces act at the unknowns x; of each node by its own x only."""
        raise NotImplementedError

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        """Force rows (nodes, 3) [N] without the links' tensions, and the rows of laws; of each node by its own x
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

    def end_state(
        self,
        r: Array,
        v: Array,
        tension: Array,
        work: Callable[[], Array],
        acceleration: Array | None = None,
        law: PerLaw | None = None,
        angles: tuple[Array, ...] | None = None,
    ) -> State:
        """The state at the end of the step, see `State`.

        Args:
            work: computes the work (k,) [J] of the step; not called in runs that do not record it.
            acceleration, law: None: those at the start of the step remain.
        """
        model = self.model
        s = self.s
        t = s.t + self.h
        own = s.own
        if own:
            before = model.kinematics(s.r, s.v, s.t)
            own = model.advance_internal_state(before, model.kinematics(r, v, t), tension, self.h)
        done = s.work
        if done.size:
            done = done + work()
        if acceleration is None:
            acceleration = s.acceleration
        if law is None:
            law = s.law
        return replace(
            s, r=r, v=v, tension=tension, t=t, acceleration=acceleration, law=law, work=done, angles=angles, own=own
        )

    def force_works(self, k: Kinematics, v: Array, share: Array | float = 1.0) -> Works:
        """Work [J] over the step, by name, of this share of the forces of an instant on nodes that move at v (nodes, 3)
        [m/s]."""
        forces = non_conservative_forces(self.model, k)
        return {name: share * self.h * jnp.sum(force * v) for name, force in forces.items()}

    def end_works(self, link_force: Array, ends: Ends, share: float = 1.0, k: Kinematics | None = None) -> Works:
        """Work [J] over the step, by name, of this share of `end_powers`."""
        powers = end_powers(self.model, link_force, ends, k)
        return {name: share * self.h * power for name, power in powers.items()}

    def row_scale(self) -> Unknowns:
        """Sizes of the rows: max(m g, m L/h^2) on nodes, L on links, and those of the laws."""
        model = self.model
        h = self.h
        line = model.line
        force = model.node_mass * jnp.maximum(GRAVITY_SCALE, model.node_length / h**2)
        laws = zip(model.laws, self.s.law, strict=False)  # then multipliers
        z = tuple(jnp.broadcast_to(law.law_scale(line, h), guess.shape) for law, guess in laws)
        gaps = tuple(constraint.gap_size(model) for constraint in model.constraints)
        return Unknowns(force[:, None], line.length, z + gaps)

    def column_scale(self) -> Unknowns:
        """Sizes of the unknowns: x by `unknown_size`, tensions by mean weights or inertia, those of the laws as their
        rows."""
        line = self.model.line
        force = jnp.mean(line.mass) * jnp.maximum(GRAVITY_SCALE, jnp.mean(line.length) / self.h**2)
        laws = self.row_scale().z[: len(self.model.laws)]
        multipliers = tuple(constraint.force_size(self.model) for constraint in self.model.constraints)
        return Unknowns(self.unknown_size(), jnp.broadcast_to(force, line.length.shape), laws + multipliers)

    def unknown_size(self) -> Array:
        """Size of x, (nodes, 1): a length [m]."""
        return self.model.node_length[:, None]


class DisplacementProblem(StepProblem):
    """Equations whose unknown is x = r1 - r0 - h v0, so that rounding stays relative to the acceleration."""

    def __init__(self, model: Model, s: State, h: Array) -> None:
        super().__init__(model, s, h)
        self.ends0 = self.model.ends(s.t)
        self.ends1 = self.model.ends(s.t + h)
        self.links0 = self.model.links(s.r, self.ends0)

    def end_positions(self, x: Array) -> Array:
        """Positions (nodes, 3) [m] at the end of the step."""
        return self.s.r + (self.h * self.s.v + x)

    def link_vectors(self, x: Array) -> Array:
        return self.model.links(self.end_positions(x), self.ends1)


class SpeedProblem(StepProblem):
    """Equations of rigid links between point masses whose unknown x is a speed, with tensions along the first links."""

    def __init__(self, model: Model, s: State, h: Array) -> None:
        super().__init__(model, s, h)
        self.ends0 = model.ends(s.t)
        self.ends1 = model.ends(s.t + h)
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
