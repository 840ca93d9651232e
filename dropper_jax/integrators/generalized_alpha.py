"""Generalised-alpha on lines that stretch: second order, with damping of what the step cannot resolve.

    M ((1 - am) a1 + am a0) = F + sum T_j d_j/|d_j|   at   r_f = (1 - af) r1 + af r0, v_f and t_f alike,
    r1 = r0 + h v0 + h^2 ((1/2 - beta) a0 + beta a1),    v1 = v0 + h ((1 - gamma) a0 + gamma a1),

    am = (2 rho - 1)/(rho + 1), af = rho/(rho + 1), gamma = 1/2 - am + af, beta = (1 - am + af)^2/4

(Chung and Hulbert 1993). A vibration of `h omega >> 1` is multiplied by `rho` at every step. One of `h omega << 1`
loses a fraction of the order of `(h omega)^4` per step (1/54 of that with rho = 0.5), whereas `energy_momentum` with
its law at the end of the step takes `(h omega)^2/4`. Axial ringing after a snap is therefore resolved with larger
steps. In turn, energy is conserved only as accurately as the motion is computed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from dropper_jax.base.fields import parameter
from dropper_jax.base.numerics import safe_norm
from dropper_jax.integrators.runge_kutta import accelerations, powers
from dropper_jax.integrators.stop_stuck import stop_stuck_nodes
from dropper_jax.model import Ends, Frozen, Kinematics, LengthOverTime, Model, State
from dropper_jax.residual import DisplacementProblem, Implicit, LocalError, NodeRows, PerLaw, Unknowns, couples_inertia


class Coefficients(NamedTuple):
    """Weights of the new time for accelerations and forces, Newmark's gamma and beta, and the lag of accelerations."""

    new_a: float
    new_f: float
    gamma: float
    beta: float
    lag: float

    @classmethod
    def of(cls, rho: float) -> Coefficients:
        """Of the amplitude ratio of the fastest vibrations (Chung and Hulbert 1993)."""
        old_a = (2.0 * rho - 1.0) / (rho + 1.0)
        old_f = rho / (rho + 1.0)
        return cls(
            new_a=1.0 - old_a,
            new_f=1.0 - old_f,
            gamma=0.5 - old_a + old_f,
            beta=0.25 * (1.0 - old_a + old_f) ** 2,
            lag=old_a - old_f,
        )


@dataclass(frozen=True)
class GeneralizedAlpha(Implicit):
    """For snapping lines. `rho_infinity` is the amplitude ratio of the fastest vibrations over one step, 0 to 1.

    With 1 nothing is damped, and unresolved ringing continues indefinitely. The default is 0.5; OrcaFlex uses 0.4.
    """

    name = "generalized_alpha"
    order = 2
    networkable = True
    takes_laws = True
    rho_infinity: float = parameter(
        "amplitude ratio of the fastest vibrations over one step", unit="-", low=0.0, high=1.0, default=0.5
    )

    @property
    def tension_time(self) -> float:
        return 1.0 / (1.0 + self.rho_infinity)

    @property
    def dissipates(self) -> bool:
        return self.rho_infinity < 1.0

    @property
    def local_error(self) -> LocalError:
        """Its acceleration is that at `lag h` after the step, so `x = h^2 ((1/2 - beta) a0 + beta a1)` is off by
        `h^3 (beta + lag/2 - 1/6)` of the third derivative."""
        coefficients = Coefficients.of(self.rho_infinity)
        return LocalError(
            constant=coefficients.beta + 0.5 * coefficients.lag - 1.0 / 6.0,
            lag=coefficients.lag,
            inertia=coefficients.new_a / coefficients.beta,
        )

    def refuse(self, model: Model) -> str | None:
        if not model.line.axial.elastic:
            return "it needs tensions that follow from lengths, but the links are rigid; set axial.law"
        if model.effects_with(LengthOverTime):
            return "it needs constant lengths, but [[line.length_in_time]] changes them; use energy_momentum"
        if couples_inertia(model):
            return "added mass couples neighbouring nodes here; use energy_momentum"
        if not all(law.node_local for law in model.laws):
            return f"effect {model.laws[0].name!r} couples neighbouring nodes; use energy_momentum"
        return super().refuse(model)

    def begin(self, model: Model, s: State) -> State:
        """The state with the accelerations at its start, which this scheme carries along."""
        k = model.instant(s.r, s.v, s.t)
        tension = model.tension_by_law(k)
        a = accelerations(model, k, model.force(k) + model.tension_force(tension, k.tangents), s.t)
        for law, z in zip(model.laws, s.law, strict=True):
            a = law.stop(k, a, z, jnp.ones((), a.dtype))  # nodes at rest have zero acceleration
        return replace(s, acceleration=a, carries_acceleration=True)

    def equations(self, model: Model, s: State, h: Array) -> GeneralizedAlphaProblem:
        # a state that another function has made: each step computes the accelerations at its start
        if not s.carries_acceleration:
            s = replace(self.begin(model, s), carries_acceleration=False)
        return GeneralizedAlphaProblem(model, s, h, self.rho_infinity)


