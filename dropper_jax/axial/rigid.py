"""Inextensible links."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from dropper_jax.axial.elastic import Elastic
from dropper_jax.axial.law import AxialLaw, LinkStart
from dropper_jax.axial.rope import Rope
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import dot


@component
class Rigid(AxialLaw):
    """Inextensible link: `|d|^2 = L^2`; the tension is the constraint force."""

    elastic = False

    def springs(self, EA: Array, pushes: bool = False) -> AxialLaw:
        # springs that push would keep a line straight between points that are close together
        if pushes:
            return Elastic(EA=EA)
        return Rope(EA=EA)

    def residual(self, start: LinkStart, d1: Array, tension: Array, length: Array, h: Array) -> Array:
        return self.at_rest(d1, tension, length)

    def at_rest(self, d: Array, tension: Array, length: Array) -> Array:
        """`(|d|^2 - L^2)/(2 L)` (n,) [m]: to first order the link's elongation."""
        return (dot(d, d) - length**2) / (2 * length)

    def tension(self, d: Array, rate: Array, length: Array) -> Array:
        return jnp.zeros_like(length)

    def direction(self, d0: Array, d1: Array, mean: Array, length: Array) -> Array:
        """Unit force of a tension over a step, (n, 3): the work of `d_mid / L` is exactly `T (|d1| - |d0|)` = 0."""
        return mean / length[:, None]
