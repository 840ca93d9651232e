"""Interface of an axial law: the relation between the length of a link and its tension."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

#: Work [J] or power [W], scalars by name.
Works = Mapping[str, Array]


def sum_works(tables: Iterable[Works]) -> dict[str, Array]:
    """Sums by name; a table has no entry for what does no work."""
    total: dict[str, Array] = {}
    for table in tables:
        for name, work in table.items():
            if name in total:
                work = total[name] + work
            total[name] = work
    return total


class LinkStart(NamedTuple):
    """Links at the start of a step.

    Attributes:
        d: link vectors (n, 3) [m].
        rate: their rates (n, 3) [m/s]; None if no link stretches.
        acceleration: their mean second derivatives over the last step (n, 3) [m/s^2]; None if no memory is kept.
        inverse_reduced_mass: sum of 1/m of the nodes at both ends of the links (n,) [1/kg], 0 for fixed ones; None
            without `acceleration`.
    """

    d: Array
    rate: Array | None
    acceleration: Array | None = None
    inverse_reduced_mass: Array | None = None


@dataclass(frozen=True)
class SlackTangent:
    """The law of slack ropes in derivatives of a run, `L/EA dT = s (d|l| + tau d|l|'/dt - dL)`; the run is unchanged.

    Exact derivatives of a slack rope have s = 0, and grow by up to e^16 per second while it is slack: nothing restrains
    its nodes, of whose motion no trace is left once it is taut again.

    Attributes:
        stiffness: s. A rope that lies on the ground allows little: a slope of its mean tension is 10 % off with 0.1,
            and 1 to 2 % with 0.01 to 0.03.
        time: tau [s]. It damps vibrations of the slack rope whose frequency is above 1/tau; with 0.01 s and s = 0.01
            they still grow.
    """

    stiffness: float = 0.03
    time: float = 0.03


class AxialLaw(ABC):
    """Base of the axial laws of n links.

    In all methods d, d0 and d1 are link vectors (n, 3) [m], now, before and after a step h [s]; `length` (n,) [m] are
    unstretched lengths, `tension` (n,) is in N, and `rate` (n, 3) [m/s] are the rates of the link vectors.
    """

    @property
    @abstractmethod
    def elastic(self) -> bool:
        """Whether the tensions of all links follow from lengths: `instant` and the energy exist."""

    @property
    def intact(self) -> Array | None:
        """(n,): 0 if the link has broken, else 1; None if no link can break."""
        return None

    def zero_broken(self, per_link: Array) -> Array:
        """Values (n,) of links, zero for broken ones."""
        intact = self.intact
        if intact is None:
            return per_link
        return intact * per_link

    def axial_stiffness(self) -> Array | float:
        """EA (n,) [N], or one number; zero for links that do not stretch."""
        return 0.0

    def rigid(self, links: int) -> np.ndarray:
        """Which of the links (n,) are inextensible."""
        return np.full(links, not self.elastic)

    def springs(self, EA: Array, pushes: bool = False) -> AxialLaw:
        """The law of links that stretch; for rigid ones that of ropes of stiffness EA (n,) [N], with `pushes` that of
        springs."""
        return self

    def soften(self, share: float) -> AxialLaw:
        """The law with that fraction of its stiffness."""
        return self

    def with_tangent(self, tangent: SlackTangent) -> AxialLaw:
        """The law whose derivatives are those of `tangent` where a rope is slack."""
        return self

    def with_broken_links(self, intact: Array) -> AxialLaw:
        """The law with broken links: `intact` (n,) is 0 for these, else 1."""
        return self

    @property
    def work_names(self) -> tuple[str, ...]:
        """The names under which the law books work."""
        return ()

    @abstractmethod
    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        """Residual of the law over a step, (n,) [m]: zero if the law holds; a function of the length of d1 alone."""

    @abstractmethod
    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        """Residual of the law for links at rest, (n,) [m]."""

    @abstractmethod
    def direction(self, d0: Array, d1: Array, mean: Array, length: Array) -> Array:
        """Force direction of a unit tension over a step, (n, 3), whose work is exactly `T (|d1| - |d0|)`."""

    @abstractmethod
    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        """Tension (n,) [N] of links d stretching at d' = `rate`; zero for inextensible ones."""

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        """The law at one instant, (n,) [m]: of links d that stretch at d' = `rate` (n, 3) [m/s]."""
        raise NotImplementedError

    def energy(self, d: Array, length: Array) -> Array:
        """Stored energy, scalar [J]."""
        return jnp.zeros((), d.dtype)

    def works(self, start: LinkStart, d1: Array, length: Array, h: Array) -> dict[str, Array]:
        """Work over a step by name, scalars [J]; of a damper never positive."""
        return {}

    def drum_works(self, d0: Array, d1: Array, tension: Array) -> dict[str, Array]:
        """Work over a step by name, scalars [J], of drums that change the unstretched lengths of links under a tension
        (n,) [N]."""
        return {}

    def powers(self, d: Array, rate: Array, tension: Array, length: Array) -> dict[str, Array]:
        """Power at one instant by name, scalars [W], of links stretching at `rate` (n, 3) [m/s] under a tension."""
        return {}
