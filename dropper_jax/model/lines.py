"""Many lines joined at points, behind the interface of one: effects, steps and statics do not see the difference.

`Lines` is a `Line` whose arrays hold all links of all lines one after another; `System` is a `Model` of such
lines. In a system each link's mass, weight and water forces are shared in halves by its two ends
(lumped mass, as in MoorDyn).
"""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component, option
from dropper_jax.model.geometry import Ends
from dropper_jax.model.graph import Graph
from dropper_jax.model.line import Line
from dropper_jax.model.model import Model, named
from dropper_jax.model.shares import Part
from dropper_jax.model.slots import PointMass


class End(Part):
    """One end of all links: rows are links, node by node sums are gathers over the graph."""

    def __init__(self, graph: Graph, last: bool) -> None:
        self.graph, self.last, self.share = graph, last, 0.5
        node = graph.last if last else graph.first
        self._node = np.minimum(node, max(graph.free - 1, 0))  # held nodes take any value: nothing is collected there

    def take(self, per_link: jax.Array) -> jax.Array:
        return per_link

    def at(self, nodal: jax.Array) -> jax.Array:
        return nodal[self._node]

    def collect(self, rows: jax.Array) -> jax.Array:
        return self.graph.from_last(rows) if self.last else self.graph.from_first(rows)


@component
class Lines(Line):
    """All lines of a system in one: arrays per link (n,), line after line."""

    graph: Graph = option("how the lines join", default=Graph((), ()))

    @property
    def compound(self) -> bool:
        return False

    def blocks(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        half = 0.5 * self.mass
        return half, jnp.zeros_like(half), half

    def node_share(self, per_link: jax.Array, free: int) -> jax.Array:
        return self.graph.shared(per_link)

    def node_mass(self, free: int) -> jax.Array:
        return self.graph.shared(self.mass)

    def inertia_force(self, a: jax.Array, start: jax.Array | None, end: jax.Array | None, held: bool) -> jax.Array:
        return self.node_mass(a.shape[0])[:, None] * a

    def parts(self, free: int) -> Iterator[Part]:
        yield End(self.graph, last=True)
        yield End(self.graph, last=False)


@component
class System(Model):
    """Lines joined at points. `ends` holds the held points: positions (held, 3) in `start`, velocities likewise."""

    @property
    def branched(self) -> bool:
        return True

    @property
    def graph(self) -> Graph:
        return self.line.graph

    @property
    def end_held(self) -> bool:
        return True  # nothing here ends freely: a free end is a free point

    @property
    def free_nodes(self) -> int:
        return self.graph.free

    @property
    def node_length(self) -> jax.Array:
        links = self.graph.from_first(self.line.length) + self.graph.from_last(self.line.length)
        count = self.graph.from_first(jnp.ones_like(self.line.length)) + self.graph.from_last(
            jnp.ones_like(self.line.length)
        )
        return links / jnp.maximum(count, 1.0)

    @property
    def node_mass(self) -> jax.Array:
        own = self.line.node_mass(self.free_nodes)
        return sum((e.point_mass(self) for e in self.having(PointMass)), own)

    def _ends(self, time: jax.Array) -> Ends:
        held = [self._position(int(i), time) for i in self.graph.held_points]
        return Ends(jnp.stack(held) if held else jnp.zeros((0, 3), self.dtype), None)

    def differences(self, free: jax.Array, ends: Ends | None, rates: bool = False) -> jax.Array:
        held = None if ends is None else ends.start_velocity if rates else ends.start
        return self.graph.differences(free, held)

    def node_numbers(self, line: str | int) -> np.ndarray:
        return self.graph.paths[named(line, [m.name for m in self.graph.members])]

    def nodes(self, r: jax.Array, ends: Ends, rates: bool = False) -> jax.Array:
        """Nodes of all lines, line after line, both ends of each included (n + lines, 3)."""
        field = self.graph.everywhere(r, ends.start_velocity if rates else ends.start)
        return field[np.concatenate(self.graph.paths)]

    def pull(self, tension: jax.Array, direction: jax.Array) -> jax.Array:
        return self.graph.gather(tension[:, None] * direction)

    def gather(self, pull: jax.Array) -> jax.Array:
        return self.graph.gather(pull)

    def own_inertia(self, a: jax.Array, ends: Ends | None = None) -> jax.Array:
        return self.node_mass[:, None] * a

    def held_pull(self, pull: jax.Array) -> jax.Array:
        """Sum of what links pull (n, 3) on each held point (held, 3) [N]."""
        graph, rows = self.graph, []
        for i in graph.held_points:
            node = graph.point_node[i]
            leaving, arriving = np.flatnonzero(graph.first == node), np.flatnonzero(graph.last == node)
            rows.append(jnp.sum(pull[leaving], axis=0) - jnp.sum(pull[arriving], axis=0))
        return jnp.stack(rows) if rows else jnp.zeros((0, 3), pull.dtype)

    def end_power(self, pull: jax.Array, rates: Ends) -> jax.Array:
        return -jnp.sum(self.held_pull(pull) * rates.start_velocity)
