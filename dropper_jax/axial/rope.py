"""Springs that go slack: ropes and chains."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from dropper_jax.axial.elastic import Elastic, StretchStep
from dropper_jax.axial.law import AxialLaw, LinkStart, SlackTangent
from dropper_jax.base.fields import component, option
from dropper_jax.base.numerics import dot, positive_part, safe_norm
from dropper_jax.base.springs import limit_damper, mean_positive_part

#: Bound of the tension over a step that goes slack, over the tension of the spring at its end. Larger ones take effect
#: closer to the slack length, but have a steeper slope there.
MAX_TENSION_RATIO = 10.0
#: Weight of a guessed stretch relative to a guessed tension in deciding whether a link is taut, any number in (0, 1].
STRETCH_WEIGHT = 1e-3


def taut_or_slack(stretch: Callable[[Array], Array], size: Array, slack: Array, held: Array) -> Array:
    """`max(stretch(size), 0) = held` (n,) [m] by active sets; `stretch` rises and has a kink at the length `slack` [m].

    The side of the kink on which a link lies follows from its tension (`held`) rather than from its stretch
    (primal-dual active set). The stretch of a guessed step is off by far more than links stretch, whereas its tensions
    are good.
    """
    at = jnp.maximum(stretch(slack), 0.0)
    beyond = size - slack
    above = stretch(jnp.maximum(size, slack)) + jnp.minimum(beyond, 0.0)
    taut = held - at + STRETCH_WEIGHT * (above - at) > 0.0
    return jnp.where(taut, above, jnp.maximum(stretch(jnp.minimum(size, slack)), 0.0)) - held


@component
class Rope(Elastic):
    """Elastic link that goes slack: `T = S + clip(BA e', -S, S)`, S = EA max(e, 0), e = (|d| - L)/L.

    The internal damping force never exceeds the spring force. The tension is therefore continuous when a link tautens,
    at any speed. A separate dashpot would jump from 0 to BA e', and peaks would depend on the step. A rope never
    pushes, a slack rope carries no force, and the damper only takes energy. A link that is taut and vibrates with less
    than its mean stretch has the damping of `elastic`. For MoorDyn's damper, which also acts in slack lines, see
    `damped_rope`.

    A subclass whose slack rows differ from these keeps its own derivatives: its `with_tangent` is that of `AxialLaw`.
    """

    def with_tangent(self, tangent: SlackTangent) -> AxialLaw:
        return TangentRope(EA=self.EA, damping=self.damping, intact=self.intact, tangent=tangent)

    def spring(self, size: Array, length: Array) -> Array:
        return self.EA / length * positive_part(size - length)

    def _slack(self, length: Array) -> Array:
        """Maximum length (n,) [m] of slack links."""
        return length

    def _elongation(self, size: Array, length: Array) -> Array:
        """Elongation (n,) [m] of taut links."""
        return positive_part(size - self._slack(length))

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        step = StretchStep.of(self, start, length, h)

        def tension_of(size: Array) -> Array:
            spring = self._unclipped_spring(step, size)
            return spring + jnp.minimum(self._dashpot(step, size), spring)

        return self._taut_or_slack(tension_of, d1, tension, length)

    def _taut_or_slack(self, tension_of: Callable[[Array], Array], d: Array, tension: Array, length: Array) -> Array:
        """`max(tension_of(size), 0) = T` of links d, as elongations (n,) [m]."""
        size = self._size(d, length)
        elongation = length * tension / self.EA
        return taut_or_slack(lambda x: length / self.EA * tension_of(x), size, self._slack(length), elongation)

    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        return self._taut_or_slack(lambda size: self.spring(size, length), d, tension, length)

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        _, stretching = self._stretching(d, rate, length)
        damper = 0.0 if self.damping is None else self.damping / length * stretching

        def tension_of(size: Array) -> Array:
            spring = self.spring(size, length)
            return spring + jnp.minimum(damper, spring)

        return self._taut_or_slack(tension_of, d, tension, length)

    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        size = safe_norm(d)
        tension = self.spring(size, length)
        if self.damping is not None:
            stretching = dot(d, rate) / size
            tension = tension + self._limit_damper(self.damping / length * stretching, tension)
        return self.zero_broken(tension)

    def _damper(self, damping: Array, d: Array, stretching: Array, tension: Array, length: Array) -> Array:
        return tension - self.zero_broken(self.spring(safe_norm(d), length))

    def _stored_energy(self, size: Array, length: Array) -> Array:
        return 0.5 * self.EA / length * jnp.maximum(size - length, 0.0) ** 2

    def _mean(self, step: StretchStep, size: Array) -> Array:
        return self.EA / step.length * mean_positive_part(step.size - step.length, size - step.length)

    def _unclipped_spring(self, step: StretchStep, size: Array) -> Array:
        """Spring tension over a step, zero if it ends slack; the ringing force may make it negative.

        A mean over the step alone would leave a force in a link that was taut and ends slack, so that its tension did
        not tell on which side of the kink it ends (`taut_or_slack`).
        """
        mean = self._mean(step, size)
        # a link that tautens has no vibration yet: with its slack accelerations peaks were 30 % off
        was_taut = step.size > self._slack(step.length)
        ringing = jnp.where(was_taut, self._ringing(step, size), 0.0)
        spring = mean + jnp.minimum(ringing, mean)
        return jnp.minimum(spring, MAX_TENSION_RATIO * self.spring(size, step.length))

    def _spring_over(self, step: StretchStep, size: Array) -> Array:
        return jnp.maximum(self._unclipped_spring(step, size), 0.0)

    def _lengthening(self, step: StretchStep, size: Array) -> Array:
        """That of the taut part: the dashpot does not act on slack links."""
        return self._elongation(size, step.length) - self._elongation(step.size, step.length)

    def _limit_damper(self, dashpot: Array, spring: Array) -> Array:
        return limit_damper(dashpot, spring)


@component
class TangentRope(Rope):
    """A rope for derivatives alone: where it ends a step slack, its row has the slopes of a `SlackTangent`."""

    tangent: SlackTangent = option("law of derivatives", default=SlackTangent())

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        before = self._size(start.d, length)
        size = self._size(d1, length)
        elongation = 0.5 * (before + size) - length + self.tangent.time * (size - before) / h
        soft = self.tangent.stiffness * elongation - length * tension / self.EA
        return jnp.where(size <= length, soft, super().residual(start, d1, tension, length, h))
