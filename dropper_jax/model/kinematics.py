"""Positions and velocities of the lines at one instant, and derived quantities, computed only when requested."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeVar

from jax import Array

from dropper_jax.base.numerics import cross, safe_norm
from dropper_jax.base.records import Named
from dropper_jax.model.graph import Graph
from dropper_jax.model.line import Line, Point
from dropper_jax.sea import Sea, Water

#: The protocol of a slot, see `model.slots`.
Role = TypeVar("Role")


class ModelView(Protocol):
    """A model without its motion; `dropper_jax.model.model.Model` implements it."""

    @property
    def line(self) -> Line:
        """The links of all lines."""

    @property
    def geometry(self) -> Graph:
        """How nodes, links and points belong together."""

    @property
    def points(self) -> tuple[Point, ...]:
        """Points where lines start and end."""

    @property
    def needed_sea(self) -> Sea:
        """The water, for effects that need it."""

    @property
    def free_nodes(self) -> int:
        """Number of free nodes."""

    @property
    def node_mass(self) -> Array:
        """Diagonal of the mass matrix (nodes,) [kg]."""

    def effects_with(self, slot: type[Role]) -> tuple[Role, ...]:
        """The effects that fill a slot, in order."""

    def force(self, k: Kinematics) -> Array:
        """Sum of the effects' nodal forces (nodes, 3) [N]."""

    def nodal_inertia(self, a: Array, ends: Array | None = None) -> Array:
        """M a on the free nodes (nodes, 3) [N]; `ends` (held, 3) are the accelerations of the ends (None: at rest)."""

    def inertia(self, k: Kinematics, a: Array, ends: Array | None = None) -> Array:
        """The same with added mass."""


#: Data that an effect freezes over a step: any tree of arrays.
Frozen = Any


class Ends(NamedTuple):
    """The fixed points at one instant, in the order of `Graph.held_points`.

    Attributes:
        positions: (held, 3) [m].
        velocities: (held, 3) [m/s]; None if no point moves.
    """

    positions: Array
    velocities: Array | None = None

    @property
    def start(self) -> Array:
        """Start point of a single line (3,) [m]."""
        return self.positions[0]

    @property
    def end(self) -> Array | None:
        """End point of a single line (3,) [m]; None if that end is free."""
        if self.positions.shape[0] > 1:
            return self.positions[1]
        return None


@dataclass(eq=False)
class Kinematics:
    """One instant of the lines, as effects receive it.

    Attributes:
        model: the lines, points and effects without their motion.
        r, v: free nodes (nodes, 3) [m], [m/s].
        t: time [s].
        ends: fixed points.
        frozen: the data that effects freeze over a step, by effect.
        h: the step [s] of which this is the middle; None at a plain instant.
        before: velocities (nodes, 3) [m/s] at the start of that step; None at a plain instant.
    """

    model: ModelView
    r: Array
    v: Array
    t: Array
    ends: Ends
    frozen: Mapping[str, Frozen] = field(default_factory=dict)
    h: Array | float | None = None
    before: Array | None = None
    _computed: dict[str, Any] = field(default_factory=dict, init=False)

    @property
    def line(self) -> Line:
        return self.model.line

    @property
    def sea(self) -> Sea:
        return self.model.needed_sea

    @property
    def free(self) -> int:
        """Number of free nodes."""
        return self.r.shape[0]

    def with_velocity(self, v: Array) -> Kinematics:
        """The same positions with other velocities of the free nodes."""
        return replace(self, v=v)

    def over(self, h: float) -> Kinematics:
        """The same as the middle of a steady step of h [s], for forces that are differences over a step."""
        return replace(self, h=h, before=self.v)

    def prepared(self, effect: Named) -> Frozen:
        """The result of the effect's `prepare` for this step."""
        return self.frozen[effect.name]

    def compute_once(self, name: str, compute: Callable[[], Any]) -> Any:
        """The value cached at this instant under that name, or computed now; for effects with several slots."""
        if name not in self._computed:
            self._computed[name] = compute()
        return self._computed[name]

    @property
    def water(self) -> Water:
        """The water around the free nodes, frozen over the step (see `dropper_jax.sea`)."""
        return self.frozen["water"]

    def node(self, line: str | int, j: int) -> int:
        """Number among the free nodes of node j (from 0, the line's first point) of a line, by name or number.

        Raises:
            ValueError: no such line or node, or the node is fixed.
        """
        return self.model.geometry.node(line, j)

    @cached_property
    def nodes(self) -> Array:
        """All nodes (n + lines, 3) [m]."""
        return self.model.geometry.nodes(self.r, self.ends.positions)

    @cached_property
    def links(self) -> Array:
        """Link vectors (n, 3) [m]."""
        return self.model.geometry.differences(self.r, self.ends.positions)

    @cached_property
    def link_velocities(self) -> Array:
        """Rates of the link vectors (n, 3) [m/s]."""
        return self.model.geometry.differences(self.v, self.ends.velocities)

    @cached_property
    def tangents(self) -> Array:
        """Unit vectors along the links (n, 3)."""
        return self.links / safe_norm(self.links)[:, None]

    @cached_property
    def angular_rates(self) -> Array:
        """Angular velocity of each link, without spin (n, 3) [rad/s]: `q x q'`."""
        return cross(self.tangents, self.link_velocities) / safe_norm(self.links)[:, None]
