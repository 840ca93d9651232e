"""Inextensible links."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from dropper_jax.axial.elastic import Elastic
from dropper_jax.axial.law import AxialLaw, LinkStart
from dropper_jax.axial.rope import Rope
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import dot


@component
class Rigid(AxialLaw):
    """Inextensible link: `|d|^2 = L^2`; the tension is the constraint force."""

    elastic = False

    def springs(self, EA: jax.Array, pushes: bool = False) -> AxialLaw:
        # springs that push would keep a line straight between points that are close together
        if pushes:
            return Elastic(EA=EA)
        return Rope(EA=EA)

    def residual(
        self, start: LinkStart, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array
    ) -> jax.Array:
        return self.at_rest(d1, tension, length)

    def at_rest(self, d: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        """`(|d|^2 - L^2)/(2 L)` (n,) [m]: to first order the link's elongation."""
        return (dot(d, d) - length**2) / (2 * length)

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        return jnp.zeros_like(length)

    def direction(self, d0: jax.Array, d1: jax.Array, mean: jax.Array, length: jax.Array) -> jax.Array:
        """Unit force of a tension over a step, (n, 3): the work of `d_mid / L` is exactly `T (|d1| - |d0|)` = 0."""
        return mean / length[:, None]
