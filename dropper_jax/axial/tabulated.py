"""Ropes whose tension is a table over strain."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp

from dropper_jax.axial.law import AxialLaw
from dropper_jax.axial.rope import Rope
from dropper_jax.base.fields import component
from dropper_jax.base.numerics import dot, safe_norm


@component
class Tabulated(Rope):
    """Link whose tension is tabulated over strain: a monotone cubic through the rows (see `force_table`).

    Slack up to the first row; beyond the last one the tension goes on with the slope there. Between them tension and
    slope are continuous. Internal damping as in `Rope`. `EA` [N] is the largest slope; it only sizes residuals.
    """

    strain: jax.Array | None = None  # (n, k)
    force: jax.Array | None = None  # (n, k) [N]
    slope: jax.Array | None = None  # (n, k) [N]

    def softened(self, share: float) -> AxialLaw:
        return replace(self, EA=share * self.EA, force=share * self.force, slope=share * self.slope)

    def _shares(self, size: jax.Array, length: jax.Array) -> tuple[jax.Array, ...]:
        """Shares of each interval that are passed (n, k - 1), what comes after each, and widths of the intervals."""
        width = self.strain[:, 1:] - self.strain[:, :-1]
        beyond = (size / length - 1.0)[:, None] - self.strain
        return jnp.clip(beyond[:, :-1] / width, 0.0, 1.0), jnp.maximum(beyond[:, 1:], 0.0), width

    def _cubics(self, width: jax.Array) -> tuple[jax.Array, ...]:
        """Rise and coefficients of s, s^2, s^3 of each interval's cubic (n, k - 1), s from 0 to 1."""
        rise = self.force[:, 1:] - self.force[:, :-1]
        first, last = width * self.slope[:, :-1], width * self.slope[:, 1:]
        return rise, first, 3 * rise - 2 * first - last, first + last - 2 * rise

    def spring(self, size: jax.Array, length: jax.Array) -> jax.Array:
        s, beyond, width = self._shares(size, length)
        _, a, b, c = self._cubics(width)
        return jnp.sum(s * (a + s * (b + s * c)), axis=-1) + self.slope[:, -1] * beyond[:, -1]

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        """Stored energy, scalar [J]: the integral of the curve, times the length."""
        s, beyond, width = self._shares(safe_norm(self.seen(d, length)), length)
        rise, a, b, c = self._cubics(width)
        within = width * s**2 * (a / 2 + s * (b / 3 + s * c / 4)) + rise * beyond
        return jnp.sum(length * (jnp.sum(within, axis=-1) + 0.5 * self.slope[:, -1] * beyond[:, -1] ** 2))

    def _stretched(self, d: jax.Array, length: jax.Array) -> jax.Array:
        """Elongation beyond the first row (n,) [m]; the damper acts on it alone."""
        return jnp.maximum(safe_norm(d) - length * (1.0 + self.strain[:, 0]), 0.0)

    def _pull(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        pull = self.spring(safe_norm(d1), length)
        if self.damping is not None:
            rate = (self._stretched(d1, length) - self._stretched(d0, length)) / h
            pull = jnp.maximum(pull + self.damping / length * rate, 0.0)
        return length / self.EA * pull

    def residual(self, d0: jax.Array, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        return self._pull(self.seen(d0, length), self.seen(d1, length), length, h) - length * tension / self.EA

    def instant(
        self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array, since: jax.Array
    ) -> jax.Array:
        d, stretching = self._stretching(d, rate, length)
        pull = self.spring(safe_norm(d), length)
        if self.damping is not None:
            stretching = jnp.minimum(stretching, self._stretched(d, length) / since)
            pull = jnp.maximum(pull + self.damping / length * stretching, 0.0)
        return length / self.EA * (pull - tension)

    def gradient(self, d1: jax.Array, length: jax.Array) -> jax.Array:
        size = safe_norm(d1)
        slope = jax.jvp(lambda x: self.spring(x, length), (size,), (jnp.ones_like(size),))[1]
        return self.kept(length / self.EA * slope / size)[:, None] * d1

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        pull = self.spring(safe_norm(d), length)
        if self.damping is not None:
            damper = self.damping / length * dot(d, rate) / safe_norm(d)
            pull = jnp.where(self._stretched(d, length) > 0.0, jnp.maximum(pull + damper, 0.0), 0.0)
        return self.kept(pull)

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        d0, d1 = self.seen(d0, length), self.seen(d1, length)
        extra = self.EA / length * self._pull(d0, d1, length, h) - self.spring(safe_norm(d1), length)
        return -jnp.sum(extra * (safe_norm(d1) - safe_norm(d0)))
