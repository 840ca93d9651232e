"""Springs with internal damping, which also push."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.axial.law import AxialLaw
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import dot, safe_norm

INTERNAL_DAMPING = "internal_damping"


@component
class Elastic(AxialLaw):
    """Elastic link with internal damping: `T = EA (|d| - L)/L + BA d|d|/dt / L`.

    `EA` is the axial stiffness [N]. `damping` is BA [N s] (the paper's internal damping, its section 3.1).
    The link also pushes: a line that can go slack is a `Rope`.
    """

    elastic: ClassVar[bool] = True
    EA: jax.Array = parameter("axial stiffness", unit="N", shape="link", low=0.0, open_low=True)
    damping: jax.Array | None = parameter("internal damping BA", unit="N s", shape="link", low=0.0, optional=True)
    intact: jax.Array | None = None  # (n,): 0 where a link has parted (see `failure`), else 1

    @property
    def work_names(self) -> tuple[str, ...]:
        return () if self.damping is None else (INTERNAL_DAMPING,)

    def softened(self, share: float) -> AxialLaw:
        return replace(self, EA=share * self.EA)

    def seen(self, d: jax.Array, length: jax.Array) -> jax.Array:
        """Link vectors (n, 3) [m] as the law sees them: one that has parted lies unstretched."""
        if self.intact is None:
            return d
        return jnp.where(self.intact[:, None] > 0.0, d, length[:, None] * jnp.eye(1, 3, dtype=d.dtype))

    def kept(self, per_link: jax.Array) -> jax.Array:
        """Values (n,) of links, zero of those that have parted."""
        return per_link if self.intact is None else self.intact * per_link

    def residual(self, d0: jax.Array, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """`|d1| - L - L T/EA + (BA/EA) (|d1| - |d0|)/h` (n,) [m]: the law at the end of the step.

        Written at the end it only ever takes energy from axial ringing; its rigid limit is EA -> infinity.
        """
        size = safe_norm(self.seen(d1, length))
        law = size - length - length * tension / self.EA
        if self.damping is None:
            return law
        return law + self.damping / self.EA * (size - safe_norm(self.seen(d0, length))) / h

    def gradient(self, d1: jax.Array, length: jax.Array) -> jax.Array:
        return d1 / safe_norm(d1)[:, None] if self.intact is None else (self.intact / safe_norm(d1))[:, None] * d1

    def compliance(self, length: jax.Array, h: jax.Array) -> jax.Array:
        return length / self.EA * jnp.ones_like(length)

    def direction(self, d0: jax.Array, d1: jax.Array, mean: jax.Array, length: jax.Array) -> jax.Array:
        """`d_mid / ((|d0| + |d1|)/2)`: only this one does exactly `T (|d1| - |d0|)` of work."""
        return mean / (0.5 * (safe_norm(d0) + safe_norm(d1)))[:, None]

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        """Tension (n,) [N] of links d stretching at d' = `rate`, for explicit integrators."""
        size = safe_norm(d)
        pull = self.EA * (size - length) / length
        if self.damping is not None:
            pull = pull + self.damping / length * dot(d, rate) / size
        return self.kept(pull)

    def instant(
        self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array, since: jax.Array
    ) -> jax.Array:
        """The law at one instant within a step, (n,) [m]: of links d that stretch at d' = `rate` (n, 3) [m/s].

        `since` [s] is how long ago the step began, for laws that change where a link tautens.
        """
        d, stretching = self._stretching(d, rate, length)
        law = safe_norm(d) - length - length * tension / self.EA
        return law if self.damping is None else law + self.damping / self.EA * stretching

    def _stretching(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Link vectors as the law sees them, and rates of length (n,) [m/s]."""
        stretching = self.kept(dot(d, rate) / safe_norm(d))
        return self.seen(d, length), stretching

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        """Stored energy, scalar [J]: `EA (|d| - L)^2 / (2 L)`."""
        return jnp.sum(0.5 * self.EA / length * (safe_norm(self.seen(d, length)) - length) ** 2)

    def works(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> dict[str, jax.Array]:
        return {} if self.damping is None else {INTERNAL_DAMPING: self.damping_work(d0, d1, length, h)}

    def powers(self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array) -> dict[str, jax.Array]:
        if self.damping is None:
            return {}
        stretching = jnp.sum(d * rate, axis=-1) / safe_norm(d)
        return {INTERNAL_DAMPING: -jnp.sum(self._damper(d, stretching, tension, length) * stretching)}

    def _damper(self, d: jax.Array, stretching: jax.Array, tension: jax.Array, length: jax.Array) -> jax.Array:
        """Part of the tension (n,) [N] that the internal damping gives."""
        return self.kept(self.damping / length * stretching)

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """Work of the internal damping over a step, scalar [J], never positive; only where there is one."""
        stretch = safe_norm(self.seen(d1, length)) - safe_norm(self.seen(d0, length))
        return -jnp.sum(self.damping / length * stretch**2) / h
