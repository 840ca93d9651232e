"""Interface of an axial law: the relation between the length of a link and its tension."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.fields import component, option


class LinkStart(NamedTuple):
    """Links at the start of a step.

    Attributes:
        d: link vectors (n, 3) [m].
        rate: their rates (n, 3) [m/s]; None if no link stretches.
        acceleration: their mean second derivatives over the last step (n, 3) [m/s^2]; None if no memory is kept.
        lightness: sum of the inverse masses of the nodes at both ends of the links (n,) [1/kg], 0 for fixed ones; None
            without `acceleration`.
    """

    d: jax.Array
    rate: jax.Array | None
    acceleration: jax.Array | None = None
    lightness: jax.Array | None = None


class AxialLaw(ABC):
    """Base of the axial laws; d, d0, d1 are link vectors (n, 3) [m], now, before and after a step h [s]."""

    #: Whether the tensions of all links follow from lengths, so that `tension`, `instant` and the energy of stretch
    #: exist.
    elastic: ClassVar[bool]
    #: Whether the condensed matrix, of which links at the ends of a step are all, is good enough for the law.
    condensable: ClassVar[bool] = True

    #: (n,): 0 if the link has broken, else 1; None if no link can break.
    intact: ClassVar[jax.Array | None] = None

    def rigid(self, links: int) -> np.ndarray:
        """Which of the links (n,) are inextensible."""
        return np.full(links, not self.elastic)

    def stiffness(self, length: jax.Array) -> jax.Array:
        """`EA/L` (n,) [N/m] of taut links, zero for inextensible ones."""
        return jnp.zeros_like(length)

    def springs(self, EA: jax.Array, pushes: bool = False) -> AxialLaw:
        """The same law where it stretches; ropes, or springs that also push, of stiffness EA (n,) [N] in place of rigid
        links."""
        return self

    def soften(self, share: float) -> AxialLaw:
        """The law with that fraction of its stiffness."""
        return self

    def with_broken_links(self, intact: jax.Array) -> AxialLaw:
        """The law with broken links: `intact` (n,) is 0 for these, else 1."""
        return replace(self, intact=intact)

    @property
    def work_names(self) -> tuple[str, ...]:
        """The names under which the law takes energy."""
        return ()

    @abstractmethod
    def residual(
        self, start: LinkStart, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array
    ) -> jax.Array:
        """Residual of the law over a step, (n,) [m]: zero if the law holds. It depends on d1 through its length
        only."""

    @abstractmethod
    def at_rest(self, d: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        """Residual of the law for links at rest, (n,) [m]."""

    @abstractmethod
    def direction(self, d0: jax.Array, d1: jax.Array, mean: jax.Array, length: jax.Array) -> jax.Array:
        """Force direction of a unit tension over a step, (n, 3), whose work is exactly `T (|d1| - |d0|)`."""

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        """Stored energy, scalar [J]."""
        return jnp.zeros((), d.dtype)

    def works(self, start: LinkStart, d1: jax.Array, length: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        """Work over a step by name, scalars [J]; of a damper never positive."""
        return {}

    def drum_works(self, d0: jax.Array, d1: jax.Array, tension: jax.Array) -> dict[str, jax.Array]:
        """Work over a step by name, scalars [J], of drums that change the unstretched lengths of links under a tension
        (n,) [N]."""
        return {}

    def powers(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> dict[str, jax.Array]:
        """Power at one instant by name, scalars [W], of links stretching at `rate` (n, 3) [m/s] under a tension."""
        return {}


# Several axial laws in one system: rigid links, ropes, springs and tables, each for its own links


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

    @property
    def EA(self) -> jax.Array:
        """Axial stiffness (n,) [N]; only if all groups stretch."""
        return self._together([jnp.broadcast_to(law.EA, len(m)) for law, m in self._each()])

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
        """Only if all groups stretch."""
        return self._together([law.tension(d[m], rate[m], length[m]) for law, m in self._each()])

    def instant(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        """Only if all groups stretch."""
        return self._together([law.instant(d[m], rate[m], tension[m], length[m]) for law, m in self._each()])

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        return sum(law.energy(d[m], length[m]) for law, m in self._each())

    def works(self, start: LinkStart, d1: jax.Array, length: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        return self._add_tables([law.works(_of(start, m), d1[m], length[m], h) for law, m in self._each()])

    def powers(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> dict[str, jax.Array]:
        return self._add_tables([law.powers(d[m], rate[m], tension[m], length[m]) for law, m in self._each()])

    def _add_tables(self, tables: list[dict[str, jax.Array]]) -> dict[str, jax.Array]:
        return {name: sum(table[name] for table in tables if name in table) for name in self.work_names}


def _of(start: LinkStart, members: np.ndarray) -> LinkStart:
    return LinkStart(*(None if values is None else values[members] for values in start))