class GeneralizedAlphaProblem(DisplacementProblem):
    """Unknowns: x = r1 - r0 - h v0, and tensions at t_f."""

    def __init__(self, model: Model, s: State, h: Array, rho: float) -> None:
        super().__init__(model, s, h)
        self.new_a, self.new_f, self.gamma, self.beta, _ = Coefficients.of(rho)
        self.t_f = s.t + self.new_f * h
        at_f = model.ends(self.t_f)
        # fixed ends on the straight line between their positions, as for all nodes, so that links are blends of links
        before = self.ends0.positions
        self.ends = Ends(before + self.new_f * (self.ends1.positions - before), at_f.velocities)
        self.end_acceleration = model.end_acceleration(s.t + self.new_a * h)
        zero = jnp.zeros_like(s.r)
        self.prepared: dict[str, Frozen] = {}
        predicted = self._kinematics(zero)
        self.prepared = model.prepare(predicted)
        #: Link vectors (n, 3) [m] at the end of the step and their rates [m/s] at t_f, for x = 0.
        self.straight = self.link_vectors(zero), predicted.link_velocities

    def _acceleration(self, x: Array) -> Array:
        """a1 (nodes, 3) [m/s^2]."""
        return (x / self.h**2 - (0.5 - self.beta) * self.s.acceleration) / self.beta

    def _mean_acceleration(self, x: Array) -> Array:
        """(1 - am) a1 + am a0 (nodes, 3) [m/s^2]."""
        old = self.s.acceleration
        return old + self.new_a * (self._acceleration(x) - old)

    def _velocity(self, x: Array) -> Array:
        """v1 (nodes, 3) [m/s]."""
        mean = (1.0 - self.gamma) * self.s.acceleration + self.gamma * self._acceleration(x)
        return self.s.v + self.h * mean

    def _kinematics(self, x: Array, h: Array | None = None) -> Kinematics:
        """Positions and velocities at t_f; with h as an instant of the step."""
        s = self.s
        share = self.new_f
        v = s.v + share * (self._velocity(x) - s.v)
        r = s.r + share * (self.h * s.v + x)
        return self.model.kinematics(r, v, self.t_f, self.ends, self.prepared, h=h)

    def instant(self, x: Array) -> Kinematics:
        return self._kinematics(x, self.h)

    def guess(self) -> Unknowns:
        s = self.s
        return Unknowns(0.5 * self.h**2 * s.acceleration, s.tension, s.law)

    def node_rows(self, x: Array, z: PerLaw) -> NodeRows:
        """Inertia minus forces (nodes, 3) [N], without tensions, and the rows of laws."""
        k = self.instant(x)
        force, laws = self.law_rows(k, z)
        inertia = self.model.inertia(k, self._mean_acceleration(x), self.end_acceleration)
        return inertia - self.model.force(k) - force, laws

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        line = self.model.line
        straight, straight_rate = self.straight
        rate = straight_rate + self.new_f * self.gamma / (self.beta * self.h) * (d - straight)
        d = self.links0 + self.new_f * (d - self.links0)
        return (y / safe_norm(d))[:, None] * d, line.axial.instant(d, rate, y, line.length)

    def finish(self, u: Unknowns) -> State:
        h = self.h
        r1 = self.end_positions(u.x)
        v1 = self._velocity(u.x)
        a1 = self._acceleration(u.x)
        v1, a1, stopped = self._stop_stuck(u, r1, v1, a1)
        return self.end_state(
            r=r1, v=v1, tension=u.y, acceleration=a1, law=u.z, work=lambda: h * self._powers(u, stopped / h)
        )

    def _stop_stuck(self, u: Unknowns, r1: Array, v1: Array, a1: Array) -> tuple[Array, Array, Array]:
        """End velocities and accelerations with nodes that friction held at rest, and the energy taken by stopping them
        [J].

        A law on the velocity at t_f holds a node by `v_f = 0`, which turns its velocity v0 into `-rho v0`.
        """
        if not self.model.laws:
            return v1, a1, jnp.zeros((), v1.dtype)
        middle = self.instant(u.x)
        after = self.model.kinematics(r1, v1, self.s.t + self.h, self.ends1, prepared=self.prepared)
        v1, taken = stop_stuck_nodes(self.model, u.z, middle, after, self.h)
        for law, z in zip(self.model.laws, u.z, strict=True):
            a1 = law.stop(middle, a1, z, self.h)
        return v1, a1, taken

    def _powers(self, u: Unknowns, stopping: Array) -> Array:
        """Mean powers (k,) [W] over the step: forces at t_f times the nodes' motion, and the stopping of nodes."""
        k = self.instant(u.x).with_velocity(self.s.v + u.x / self.h)
        laws = {law.name: jnp.sum(law.law_force(k, z) * k.v) for law, z in zip(self.model.laws, u.z, strict=True)}
        if laws:
            laws[self.model.laws[0].name] += stopping
        return powers(self.model, k, u.y, self._mean_acceleration(u.x), laws)
