"""Several axial laws in one system: rigid links, ropes, springs and tables, each for its own links."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial.law import AxialLaw, LinkStart, SlackTangent, sum_works
from dropper_jax.base.fields import component, option

#: A result of a method of a law.
Result = TypeVar("Result")


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
    def intact(self) -> Array | None:
        known = [law.intact for law in self.laws if law.intact is not None]
        if not known:
            return None
        found = []
        for law, m in self._each():
            if law.intact is None:  # of rigid links, which do not break
                found.append(jnp.ones(len(m), known[0].dtype))
            else:
                found.append(law.intact)
        return self._in_link_order(found)

    def axial_stiffness(self) -> Array:
        return self._in_link_order(jnp.broadcast_to(law.axial_stiffness(), len(m)) for law, m in self._each())

    def _each(self) -> Iterator[tuple[AxialLaw, np.ndarray]]:
        """Each law and the indices of its links."""
        return zip(self.laws, map(np.array, self.members), strict=True)

    def _in_link_order(self, found: Iterable[Array]) -> Array:
        """Values of the groups in the order of the links."""
        return jnp.concatenate(list(found))[np.argsort(np.concatenate(self.members))]

    def _results(self, call: Callable[..., Result], *of_links: Any) -> list[Result]:
        """Results of a method of each law for its own links."""
        found = []
        for law, m in self._each():
            own = jax.tree.map(operator.itemgetter(m), of_links)
            found.append(call(law, *own))
        return found

    def _change_each(self, change: Callable[[AxialLaw, np.ndarray], AxialLaw]) -> Groups:
        return replace(self, laws=tuple(change(law, m) for law, m in self._each()))

    def rigid(self, links: int) -> np.ndarray:
        found = np.zeros(links, bool)
        for law, m in self._each():
            found[m] = law.rigid(len(m))
        return found

    def springs(self, EA: Array, pushes: bool = False) -> AxialLaw:
        return self._change_each(lambda law, m: law.springs(EA[m], pushes))

    def soften(self, share: float) -> AxialLaw:
        return self._change_each(lambda law, _: law.soften(share))

    def with_tangent(self, tangent: SlackTangent) -> AxialLaw:
        return self._change_each(lambda law, _: law.with_tangent(tangent))

    def with_broken_links(self, intact: Array) -> AxialLaw:
        return self._change_each(lambda law, m: law.with_broken_links(intact[m]))

    @property
    def work_names(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for law in self.laws for name in law.work_names))

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        results = self._results(lambda law, *own: law.residual(*own, h), start, d1, tension, length)
        return self._in_link_order(results)

    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        return self._in_link_order(self._results(lambda law, *own: law.at_rest(*own), d, tension, length))

    def direction(self, d0: Array, d1: Array, mean: Array, length: Array) -> Array:
        return self._in_link_order(self._results(lambda law, *own: law.direction(*own), d0, d1, mean, length))

    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        return self._in_link_order(self._results(lambda law, *own: law.tension(*own), d, rate, length))

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        return self._in_link_order(self._results(lambda law, *own: law.instant(*own), d, rate, tension, length))

    def energy(self, d: Array, length: Array) -> Array:
        return sum(self._results(lambda law, *own: law.energy(*own), d, length), jnp.zeros((), d.dtype))

    def works(self, start: LinkStart, d1: Array, length: Array, h: Array) -> dict[str, Array]:
        return sum_works(self._results(lambda law, *own: law.works(*own, h), start, d1, length))

    def powers(self, d: Array, rate: Array, tension: Array, length: Array) -> dict[str, Array]:
        return sum_works(self._results(lambda law, *own: law.powers(*own), d, rate, tension, length))
