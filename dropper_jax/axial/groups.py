"""Several axial laws in one system: rigid links, ropes, springs and tables, each for its own links."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.axial.law import AxialLaw, LinkStart, SlackTangent
from dropper_jax.base.fields import component, option


@component
class Groups(AxialLaw):
    """Each link follows its own law; a scene whose lines all share a law uses that law alone.

    Attributes:
        laws: one per group.
        members: indices of the links of each group; every link is in exactly one group.
    """

    laws: tuple[AxialLaw, ...]
    members: tuple[tuple[int, ...], ...] = option("links of each group")

    @property
    def elastic(self) -> bool:
        return all(law.elastic for law in self.laws)

    @property
    def condensable(self) -> bool:
        return all(law.condensable for law in self.laws)

    @property
    def intact(self) -> jax.Array | None:
        if all(law.intact is None for law in self.laws):
            return None
        return self._together([jnp.ones(len(m)) if law.intact is None else law.intact for law, m in self._each()])

    def axial_stiffness(self) -> jax.Array:
        return self._together([jnp.broadcast_to(law.axial_stiffness(), len(m)) for law, m in self._each()])

    def _each(self) -> Iterator[tuple[AxialLaw, np.ndarray]]:
        return zip(self.laws, map(np.array, self.members), strict=True)

    def _together(self, found: list[jax.Array]) -> jax.Array:
        """Values of the groups in the order of the links."""
        return jnp.concatenate(found)[np.argsort(np.concatenate(self.members))]

    def _change_each(self, change: Callable[[AxialLaw, np.ndarray], AxialLaw]) -> Groups:
        return replace(self, laws=tuple(change(law, m) for law, m in self._each()))

    def rigid(self, links: int) -> np.ndarray:
        found = np.zeros(links, bool)
        for law, m in self._each():
            found[m] = law.rigid(len(m))
        return found

    def stiffness(self, length: jax.Array) -> jax.Array:
        return self._together([law.stiffness(length[m]) for law, m in self._each()])

    def springs(self, EA: jax.Array, pushes: bool = False) -> AxialLaw:
        return self._change_each(lambda law, m: law.springs(EA[m], pushes))

    def soften(self, share: float) -> AxialLaw:
        return self._change_each(lambda law, _: law.soften(share))

    def with_tangent(self, tangent: SlackTangent) -> AxialLaw:
        return self._change_each(lambda law, _: law.with_tangent(tangent))

    def with_broken_links(self, intact: jax.Array) -> AxialLaw:
        return self._change_each(lambda law, m: law.with_broken_links(intact[m]))

    @property
    def work_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for law in self.laws for name in law.work_names))

    def residual(
        self, start: LinkStart, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array
    ) -> jax.Array:
        return self._together([law.residual(_of(start, m), d1[m], tension[m], length[m], h) for law, m in self._each()])

    def at_rest(self, d: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        return self._together([law.at_rest(d[m], tension[m], length[m]) for law, m in self._each()])

    def direction(self, d0: jax.Array, d1: jax.Array, mean: jax.Array, length: jax.Array) -> jax.Array:
        return self._together([law.direction(d0[m], d1[m], mean[m], length[m]) for law, m in self._each()])

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        return self._together([law.tension(d[m], rate[m], length[m]) for law, m in self._each()])

    def instant(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        return self._together([law.instant(d[m], rate[m], tension[m], length[m]) for law, m in self._each()])

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        return sum((law.energy(d[m], length[m]) for law, m in self._each()), jnp.zeros((), d.dtype))

    def works(self, start: LinkStart, d1: jax.Array, length: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        return self._add_tables([law.works(_of(start, m), d1[m], length[m], h) for law, m in self._each()])

    def powers(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> dict[str, jax.Array]:
        return self._add_tables([law.powers(d[m], rate[m], tension[m], length[m]) for law, m in self._each()])

    def _add_tables(self, tables: list[dict[str, jax.Array]]) -> dict[str, jax.Array]:
        found = {}
        for name in self.work_names:
            found[name] = functools.reduce(operator.add, [table[name] for table in tables if name in table])
        return found


def _of(start: LinkStart, members: np.ndarray) -> LinkStart:
    return jax.tree.map(lambda values: values[members], start)
