"""Axial laws: how the length of a link and its tension belong together."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from dropper_jax.fields import component, parameter
from dropper_jax.kinematics import dot, safe_norm


@component
class Rigid:
    """Inextensible link: `|d|^2 = L^2`; the tension is whatever holds it."""

    #: Whether `gradient` and `compliance` make a matrix good enough for the condensed solver.
    condensable: ClassVar[bool] = True

    @property
    def elastic(self) -> bool:
        return False

    def residual(self, d0: jax.Array, d1: jax.Array, tension: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """`(|d1|^2 - L^2)/(2 L)` (n,) [m]: to first order the link's elongation."""
        return (dot(d1, d1) - length**2) / (2 * length)

    def gradient(self, d1: jax.Array, length: jax.Array) -> jax.Array:
        """Derivative of the residual with respect to d1, (n, 3)."""
        return d1 / length[:, None]

    def compliance(self, length: jax.Array, h: jax.Array) -> jax.Array:
        """Minus the derivative of the residual with respect to the tension, (n,) [m/N]."""
        return jnp.zeros_like(length)

    def direction(self, d0: jax.Array, d1: jax.Array, mean: jax.Array, length: jax.Array) -> jax.Array:
        """Unit pull of a tension over a step, (n, 3): `d_mid / L` does exactly `T (|d1| - |d0|)` = 0 of work."""
        return mean / length[:, None]


@component
class Elastic:
    """Elastic link with internal damping: `T = EA (|d| - L)/L + BA d|d|/dt / L`.

    `EA` is the axial stiffness [N]. `damping` is BA [N s] (the paper's internal damping, its section 3.1).
    The link also pushes: a line that can go slack is a `Rope`.
    """

    condensable: ClassVar[bool] = True
    EA: jax.Array = parameter("axial stiffness", unit="N", shape="link", low=0.0, open_low=True)
    damping: jax.Array | None = parameter("internal damping BA", unit="N s", shape="link", low=0.0, optional=True)
    intact: jax.Array | None = None  # (n,): 0 where a link has parted (see `failure`), else 1

    @property
    def elastic(self) -> bool:
        return True

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

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        """Work of the internal damping over a step, scalar [J], never positive."""
        if self.damping is None:
            return jnp.zeros((), d0.dtype)
        stretch = safe_norm(self.seen(d1, length)) - safe_norm(self.seen(d0, length))
        return -jnp.sum(self.damping / length * stretch**2) / h


def _taut_or_slack(pull: jax.Array, held: jax.Array) -> jax.Array:
    """`max(pull, 0) = held` by active sets: rows of pull, and of a tension in terms of elongation, both (n,) [m]."""
    taut = held + STRETCH_COUNTS * (pull - held) > 0.0
    return jnp.where(taut, pull, 0.0) - held


#: How much a guessed stretch counts beside a guessed tension for whether a link is taut, any number in (0, 1].
STRETCH_COUNTS = 1e-3


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
        return _taut_or_slack(pull, length * tension / self.EA)

    def instant(
        self, d: jax.Array, rate: jax.Array, tension: jax.Array, length: jax.Array, since: jax.Array
    ) -> jax.Array:
        """The same at one instant. A link that tautened a moment ago has stretched by what it is longer, no more."""
        d, stretching = self._stretching(d, rate, length)
        pull = safe_norm(d) - length
        if self.damping is not None:
            pull = pull + self.damping / self.EA * jnp.minimum(stretching, jnp.maximum(pull, 0.0) / since)
        return _taut_or_slack(pull, length * tension / self.EA)

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        size = safe_norm(d)
        pull = self.EA * (size - length) / length
        if self.damping is not None:
            pull = pull + self.damping / length * dot(d, rate) / size
        return self.kept(jnp.where(size > length, jnp.maximum(pull, 0.0), 0.0))

    def energy(self, d: jax.Array, length: jax.Array) -> jax.Array:
        stretch = jnp.maximum(safe_norm(self.seen(d, length)) - length, 0.0)
        return jnp.sum(0.5 * self.EA / length * stretch**2)

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        if self.damping is None:
            return jnp.zeros((), d0.dtype)
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
        return _taut_or_slack(size - length, held)

    def tension(self, d: jax.Array, rate: jax.Array, length: jax.Array) -> jax.Array:
        d, stretching = self._stretching(d, rate, length)
        pull = self.spring(safe_norm(d), length)
        return pull if self.damping is None else pull + self.damping / length * stretching

    def damping_work(self, d0: jax.Array, d1: jax.Array, length: jax.Array, h: jax.Array) -> jax.Array:
        return Elastic.damping_work(self, d0, d1, length, h)


@component
class Tabulated(Rope):
    """Link whose tension is tabulated over strain: a monotone cubic through the rows (see `force_table`).

    Slack up to the first row; beyond the last one the tension goes on with the slope there. Between them tension and
    slope are continuous. Internal damping as in `Rope`. `EA` [N] is the largest slope; it only sizes residuals.
    """

    strain: jax.Array | None = None  # (n, k)
    force: jax.Array | None = None  # (n, k) [N]
    slope: jax.Array | None = None  # (n, k) [N]

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
        if self.damping is None:
            return jnp.zeros((), d0.dtype)
        d0, d1 = self.seen(d0, length), self.seen(d1, length)
        extra = self.EA / length * self._pull(d0, d1, length, h) - self.spring(safe_norm(d1), length)
        return -jnp.sum(extra * (safe_norm(d1) - safe_norm(d0)))


Axial = Rigid | Elastic | Rope | DampedRope | Tabulated
LAWS = {"rigid": Rigid, "elastic": Elastic, "rope": Rope, "damped_rope": DampedRope, "tabulated": Tabulated}
