"""MoorDyn's rope, whose damper also acts in a slack line."""

from __future__ import annotations

from jax import Array

from dropper_jax.axial.elastic import Elastic, StretchStep
from dropper_jax.axial.law import AxialLaw, LinkStart
from dropper_jax.axial.rope import Rope
from dropper_jax.base.fields import component


@component
class DampedRope(Rope):
    """Rope whose damper also acts when it is slack, and may push: `T = max(0, EA e) + BA e'`, as in MoorDyn.

    For comparisons: oscillations of slack lines then decay quickly, whereas those of a `Rope` chatter.
    """

    with_tangent = AxialLaw.with_tangent  # derivatives of its own rows
    # the dashpot of a spring, which also acts on slack links
    _lengthening = Elastic._lengthening
    _limit_damper = Elastic._limit_damper

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        step = StretchStep.of(self, start, length, h)
        damper = self._dashpot(step, self._size(d1, length))
        return self._taut_or_slack(lambda x: self._unclipped_spring(step, x), d1, tension - damper, length)

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        _, stretching = self._stretching(d, rate, length)
        if self.damping is not None:
            tension = tension - self.damping / length * stretching
        return self.at_rest(d, tension, length)
