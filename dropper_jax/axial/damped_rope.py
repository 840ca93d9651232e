"""MoorDyn's rope, whose damper works on in a slack line."""

from __future__ import annotations

from typing import ClassVar

import jax

from dropper_jax.axial.elastic import Elastic
from dropper_jax.axial.rope import Rope, taut_or_slack
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import safe_norm


@component
class DampedRope(Rope):
    """Rope whose damper works on when it is slack, and may push: `T = max(0, EA e) + BA e'`, as in MoorDyn.

    For comparisons: slack lines then calm down fast, where those of a `Rope` chatter.
    """

    condensable: ClassVar[bool] = False  # where a link is slack the damper is all of its row, and not in `gradient`

    def residual(self, d0: jax.Array, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        size = safe_norm(self.seen(d1, length))
        return self._row(size, (size - safe_norm(self.seen(d0, length))) / h, tension, length)

    def instant(
        self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array, since: jax.Array
    ) -> jax.Array:
        d, stretching = self._stretching(d, rate, length)
        return self._row(safe_norm(d), stretching, tension, length)

    def _row(self, size: jax.Array, stretching: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        held = length * tension / self.EA
        if self.damping is not None:
            held = held - self.damping / self.EA * stretching
        return taut_or_slack(size - length, held)

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        d, stretching = self._stretching(d, rate, length)
        pull = self.spring(safe_norm(d), length)
        return pull if self.damping is None else pull + self.damping / length * stretching

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        return Elastic.damping_work(self, d0, d1, length, h)
