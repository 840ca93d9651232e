"""What an effect may add to a model: one protocol for each slot; undefined slots add nothing to the program."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import scatter_add_many
from dropper_jax.base.records import Named
from dropper_jax.model.kinematics import Frozen, Kinematics, ModelView
from dropper_jax.model.line import Line
from dropper_jax.sea import Sea


@runtime_checkable
class Force(Named, Protocol):
    """A force on the free nodes."""

    @property
    def reach(self) -> int:
        """How many neighbouring nodes the force couples."""

    @property
    def constant(self) -> bool:
        """Whether it is independent of positions and velocities."""

    def force(self, k: Kinematics) -> Array:
        """Nodal force, (nodes, 3) [N]."""


@runtime_checkable
class Potential(Force, Protocol):
    """A conservative force: its energy is part of the balance; otherwise its work is."""

    @property
    def breaks_with_links(self) -> bool:
        """Whether a part of its potential is lost when a link breaks."""

    def potential(self, k: Kinematics) -> Array:
        """Energy whose negative gradient is `force`, scalar [J]."""


@runtime_checkable
class ElementForce(Force, Protocol):
    """A force of elements that act on a few nodes each, in systems of lines; their `force` is `sum_of_pieces`."""

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        """Nodes of each element (pieces, m), numbered as free nodes, then fixed points. Static."""

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        """Forces of the elements on their nodes (pieces, m, 3) [N], at positions r [m] and velocities v [m/s] of these.

        `k` provides the time, the step and the lines, not positions.
        """


@runtime_checkable
class LimitsTimeStep(Protocol):
    """Something that a step may miss, such as contact: steps with too large a motion are halved."""

    def too_far(self, before: Kinematics, after: Kinematics) -> Array:
        """Whether nodes moved farther over a step than the effect can follow, scalar; plain instants at its ends."""


@runtime_checkable
class AddedMass(Named, Protocol):
    """Inertia in addition to that of the lines."""

    @property
    def reach(self) -> int:
        """How many neighbouring nodes it couples."""

    def inertia(self, k: Kinematics, a: Array) -> Array:
        """Inertia force for nodal accelerations a (nodes, 3) [m/s^2], (nodes, 3) [N]."""

    def kinetic(self, k: Kinematics) -> Array:
        """Kinetic energy at a plain instant, scalar [J]."""


@runtime_checkable
class TurningMass(AddedMass, Protocol):
    """Added mass that turns with its link."""

    @property
    def may_gain_energy(self) -> bool:
        """Whether the form of its force may gain energy by turning."""

    def gains_energy(self) -> Array:
        """Whether it actually does so, according to its coefficients, scalar."""


@runtime_checkable
class Prepared(Named, Protocol):
    """Something expensive that may be frozen over a step."""

    def prepare(self, k: Kinematics) -> Frozen:
        """Evaluated once at the predicted middle of the step; `k.prepared(self)` returns the result."""


@runtime_checkable
class Stateful(Named, Protocol):
    """An internal state that a run changes, as for creep or wear: a tree of arrays `own`, constant over each step.

    A step uses `own` as it is at its start, and updates it at its end. A halved step does so at the end of each part.
    First order in the step.
    """

    def begin(self, model: ModelView) -> Frozen:
        """`own` at the start of a run."""

    def entered(self, state: Frozen) -> Stateful:
        """The effect as it acts during a step."""

    def advance(self, before: Kinematics, after: Kinematics, tension: Array, h: Array) -> Frozen:
        """`own` after a step h [s], at whose end the links carried `tension` (n,) [N]; called on `entered`."""


@runtime_checkable
class Displacement(Protocol):
    """A prescribed motion of fixed points."""

    @property
    def needs_sea(self) -> bool:
        """Whether `displace` takes the sea."""

    @property
    def kinks(self) -> Array | None:
        """Times (k,) [s] at which velocity or acceleration jump."""

    def moves(self, name: str) -> bool:
        """Whether the fixed point of that name moves."""

    def motion_of(self, name: str) -> Displacement:
        """The effect that moves the fixed point of that name."""

    def displace(self, t: Array, *sea: Sea | None) -> Array:
        """Displacement at time t, (3,) [m]; with `needs_sea` the sea is a second argument."""


@runtime_checkable
class LengthOverTime(Protocol):
    """Unstretched lengths that change in time; a model has at most one such effect."""

    def unstretched_lengths(self, line: Line, t: Array) -> Array:
        """Unstretched lengths of all links at time t [s], (n,) [m]; `line.length` where they do not change."""


@runtime_checkable
class PointMass(Protocol):
    """Constant mass at points of a system of lines."""

    def point_mass(self, model: ModelView) -> Array:
        """Mass that it adds to the free nodes, (nodes,) [kg]."""


@runtime_checkable
class CoupledMass(PointMass, Protocol):
    """Constant mass that couples nodes, in addition to the nodes' own `point_mass`."""

    def coupled(self, model: ModelView, a: Array) -> Array:
        """Inertia force (nodes, 3) [N] of accelerations a (nodes, 3) through the masses between nodes."""

    def with_known_mass(self) -> CoupledMass:
        """The same with its masses computed, for the equations of a step."""

    def node_size(self, model: ModelView) -> Array:
        """Length (nodes,) [m] assigned to nodes without links; scales residuals."""


@runtime_checkable
class ContactArea(Protocol):
    """Something at points that can lie on the seabed."""

    def contact_area(self, model: ModelView) -> Array:
        """Plan area that it adds to the free nodes, (nodes,) [m^2]."""


#: Slots that belong together: a class with the first needs the second.
PAIRS = (("potential", "force"), ("inertia", "kinetic"))


def at_pieces(k: Kinematics, nodes: np.ndarray) -> tuple[Array, Array]:
    """Positions [m] and velocities [m/s] (pieces, m, 3) of the nodes (pieces, m) of elements in a system of lines."""
    graph = k.model.geometry
    return graph.everywhere(k.r, k.ends.positions)[nodes], graph.everywhere(k.v, k.ends.velocities)[nodes]


def sum_of_pieces(effect: ElementForce, k: Kinematics) -> Array:
    """Nodal force (free nodes, 3) [N] of all elements; forces on fixed points are dropped."""
    nodes = effect.piece_nodes(k.model)
    force = effect.piece_force(k, *at_pieces(k, nodes))
    free = nodes.ravel() < k.free
    return scatter_add_many(nodes.ravel()[free], force.reshape(-1, 3)[np.flatnonzero(free)], k.free)
