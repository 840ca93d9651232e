"""The model: a frozen pytree of arrays (points, lines, effects) that `grad`, `jacfwd`, `vmap` and `jit` work on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from dropper_jax.base.fields import component
from dropper_jax.model.effect import Effect, Law
from dropper_jax.model.geometry import Ends
from dropper_jax.model.kinematics import Frozen, Kinematics
from dropper_jax.model.line import Line, Point
from dropper_jax.model.path import gather_links, link_differences, stack_nodes
from dropper_jax.model.slots import AddedMass, Displacement, Force, Potential, Prepared, Stateful
from dropper_jax.sea import Sea

Role = TypeVar("Role")


def named(line: str | int, names: Sequence[str]) -> int:
    """The number of a line, by name or number."""
    if line in names:
        return names.index(line)
    if isinstance(line, int) and 0 <= line < len(names):
        return line
    raise ValueError(f"line: {line!r} is unknown; allowed: {', '.join(names)} or 0 to {len(names) - 1}")


#: The name under which moving ends work.
MOVING_ENDS = "moving_ends"


@component
class Model:
    """Everything that moves and everything that acts on it."""

    points: tuple[Point, ...] = ()
    lines: tuple[Line, ...] = ()
    effects: tuple[Effect, ...] = ()
    sea: Sea | None = None

    @property
    def line(self) -> Line:
        return self.lines[0]

    @property
    def branched(self) -> bool:
        """Whether it is a system of lines (`dropper_jax.model.lines.System`)."""
        return False

    @property
    def end_held(self) -> bool:
        return self.points[self.line.end].kind == "fixed"

    @property
    def free_nodes(self) -> int:
        return self.line.links - (1 if self.end_held else 0)

    @property
    def moving(self) -> bool:
        """Whether an end follows a prescribed motion."""
        return bool(self.having(Displacement))

    def having(self, slot: type[Role]) -> tuple[Role, ...]:
        """The effects that fill a slot (see `model.slots`), in order."""
        return tuple(e for e in self.effects if isinstance(e, slot))

    @property
    def working(self) -> tuple[Force, ...]:
        """The effects whose force is not conservative, so that its work is booked."""
        return tuple(e for e in self.having(Force) if not isinstance(e, Potential))

    @property
    def constant_force(self) -> bool:
        """Whether no force depends on positions or velocities."""
        return all(e.constant for e in self.having(Force))

    @property
    def reach(self) -> int:
        """How far the forces (tensions aside) couple nodes: 0 own node only."""
        inertia = 1 if self.line.compound else 0
        return max([inertia, *(e.reach for e in (*self.having(Force), *self.having(AddedMass)))])

    @property
    def laws(self) -> tuple[Law, ...]:
        """Effects with unknowns of their own."""
        return tuple(e for e in self.effects if isinstance(e, Law) and e.components)

    @property
    def dtype(self) -> jnp.dtype:
        return self.line.length.dtype

    def effect(self, name: str) -> Effect | None:
        """The effect of that name, or None."""
        return next((e for e in self.effects if e.name == name), None)

    def _position(self, index: int, t: jax.Array) -> jax.Array:
        point = self.points[index]
        moving = [e for e in self.having(Displacement) if e.moves(point.name)]
        shifts = [e.displace(t, self.sea) if e.needs_sea else e.displace(t) for e in moving]
        return sum(shifts, point.position)

    def _ends(self, time: jax.Array) -> Ends:
        end = self._position(self.line.end, time) if self.end_held else None
        return Ends(self._position(self.line.start, time), end)

    def ends(self, t: jax.Array) -> Ends:
        """Positions and velocities of the held ends at time t."""
        if not self.moving:
            return self._ends(t)
        t = jnp.asarray(t, self.dtype)
        position, velocity = jax.jvp(lambda time: self._ends(time)[:2], (t,), (jnp.ones_like(t),))
        return Ends(*position, *velocity)

    def kinematics(self, r: jax.Array, v: jax.Array, t: jax.Array, ends: Ends | None = None, **more: Any) -> Kinematics:
        """One instant of the line; `ends` where they are known already."""
        return Kinematics(self, r, v, t, self.ends(t) if ends is None else ends, **more)

    def instant(self, r: jax.Array, v: jax.Array, t: jax.Array, ends: Ends | None = None) -> Kinematics:
        """One instant with what effects freeze over a step taken there."""
        k = self.kinematics(r, v, t, ends)
        return self.kinematics(r, v, t, k.ends, prepared=self.prepare(k))

    def links(self, r: jax.Array, ends: Ends) -> jax.Array:
        """Link vectors (n, 3) [m]."""
        return self.differences(r, ends)

    def differences(self, free: jax.Array, ends: Ends | None, rates: bool = False) -> jax.Array:
        """Differences over the links (n, 3) of places, or of velocities (`rates`); without ends they are zero."""
        if ends is None:
            return link_differences(free, None, None, self.end_held)
        start, end = (ends.start_velocity, ends.end_velocity) if rates else (ends.start, ends.end)
        return link_differences(free, start, end, self.end_held)

    def nodes(self, r: jax.Array, ends: Ends, rates: bool = False) -> jax.Array:
        """All nodes of the line (n + 1, 3), both ends included; with `rates` their velocities."""
        if not rates:
            return stack_nodes(r, ends.start, ends.end)
        still = jnp.zeros(3, r.dtype)
        start = still if ends.start_velocity is None else ends.start_velocity
        end = still if ends.end_velocity is None else ends.end_velocity
        return stack_nodes(r, start, end if self.end_held else None)

    def gather(self, pull: jax.Array) -> jax.Array:
        """Sum on the free nodes (nodes, ...) of what links pull (n, ...): + on their first node, - on their last."""
        return gather_links(pull, self.end_held)

    def node(self, line: str | int, j: int) -> int:
        """Number among the free nodes of node j of a line (see `Kinematics.node`)."""
        numbers = self.node_numbers(line)
        if not 0 <= j < len(numbers):
            raise ValueError(f"node: {j} is not a node of line {line!r}; allowed: 0 to {len(numbers) - 1}")
        if not 0 <= numbers[j] < self.free_nodes:
            raise ValueError(f"node: {j} of line {line!r} is held; allowed: a node that moves")
        return int(numbers[j])

    def node_numbers(self, line: str | int) -> np.ndarray:
        """Numbers of a line's nodes, both ends included; those of held ones are no free node's."""
        named(line, [self.line.name])
        return np.arange(-1, self.line.links)

    @property
    def node_length(self) -> jax.Array:
        """Length that belongs to each free node (nodes,) [m]; sizes residuals."""
        return self.line.length[: self.free_nodes]

    @property
    def node_mass(self) -> jax.Array:
        """Diagonal of the mass matrix (nodes,) [kg]."""
        return self.line.node_mass(self.free_nodes)

    def own_inertia(self, a: jax.Array, ends: Ends | None = None) -> jax.Array:
        """M a on the free nodes (nodes, 3) [N]; `ends` holds the accelerations of the ends (None: at rest)."""
        start, end = (None, None) if ends is None else (ends.start, ends.end)
        return self.line.inertia_force(a, start, end, self.end_held)

    def end_power(self, pull: jax.Array, rates: Ends) -> jax.Array:
        """Power [W] that moving ends put into link forces `pull` (n, 3) [N] they hold."""
        power = -jnp.sum(pull[0] * rates.start_velocity)
        return power + jnp.sum(pull[-1] * rates.end_velocity) if self.end_held else power

    def end_powers(self, pull: jax.Array, rates: Ends) -> dict[str, jax.Array]:
        """The same by name; empty where the ends rest."""
        return {MOVING_ENDS: self.end_power(pull, rates)} if self.moving else {}

    def pull(self, tension: jax.Array, direction: jax.Array) -> jax.Array:
        """Nodal force (nodes, 3) [N] of link tensions (n,) along `direction` (n, 3)."""
        return gather_links(tension[:, None] * direction, self.end_held)

    def force(self, k: Kinematics) -> jax.Array:
        """Sum of the effects' nodal forces (nodes, 3) [N]."""
        return sum((e.force(k) for e in self.having(Force)), jnp.zeros_like(k.r))

    def working_forces(self, k: Kinematics) -> dict[str, jax.Array]:
        """Forces (nodes, 3) [N] whose work is booked, by effect."""
        return {e.name: e.force(k) for e in self.working}

    def inertia(self, k: Kinematics, a: jax.Array, ends: Ends | None = None) -> jax.Array:
        """Inertia force (nodes, 3) [N] of accelerations a, added mass included; `ends` holds those of the ends."""
        own = self.own_inertia(a, ends)
        return sum((e.inertia(k, a) for e in self.having(AddedMass)), own)

    def entered(self, own: Mapping[str, Frozen]) -> Model:
        """The model whose effects have what is their own (`State.own`)."""
        if not own:
            return self
        effects = tuple(e.entered(own[e.name]) if isinstance(e, Stateful) else e for e in self.effects)
        return dataclasses.replace(self, effects=effects)

    def begun(self) -> dict[str, Frozen]:
        """What is effects' own at the beginning of a run, by effect."""
        return {e.name: e.begin(self) for e in self.having(Stateful)}

    def advanced(self, before: Kinematics, after: Kinematics, tension: jax.Array, h: jax.Array) -> dict[str, Frozen]:
        """The same after a step (see `slots.Stateful`); of the model as it was during the step."""
        return {e.name: e.advance(before, after, tension, h) for e in self.having(Stateful)}

    def prepare(self, k: Kinematics) -> dict[str, Any]:
        """What effects freeze over a step."""
        own = {e.name: e.prepare(k) for e in self.having(Prepared)}
        if self.sea is None or not any(e.needs_water for e in self.effects):
            return own
        material, current = (any(getattr(e, f"needs_{what}") for e in self.effects) for what in ("material", "current"))
        return {**own, "water": self.sea.water(k.r, k.t, k.tangents, material, current)}

    def kinetic_energy(self, k: Kinematics) -> jax.Array:
        """Kinetic energy, scalar [J]; with held ends that move, of the links they carry too."""
        own = 0.5 * jnp.sum(k.v * self.own_inertia(k.v))
        if self.line.compound and self.moving:
            own = own + self._end_kinetic(k)
        return sum((e.kinetic(k) for e in self.having(AddedMass)), own)

    def _end_kinetic(self, k: Kinematics) -> jax.Array:
        first, coupling, last = self.line.blocks()
        ends = k.ends
        extra = 0.5 * first[0] * jnp.sum(ends.start_velocity**2)
        extra = extra + coupling[0] * jnp.sum(ends.start_velocity * k.v[0]) if k.free else extra
        if self.end_held:
            extra = extra + 0.5 * last[-1] * jnp.sum(ends.end_velocity**2)
            extra = extra + coupling[-1] * jnp.sum(ends.end_velocity * k.v[-1])
        return extra

    def potential_energy(self, k: Kinematics) -> jax.Array:
        """Potential energy of conservative effects and stretched links, scalar [J]."""
        own = self.line.axial.energy(k.links, self.line.length)
        return sum((e.potential(k) for e in self.having(Potential)), own)

    def cast(self, dtype: DTypeLike) -> Model:
        """The same model with its arrays in another precision."""
        return jax.tree.map(lambda x: jnp.asarray(x, dtype), self)
