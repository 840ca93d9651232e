"""Springs with internal damping that can also push."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.axial.law import AxialLaw, LinkStart
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import dot, safe_norm

INTERNAL_DAMPING = "internal_damping"
AXIAL_RINGING = "axial_ringing"
#: Highest angular frequency of a line times the step above which its vibrations are damped. From 2 on the midpoint rule
#: turns them by more than a quarter per step. With 2 the hard case of a snapping rope, at 2.5, is off by 2.3 % in place
#: of 1.8 %.
UNRESOLVED_FREQUENCY = 3.0
#: Inertia of a link against stretching, over `w EA/L h^2`: it bounds the frequency of what a step cannot resolve.
RINGING_INERTIA = 1 / 16
#: Weight of the acceleration of the last step where no vibration of the link is resolved. Over a step infinitely stiff
#: vibrations have the factors of `(y + 1/3) (y^2 + y + 2/5)`: they shrink by sqrt(2/5).
RINGING_MEMORY = 1 / 24


@component
class Elastic(AxialLaw):
    """Elastic link with internal damping: `T = EA (|d| - L)/L + BA d|d|/dt / L`.

    `EA` is the axial stiffness [N]. `damping` is BA [N s] (the paper's internal damping, its section 3.1).
    The link also pushes: a line that can go slack is a `Rope`.
    """

    elastic = True
    EA: Array = parameter("axial stiffness", unit="N", shape="link", above=0.0)
    damping: Array | None = parameter("internal damping BA", unit="N s", shape="link", low=0.0, default=None)
    intact: Array | None = None  # (n,): 0 if the link has broken (see `failure`), else 1

    @property
    def work_names(self) -> tuple[str, ...]:
        if self.damping is None:
            return (AXIAL_RINGING,)
        return (INTERNAL_DAMPING, AXIAL_RINGING)

    def axial_stiffness(self) -> Array:
        return self.EA

    def soften(self, share: float) -> AxialLaw:
        return replace(self, EA=share * self.EA)

    def with_broken_links(self, intact: Array) -> AxialLaw:
        return replace(self, intact=intact)

    def unstretch_broken(self, d: Array, length: Array) -> Array:
        """Link vectors (n, 3) [m] as the law uses them: a broken link is unstretched."""
        if self.intact is None:
            return d
        return jnp.where(self.intact[:, None] > 0.0, d, length[:, None] * jnp.eye(1, 3, dtype=d.dtype))

    def spring(self, size: Array, length: Array) -> Array:
        """Tension (n,) [N] of links of length `size` (n,) [m], without damping."""
        return self.EA / length * (size - length)

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        """`L/EA (S + R + D - T)` (n,) [m]: mean force of the spring over the step, ringing force, and damper force.

        `S (|d1| - |d0|)` is the change of the stored energy. The rigid limit is EA -> infinity.
        """
        step = StretchStep.of(self, start, length, h)
        size = self._size(d1, length)
        spring = self._spring_over(step, size)
        damper = self._limit_damper(self._dashpot(step, size), spring)
        return length / self.EA * (spring + damper - tension)

    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        return self._size(d, length) - length - length * tension / self.EA

    def _size(self, d: Array, length: Array) -> Array:
        """Lengths (n,) [m] of link vectors d (n, 3) [m] as the law uses them."""
        return safe_norm(self.unstretch_broken(d, length))

    def _mean(self, step: StretchStep, size: Array) -> Array:
        """Tension (n,) [N] whose work over a step is exactly the change of the stored energy."""
        return self.spring(0.5 * (step.size + size), step.length)

    def _spring_over(self, step: StretchStep, size: Array) -> Array:
        """Spring tension (n,) [N] over a step that ends with links of length `size` (n,) [m]."""
        return self._mean(step, size) + self._ringing(step, size)

    def _stiffness(self, step: StretchStep) -> Array:
        """Stiffness (n,) [N/m] at the start of a step."""
        return self.EA / step.length

    def _ringing(self, step: StretchStep, size: Array) -> Array:
        """Ringing force `R = w EA/L h^2 (a1/16 + a0/24)` (n,) [N], a1 and a0 the accelerations of the length in this
        step and in the last one.

        Each axial vibration of angular frequency omega has the damping ratio `w (omega h)^3/48` if the step resolves
        it, and shrinks by sqrt(2/5) per step if not. w is 0 if the step resolves all vibrations of the link.
        """
        inertia = 2.0 * RINGING_INERTIA * (size - step.expected)
        return self._stiffness(step) * step.weight * (inertia + RINGING_MEMORY * step.memory)

    def _lengthening(self, step: StretchStep, size: Array) -> Array:
        """Lengthening (n,) [m] over a step that acts on the dashpot."""
        return size - step.size

    def _dashpot(self, step: StretchStep, size: Array) -> Array:
        """Tension (n,) [N] of the dashpot alone over a step."""
        if self.damping is None:
            return jnp.zeros_like(size)
        return self.damping / step.length * self._lengthening(step, size) / step.h

    def _limit_damper(self, dashpot: Array, spring: Array) -> Array:
        """The part (n,) [N] of the tension of a dashpot that acts in addition to the spring tension."""
        return dashpot

    def direction(self, d0: Array, d1: Array, mean: Array, length: Array) -> Array:
        """`d_mid / ((|d0| + |d1|)/2)`: only this direction gives exactly the work `T (|d1| - |d0|)`."""
        return mean / (0.5 * (safe_norm(d0) + safe_norm(d1)))[:, None]

    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        size = safe_norm(d)
        tension = self.EA * (size - length) / length
        if self.damping is not None:
            tension = tension + self.damping / length * dot(d, rate) / size
        return self.zero_broken(tension)

    def instant(self, d: Array, rate: Array, tension: Array, length: Array) -> Array:
        law = self.at_rest(d, tension, length)
        if self.damping is None:
            return law
        return law + self.damping / self.EA * self._stretching(d, rate, length)[1]

    def _stretching(self, d: Array, rate: Array, length: Array) -> tuple[Array, Array]:
        """Link vectors as the law uses them, and rates of length (n,) [m/s]."""
        return self.unstretch_broken(d, length), self.zero_broken(dot(d, rate) / safe_norm(d))

    def energy(self, d: Array, length: Array) -> Array:
        """Stored energy, scalar [J]: `EA (|d| - L)^2 / (2 L)`."""
        return jnp.sum(self._stored_energy(self._size(d, length), length))

    def _stored_energy(self, size: Array, length: Array) -> Array:
        """Stored energy of each link (n,) [J]."""
        return 0.5 * self.EA / length * (size - length) ** 2

    def works(self, start: LinkStart, d1: Array, length: Array, h: Array) -> dict[str, Array]:
        """Work over a step by name, scalars [J]: of the damper, never positive, and of the ringing force, which also
        stores and returns energy."""
        step = StretchStep.of(self, start, length, h)
        size = self._size(d1, length)
        spring = self._spring_over(step, size)
        longer = size - step.size
        found = {AXIAL_RINGING: -jnp.sum((spring - self._mean(step, size)) * longer)}
        if self.damping is not None:
            damper = self._limit_damper(self._dashpot(step, size), spring)
            found[INTERNAL_DAMPING] = -jnp.sum(damper * longer)
        return found

    def powers(self, d: Array, rate: Array, tension: Array, length: Array) -> dict[str, Array]:
        if self.damping is None:
            return {}
        stretching = jnp.sum(d * rate, axis=-1) / safe_norm(d)
        damper = self._damper(self.damping, d, stretching, tension, length)
        return {INTERNAL_DAMPING: -jnp.sum(damper * stretching)}

    def _damper(self, damping: Array, d: Array, stretching: Array, tension: Array, length: Array) -> Array:
        """Part of the tension (n,) [N] due to the internal damping."""
        return self.zero_broken(damping / length * stretching)


class StretchStep(NamedTuple):
    """Links at the start of a step: length [m], length expected at its end, unstretched length; step [s].

    `weight` is that of the ringing force, and `memory` `h^2` times the acceleration of the length in the last step [m].
    """

    size: Array
    expected: Array
    length: Array
    h: Array
    weight: Array | float
    memory: Array | float

    @classmethod
    def of(cls, law: Elastic, start: LinkStart, length: Array, h: Array) -> StretchStep:
        if start.rate is None:
            raise ValueError("start.rate: missing; links that stretch need the rates of their vectors")
        d, stretching = law._stretching(start.d, start.rate, length)
        size = safe_norm(d)
        expected = size + h * stretching
        if start.acceleration is None or start.inverse_reduced_mass is None:
            return cls(size, expected, length, h, weight=0.0, memory=0.0)
        turning = dot(start.rate, start.rate) - stretching**2
        acceleration = law.zero_broken((dot(d, start.acceleration) + turning) / size)
        highest = (
            2.0 * law.EA / length * start.inverse_reduced_mass
        )  # square of the highest frequency of a line of such links
        resolved = UNRESOLVED_FREQUENCY**2 / (highest * h**2)
        weight = jnp.maximum(1.0 - resolved, 0.0) ** 2
        return cls(size, expected, length, h, weight, acceleration * h**2)
