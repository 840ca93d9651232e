"""The model: a frozen pytree of arrays (points, lines, effects) that `grad`, `jacfwd`, `vmap` and `jit` work on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from dropper_jax.axial import AxialLaw, ChangingLength
from dropper_jax.base.fields import component
from dropper_jax.model.effect import Effect, HolonomicConstraint, Law
from dropper_jax.model.graph import Graph
from dropper_jax.model.kinematics import Ends, Frozen, Kinematics, Role
from dropper_jax.model.line import Line, Point
from dropper_jax.model.slots import (
    AddedMass,
    CoupledMass,
    Displacement,
    ElementForce,
    Force,
    LengthOverTime,
    PointMass,
    Potential,
    Prepared,
    Stateful,
)
from dropper_jax.sea import Sea


def _join_times(times: Iterable[Array | np.ndarray | None]) -> Array | None:
    """All times (k,) [s]; None without any."""
    found = [jnp.ravel(part) for part in times if part is not None]
    if not found:
        return None
    return jnp.concatenate(found)


@component
class Model:
    """The complete moving system and everything that acts on it."""

    points: tuple[Point, ...] = ()
    lines: tuple[Line, ...] = ()
    effects: tuple[Effect, ...] = ()
    sea: Sea | None = None
    #: `node_mass` where it is computed once, in the equations of a step.
    known_node_mass: Array | None = None

    @property
    def line(self) -> Line:
        return self.lines[0]

    @property
    def geometry(self) -> Graph:
        return self.line.geometry

    @property
    def free_nodes(self) -> int:
        return self.geometry.free

    @property
    def needed_sea(self) -> Sea:
        """The sea, for effects that need it.

        Raises:
            ValueError: the model has none.
        """
        if self.sea is None:
            raise ValueError("sea: missing; an effect needs the water")
        return self.sea

    @property
    def both_ends_fixed(self) -> bool:
        """Whether both ends of a single line are fixed."""
        return self.geometry.ends == 2

    @property
    def has_moving_ends(self) -> bool:
        """Whether an end follows a prescribed motion."""
        return bool(self.effects_with(Displacement))

    @property
    def kinks(self) -> Array | None:
        """Times (k,) [s] at which the velocity or acceleration of a fixed point jumps; None if none ever does."""
        return _join_times(e.kinks for e in self.effects_with(Displacement))

    @property
    def corners(self) -> Array | None:
        """Times (k,) [s] at which an effect is not smooth in time; None if all are smooth."""
        own = _join_times(e.corners for e in self.effects)
        if self.sea is None:
            return own
        return _join_times([own, *self.sea.corners])

    def effects_with(self, slot: type[Role]) -> tuple[Role, ...]:
        """The effects that fill a slot (see `model.slots`), in order."""
        return tuple(e for e in self.effects if isinstance(e, slot))

    def without_slot(self, slot: type) -> Model:
        """The model without the effects that fill a slot."""
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if not isinstance(e, slot)))

    @property
    def constant_force(self) -> bool:
        """Whether no force depends on positions or velocities."""
        return all(e.constant for e in self.effects_with(Force))

    @property
    def reach(self) -> int:
        """How many neighbouring nodes the forces (tensions aside) couple: 0 own node only."""
        effects = (*self.effects_with(Force), *self.effects_with(AddedMass))
        return max([int(self.line.compound), *(e.reach for e in effects)])

    @property
    def node_reach(self) -> int:
        """`reach` without the forces of elements."""
        return self.without_slot(ElementForce).reach

    @property
    def laws(self) -> tuple[Law, ...]:
        """Effects with their own unknowns."""
        return tuple(law for law in self.effects_with(Law) if law.components)

    @property
    def constraints(self) -> tuple[HolonomicConstraint, ...]:
        """Equality constraints between nodes: rigid bodies."""
        return self.effects_with(HolonomicConstraint)

    @property
    def dtype(self) -> jnp.dtype:
        return self.line.length.dtype

    def effect(self, name: str) -> Effect | None:
        """The effect of that name, or None."""
        return next((e for e in self.effects if e.name == name), None)

    def displacement(self, effect: Displacement, t: Array) -> Array:
        """Displacement (3,) [m] of the fixed point that an effect moves, at time t."""
        if effect.needs_sea:
            return effect.displace(t, self.sea)
        return effect.displace(t)

    def _position(self, index: int, t: Array) -> Array:
        """Position (3,) [m] of a fixed point at time t."""
        point = self.points[index]
        moving = [e.motion_of(point.name) for e in self.effects_with(Displacement) if e.moves(point.name)]
        return sum((self.displacement(e, t) for e in moving), point.position)

    def _held_positions(self, time: Array) -> Array:
        """Positions (held, 3) [m] of the fixed points at a time."""
        held = [self._position(int(i), time) for i in self.geometry.held_points]
        if not held:
            return jnp.zeros((0, 3), self.dtype)
        return jnp.stack(held)

    def ends(self, t: Array) -> Ends:
        """Positions and velocities of the fixed points at time t."""
        if not self.has_moving_ends:
            return Ends(self._held_positions(t))
        t = jnp.asarray(t, self.dtype)
        return Ends(*jax.jvp(self._held_positions, (t,), (jnp.ones_like(t),)))

    def end_acceleration(self, t: Array) -> Array | None:
        """Accelerations (held, 3) [m/s^2] of moving ends at time t; None if all ends are at rest."""
        if not self.has_moving_ends:
            return None
        return jax.jvp(lambda time: self.ends(time).velocities, (t,), (jnp.ones_like(t),))[1]

    def kinematics(
        self,
        r: Array,
        v: Array,
        t: Array,
        ends: Ends | None = None,
        prepared: Mapping[str, Frozen] | None = None,
        h: Array | None = None,
        before: Array | None = None,
    ) -> Kinematics:
        """One instant of the lines.

        Args:
            ends: the fixed points, if they are known already.
            prepared: the data that the effects freeze over the step, if they are known already.
            h, before: the step of which this is the middle, see `Kinematics`.
        """
        if ends is None:
            ends = self.ends(t)
        return Kinematics(self, r, v, t, ends, prepared or {}, h, before)

    def instant(self, r: Array, v: Array, t: Array, ends: Ends | None = None) -> Kinematics:
        """One instant with the data that effects freeze over a step from there."""
        k = self.kinematics(r, v, t, ends)
        return dataclasses.replace(k, frozen=self.prepare(k))

    def links(self, r: Array, ends: Ends) -> Array:
        """Link vectors (n, 3) [m]."""
        return self.geometry.differences(r, ends.positions)

    def link_rates(self, v: Array, ends: Ends | None) -> Array:
        """Rates of the link vectors (n, 3) [m/s]; without `ends` the ends are at rest."""
        if ends is None:
            return self.geometry.differences(v, None)
        return self.geometry.differences(v, ends.velocities)

    def nodes(self, r: Array, ends: Ends) -> Array:
        """All nodes, line after line, both ends of each included (n + lines, 3) [m]."""
        return self.geometry.nodes(r, ends.positions)

    @property
    def node_length(self) -> Array:
        """Length assigned to each free node (nodes,) [m]; scales residuals."""
        return sum(
            (e.node_size(self) for e in self.effects_with(CoupledMass)), self.geometry.link_length(self.line.length)
        )

    @property
    def node_mass(self) -> Array:
        """Diagonal of the mass matrix (nodes,) [kg]."""
        if self.known_node_mass is not None:
            return self.known_node_mass
        return sum((e.point_mass(self) for e in self.effects_with(PointMass)), self.line.node_mass)

    @property
    def inverse_reduced_mass(self) -> Array:
        """Sum of 1/m of both nodes of each link (n,) [1/kg]; a fixed point counts as zero."""
        inverse = self.geometry.everywhere(1.0 / self.node_mass, None)
        return inverse[self.geometry.first] + inverse[self.geometry.last]

    def with_known_mass(self) -> Model:
        """The same with `node_mass` and the masses that couple nodes computed, which the equations of a step use
        often."""
        effects = []
        for effect in self.effects:
            if isinstance(effect, CoupledMass):
                effect = effect.with_known_mass()
            effects.append(effect)
        known = dataclasses.replace(self, effects=tuple(effects))
        return dataclasses.replace(known, known_node_mass=known.node_mass)

    def with_axial(self, axial: AxialLaw) -> Model:
        """The model with another axial law."""
        return dataclasses.replace(self, lines=(dataclasses.replace(self.line, axial=axial),))

    def nodal_inertia(self, a: Array, ends: Array | None = None) -> Array:
        """M a on the free nodes (nodes, 3) [N]; `ends` (held, 3) are the accelerations of the ends (None: at rest)."""
        if self.line.compound:
            own = self.geometry.at_ends(*self.line.inertia_forces(a, ends))
        else:
            own = self.node_mass[:, None] * a
        return sum((e.coupled(self, a) for e in self.effects_with(CoupledMass)), own)

    def tension_by_law(self, k: Kinematics) -> Array:
        """Tensions (n,) [N] of links that stretch at an instant."""
        return self.line.axial.tension(k.links, k.link_velocities, self.line.length)

    def tension_force(self, tension: Array, direction: Array) -> Array:
        """Nodal force (nodes, 3) [N] of link tensions (n,) along `direction` (n, 3)."""
        return self.geometry.gather(tension[:, None] * direction)

    def force(self, k: Kinematics) -> Array:
        """Sum of the effects' nodal forces (nodes, 3) [N]."""
        return sum((e.force(k) for e in self.effects_with(Force)), jnp.zeros_like(k.r))

    def inertia(self, k: Kinematics, a: Array, ends: Array | None = None) -> Array:
        """Inertia force (nodes, 3) [N] of accelerations a, added mass included; `ends` (held, 3) are the ends' own."""
        return sum((e.inertia(k, a) for e in self.effects_with(AddedMass)), self.nodal_inertia(a, ends))

    def with_internal_state(self, internal: Mapping[str, Frozen]) -> Model:
        """The model whose effects use their internal states (`State.own`)."""
        if not internal:
            return self
        effects = []
        for effect in self.effects:
            if isinstance(effect, Stateful):
                effect = effect.entered(internal[effect.name])
            effects.append(effect)
        return dataclasses.replace(self, effects=tuple(effects))

    def with_lengths(self, t: Array | float, h: Array | None = None, still: bool = False) -> Model:
        """The model whose tensions and energies are those of the unstretched lengths of an instant t [s], or of a step
        of h [s] that starts then; the same model if no length changes in time.

        Masses, weights and water forces keep the lengths of the scene. With `still` the drums stop at the instant, for
        statics.
        """
        changing = self.effects_with(LengthOverTime)
        if not changing:
            return self
        t = jnp.asarray(t, self.dtype)

        def lengths(time: Array) -> Array:
            return changing[0].unstretched_lengths(self.line, time)

        if h is None:
            after, rate = jax.jvp(lengths, (t,), (jnp.ones_like(t),))
            before = after
            if still:
                rate = jnp.zeros_like(rate)
        else:
            before = lengths(t)
            after = lengths(t + h)
            rate = (after - before) / h
        return self.with_axial(ChangingLength(self.line.axial, before, after, rate))

    def initial_internal_state(self) -> dict[str, Frozen]:
        """Internal states of the effects at the start of a run, by effect."""
        return {e.name: e.begin(self) for e in self.effects_with(Stateful)}

    def advance_internal_state(
        self, before: Kinematics, after: Kinematics, tension: Array, h: Array
    ) -> dict[str, Frozen]:
        """The same after a step (see `slots.Stateful`), from the model as it was during the step."""
        return {e.name: e.advance(before, after, tension, h) for e in self.effects_with(Stateful)}

    def prepare(self, k: Kinematics) -> dict[str, Frozen]:
        """The data that effects freeze over a step, by effect, and the water."""
        own = {e.name: e.prepare(k) for e in self.effects_with(Prepared)}
        if self.sea is None or not any(e.needs_water for e in self.effects):
            return own
        material = any(e.needs_material for e in self.effects)
        current = any(e.needs_current for e in self.effects)
        return {**own, "water": self.sea.water(k.r, k.t, k.tangents, material, current)}

    def kinetic_energy(self, k: Kinematics) -> Array:
        """Kinetic energy, scalar [J]; of compound lines including that of the link masses at moving ends."""
        own = 0.5 * jnp.sum(k.v * self.nodal_inertia(k.v, k.ends.velocities))
        if self.line.compound and k.ends.velocities is not None:
            held = self.geometry.held_at_ends(*self.line.inertia_forces(k.v, k.ends.velocities))
            own = own + 0.5 * jnp.sum(k.ends.velocities * held)
        return sum((e.kinetic(k) for e in self.effects_with(AddedMass)), own)

    def potential_energy(self, k: Kinematics) -> Array:
        """Potential energy of conservative effects and stretched links, scalar [J]."""
        stretched = self.line.axial.energy(k.links, self.line.length)
        return sum((e.potential(k) for e in self.effects_with(Potential)), stretched)

    def cast(self, dtype: DTypeLike) -> Model:
        """The same model with its arrays in another precision."""
        return jax.tree.map(lambda x: jnp.asarray(x, dtype), self)
