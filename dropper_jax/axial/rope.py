"""Springs that go slack: what ropes and chains are."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.axial.elastic import Elastic
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import dot, safe_norm

AXIAL_RINGING = "axial_ringing"
#: How much a guessed stretch counts beside a guessed tension for whether a link is taut, any number in (0, 1].
STRETCH_COUNTS = 1e-3


def taut_or_slack(pull: jax.Array, held: jax.Array) -> jax.Array:
    """`max(pull, 0) = held` by active sets: rows of pull, and of a tension in terms of elongation, both (n,) [m]."""
    taut = held + STRETCH_COUNTS * (pull - held) > 0.0
    return jnp.where(taut, pull, 0.0) - held


@component
class Rope(Elastic):
    """Elastic link that goes slack: `T = max(0, EA e + BA (e - e0)/h)`, e the stretch per length, 0 where slack.

    The internal damping counts only what is stretched, so that it acts on a taut link alone, is continuous where a link
    tautens, and never holds a slack one (MoorDyn's damper stays on and pulls through a slack line).
    """

    def _pull(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """Tension over EA/L, (n,) [m]."""
        stretched = jnp.maximum(safe_norm(d1) - length, 0.0)
        if self.damping is None:
            return stretched
        before = jnp.maximum(safe_norm(d0) - length, 0.0)
        return jnp.maximum(stretched + self.damping / self.EA * (stretched - before) / h, 0.0)

    def residual(self, d0: jax.Array, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """The law of a taut link where the link counts as taut, else `-L T/EA`, (n,) [m].

        It counts as taut by its tension rather than by its stretch (primal-dual active set): a guess of the step is
        off by far more than links stretch, its tensions are good. Solutions are those of `_pull = L T/EA`.
        """
        d0, d1 = self.seen(d0, length), self.seen(d1, length)
        pull = safe_norm(d1) - length
        if self.damping is not None:
            pull = pull + self.damping / self.EA * (pull - jnp.maximum(safe_norm(d0) - length, 0.0)) / h
        return taut_or_slack(pull, length * tension / self.EA)

    def instant(
        self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array, since: jax.Array
    ) -> jax.Array:
        """The same at one instant. A link that tautened a moment ago has stretched by what it is longer, no more."""
        d, stretching = self._stretching(d, rate, length)
        pull = safe_norm(d) - length
        if self.damping is not None:
            pull = pull + self.damping / self.EA * jnp.minimum(stretching, jnp.maximum(pull, 0.0) / since)
        return taut_or_slack(pull, length * tension / self.EA)

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        size = safe_norm(d)
        pull = self.EA * (size - length) / length
        if self.damping is not None:
            pull = pull + self.damping / length * dot(d, rate) / size
        return self.kept(jnp.where(size > length, jnp.maximum(pull, 0.0), 0.0))

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        stretch = jnp.maximum(safe_norm(self.seen(d, length)) - length, 0.0)
        return jnp.sum(0.5 * self.EA / length * stretch**2)

    @property
    def work_names(self) -> tuple[str, ...]:
        return (*super().work_names, AXIAL_RINGING)

    def works(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        return {**super().works(d0, d1, length, h), AXIAL_RINGING: self.ringing_work(d0, d1, length)}

    def _damper(self, d: jax.Array, stretching: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        return tension - self.kept(self.spring(safe_norm(d), length))

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        d0, d1 = self.seen(d0, length), self.seen(d1, length)
        elastic = jnp.maximum(safe_norm(d1) - length, 0.0)
        extra = self.EA / length * (self._pull(d0, d1, length, h) - elastic)
        return -jnp.sum(extra * (safe_norm(d1) - safe_norm(d0)))

    def spring(self, size: jax.Array, length: jax.Array) -> jax.Array:
        """Tension (n,) [N] without damping of links of length `size` (n,) [m]."""
        return self.EA / length * jnp.maximum(size - length, 0.0)

    def ringing_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array) -> jax.Array:
        """What the law at the end of the step takes beyond the internal damping, scalar [J], never positive.

        `psi(d1) - psi(d0) - T_elastic(d1) (|d1| - |d0|)`, psi the stored energy, which is convex. This is how axial
        ringing that the step cannot resolve, and the snap of a slack link, are lost.
        """
        d0, d1 = self.seen(d0, length), self.seen(d1, length)
        change = jnp.sum(self.spring(safe_norm(d1), length) * (safe_norm(d1) - safe_norm(d0)))
        return self.energy(d1, length) - self.energy(d0, length) - change
