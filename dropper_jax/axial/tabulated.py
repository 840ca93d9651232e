"""Ropes whose tension is tabulated over strain."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.axial.elastic import StretchStep
from dropper_jax.axial.law import AxialLaw
from dropper_jax.axial.rope import Rope
from dropper_jax.base.fields import component

#: Relative change of length below which the mean tension is that in the middle of the change: exact to second order,
#: where a difference of energies would be lost in rounding.
SHORT_CHANGE = 1e-7
#: Strain beyond the first row at which a slack link takes its stiffness, which is 0 before.
JUST_TAUT = 1e-6


class Intervals(NamedTuple):
    """The intervals between the rows of the tables of links, and how far a link is through each of them (n, k - 1).

    Attributes:
        width: of strain [-].
        s: fraction of the interval that the link has passed, 0 to 1.
        beyond: strain of the link beyond the end of the interval, at least 0.
        rise: of the tension over the interval [N].
        a, b, c: coefficients of s, s^2 and s^3 of its cubic [N].
    """

    width: Array
    s: Array
    beyond: Array
    rise: Array
    a: Array
    b: Array
    c: Array


@component
class Tabulated(Rope):
    """Link whose tension is tabulated over strain: a monotone cubic through the rows (see `force_table`).

        T(s) = T_i + a s + b s^2 + c s^3,    s from 0 to 1 in the interval from row i to the next

    The link is slack up to the first row. Beyond the last row the tension continues with the slope there. In between,
    tension and slope are continuous. Internal damping as in `Rope`. `EA` [N] is the largest secant between rows (the
    cubic may be 1.5 times as steep); it scales residuals, the shortest step and damping ratios, not the tension.

    Attributes:
        strain, force, slope: the k rows of each link's table, and the slopes of its curve there (n, k) [-], [N], [N].
    """

    strain: Array = dataclasses.field(kw_only=True)
    force: Array = dataclasses.field(kw_only=True)
    slope: Array = dataclasses.field(kw_only=True)

    with_tangent = AxialLaw.with_tangent  # the derivatives of its own curve

    def soften(self, share: float) -> AxialLaw:
        return dataclasses.replace(self, EA=share * self.EA, force=share * self.force, slope=share * self.slope)

    def _passed_intervals(self, size: Array, length: Array) -> Intervals:
        """How far links of length `size` (n,) [m] are through the intervals of their tables."""
        width = self.strain[:, 1:] - self.strain[:, :-1]
        beyond = (size / length - 1.0)[:, None] - self.strain
        rise = self.force[:, 1:] - self.force[:, :-1]
        first = width * self.slope[:, :-1]
        last = width * self.slope[:, 1:]
        return Intervals(
            width=width,
            s=jnp.clip(beyond[:, :-1] / width, 0.0, 1.0),
            beyond=jnp.maximum(beyond[:, 1:], 0.0),
            rise=rise,
            a=first,
            b=3 * rise - 2 * first - last,
            c=first + last - 2 * rise,
        )

    def spring(self, size: Array, length: Array) -> Array:
        passed = self._passed_intervals(size, length)
        s = passed.s
        within = s * (passed.a + s * (passed.b + s * passed.c))
        return jnp.sum(within, axis=-1) + self.slope[:, -1] * passed.beyond[:, -1]

    def _stored_energy(self, size: Array, length: Array) -> Array:
        """The integral of the curve over the strain, times the length."""
        passed = self._passed_intervals(size, length)
        s = passed.s
        beyond = passed.beyond
        cubic = passed.a / 2 + s * (passed.b / 3 + s * passed.c / 4)
        within = passed.width * s**2 * cubic + passed.rise * beyond
        return length * (jnp.sum(within, axis=-1) + 0.5 * self.slope[:, -1] * beyond[:, -1] ** 2)

    def _slack(self, length: Array) -> Array:
        return length * (1.0 + self.strain[:, 0])

    def _stiffness(self, step: StretchStep) -> Array:
        at = jnp.maximum(step.size, self._slack(step.length) + JUST_TAUT * step.length)
        return jax.jvp(lambda size: self.spring(size, step.length), (at,), (jnp.ones_like(at),))[1]

    def _mean(self, step: StretchStep, size: Array) -> Array:
        length = step.length
        longer = size - step.size
        little = jnp.abs(longer) < SHORT_CHANGE * length
        work = self._stored_energy(size, length) - self._stored_energy(step.size, length)
        middle = self.spring(0.5 * (step.size + size), length)
        return jnp.where(little, middle, work / jnp.where(little, 1.0, longer))
