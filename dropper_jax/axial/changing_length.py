"""Links whose unstretched length changes in time: the law of each link, with the lengths of an instant or of a step."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial.law import AxialLaw, LinkStart, SlackTangent
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import safe_norm

#: Name under which the work of drums is recorded.
LENGTH_IN_TIME = "length_in_time"


@component
class ChangingLength(AxialLaw):
    """A law whose tension follows from the elongation `e = |d| - L(t)` and its rate `d|d|/dt - dL/dt`.

    Over a step the law acts with the mean of both lengths, on links as long as that mean plus their elongation, so that
    the change of its energy at that length is exactly `S (e1 - e0)`, S the tension of the spring. The rest of the
    change of energy, and `-T (L1 - L0)`, are the work of the drum: the balance closes to rounding. Its definition is
    the power `dE/dt` at constant elongation, `- T dL/dt`, to second order in the step.

    Attributes:
        law: the law at a constant length.
        before, after: unstretched lengths (n,) [m] at the start and at the end of a step; equal at an instant.
        rate: their rate (n,) [m/s], over a step its mean.
    """

    law: AxialLaw
    before: Array
    after: Array
    rate: Array

    @property
    def elastic(self) -> bool:
        return self.law.elastic

    @property
    def intact(self) -> Array | None:
        return self.law.intact

    @property
    def work_names(self) -> tuple[str, ...]:
        return self.law.work_names

    @property
    def _middle(self) -> Array:
        return 0.5 * (self.before + self.after)

    def axial_stiffness(self) -> Array | float:
        return self.law.axial_stiffness()

    def rigid(self, links: int) -> np.ndarray:
        return self.law.rigid(links)

    def springs(self, EA: Array, pushes: bool = False) -> AxialLaw:
        return replace(self, law=self.law.springs(EA, pushes))

    def soften(self, share: float) -> AxialLaw:
        return replace(self, law=self.law.soften(share))

    def with_tangent(self, tangent: SlackTangent) -> AxialLaw:
        return replace(self, law=self.law.with_tangent(tangent))

    def with_broken_links(self, intact: Array) -> AxialLaw:
        return replace(self, law=self.law.with_broken_links(intact))

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        return self.law.residual(self._start(start), self._end(d1), tension, self._middle, h)

    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        return self.law.at_rest(d, tension, self.after)

    def direction(self, d0: Array, d1: Array, mean: Array, length: Array) -> Array:
        return self.law.direction(d0, d1, mean, length)

    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        return self.law.tension(d, self._elongating(d, rate), self.after)

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        return self.law.instant(d, self._elongating(d, rate), tension, self.after)

    def energy(self, d: Array, length: Array) -> Array:
        return self.law.energy(d, self.after)

    def works(self, start: LinkStart, d1: Array, length: Array, h: Array) -> dict[str, Array]:
        return self.law.works(self._start(start), self._end(d1), self._middle, h)

    def drum_works(self, d0: Array, d1: Array, tension: Array) -> dict[str, Array]:
        law = self.law
        middle = self._middle
        stored = law.energy(d1, self.after) - law.energy(d0, self.before)
        by_elongation = law.energy(self._end(d1), middle) - law.energy(_lengthened(d0, middle - self.before), middle)
        return {LENGTH_IN_TIME: stored - by_elongation - jnp.sum(tension * (self.after - self.before))}

    def powers(self, d: Array, rate: Array, tension: Array, length: Array) -> dict[str, Array]:
        now = self.after

        def energy(longer: Array) -> Array:
            return self.law.energy(_lengthened(d, longer), now + longer)

        constant_elongation = jax.jvp(energy, (jnp.zeros_like(now),), (self.rate,))[1]
        own = self.law.powers(d, self._elongating(d, rate), tension, now)
        return {**own, LENGTH_IN_TIME: constant_elongation - jnp.sum(tension * self.rate)}

    def _elongating(self, d: Array, rate: Array) -> Array:
        """Rates (n, 3) [m/s] whose part along the links is the rate of their elongation."""
        return rate - (self.rate / safe_norm(d))[:, None] * d

    def _start(self, start: LinkStart) -> LinkStart:
        if start.rate is None:
            return start
        moved = _lengthened(start.d, self._middle - self.before)
        return start._replace(d=moved, rate=self._elongating(start.d, start.rate))

    def _end(self, d1: Array) -> Array:
        return _lengthened(d1, self._middle - self.after)


def _lengthened(d: Array, longer: Array) -> Array:
    """Link vectors (n, 3) [m] whose lengths are greater by `longer` (n,) [m]."""
    return d + (longer / safe_norm(d))[:, None] * d
