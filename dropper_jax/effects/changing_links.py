"""Links whose total length changes in time: by a table, by a function, or by a winch that controls their tension."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.effects.end_motion import interpolate_quintic


class ChangingLinks:
    """Base of links whose total length changes in time. Those with a state, which a run carries, define the last three
    methods."""

    @property
    def links(self) -> tuple[int, ...]:
        """The links, from 0, among those of all lines."""
        raise NotImplementedError

    @property
    def corners(self) -> Array | None:
        """Times (k,) [s] at which the length is not smooth; None: never."""
        return None

    def total_length(self, t: Array, initial: Array) -> Array:
        """Total length [m] of the links at time t [s]; `initial` is that in the scene."""
        raise NotImplementedError

    def initial_state(self, initial: Array) -> WinchState | None:
        """The state at the start of a run."""
        return None

    def with_state(self, now: WinchState | None) -> ChangingLinks:
        """The same links in this state."""
        return self

    def advance(self, t: Array, tension: Array, h: Array) -> WinchState | None:
        """The state after a step of h [s] that ended at t [s] with these tensions (n,) [N]."""
        return None


@component
class LengthTable(ChangingLinks):
    """Total length of some links over time; before and after the table it is constant."""

    time: Array = parameter("times of the rows", unit="s", shape="table")
    length: Array = parameter("total length at those times", unit="m", shape="table")
    smooth: bool = option("quintics between the rows (as `end_motion`), not straight lines", default=False)
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())

    def total_length(self, t: Array, initial: Array) -> Array:
        if self.smooth:
            return interpolate_quintic(t, self.time, self.length[:, None])[0]
        return jnp.interp(t, self.time, self.length)

    @property
    def corners(self) -> Array | None:
        return self.time


@component
class LengthFunction(ChangingLinks):
    """Total length of some links as a JAX function of time and of parameters."""

    parameters: Any
    function: Callable[[Array, Any], Array] = option("length [m] of (time [s], parameters)")
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())

    def total_length(self, t: Array, initial: Array) -> Array:
        return jnp.asarray(self.function(t, self.parameters), t.dtype)


@component
class WinchState:
    """Time [s] at which a winch was last set, total length [m] then, rate since [m/s], integral of the error [N s]."""

    t: Array
    length: Array
    rate: Array
    integral: Array


@component
class Winch(ChangingLinks):
    """A proportional-integral winch on the tension T of the end link, set once per step:

        dL/dt = k_p (T - T*) + k_i int (T - T*) dt,    within the limits of rate and length

    While the rate or the length is at a limit, the integral only changes away from it. First order in the step.
    """

    target: Array = parameter("tension T*", unit="N", low=0.0)
    gain: Array = parameter("k_p [m/s/N] and k_i [m/s^2/N]", unit="-", shape="table", low=0.0)
    limits: Array = parameter("lowest and highest rate", unit="m/s", shape="table")
    lengths: Array = parameter("shortest and longest total length", unit="m", shape="table", low=0.0)
    now: WinchState | None = None
    links: tuple[int, ...] = option("links, from 0, among those of all lines", default=())
    measured: int = option("link whose tension is measured", default=0)

    def total_length(self, t: Array, initial: Array) -> Array:
        if self.now is None:
            return initial
        return jnp.clip(self.now.length + self.now.rate * (t - self.now.t), *self.lengths)

    def initial_state(self, initial: Array) -> WinchState:
        zero = jnp.zeros_like(initial)
        return WinchState(zero, initial, zero, zero)

    def with_state(self, now: WinchState | None) -> Winch:
        return replace(self, now=now)

    def advance(self, t: Array, tension: Array, h: Array) -> WinchState | None:
        now = self.now
        if now is None:
            return None
        error = tension[self.measured] - self.target
        integral = now.integral + h * error
        wanted = self.gain[0] * error + self.gain[1] * integral
        length = self.total_length(t, now.length)
        rate = jnp.clip(wanted, *self.limits)
        shortest, longest = self.lengths
        at_end = ((length <= shortest) & (rate < 0.0)) | ((length >= longest) & (rate > 0.0))
        rate = jnp.where(at_end, 0.0, rate)
        # a growing integral would hold the winch at its limit after the error has changed its sign
        leaves_limit = error * wanted < 0.0
        integral = jnp.where((rate == wanted) | leaves_limit, integral, now.integral)
        return WinchState(t, length, rate, integral)
