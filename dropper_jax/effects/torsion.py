"""Torsion of lines, and the tension caused by twist."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.base.read import Pairs, Values
from dropper_jax.base.records import names_of
from dropper_jax.effects.shafts import Shafts, check_joined
from dropper_jax.model import Effect, Kinematics, ModelView, sum_of_pieces
from dropper_jax.scene import SceneData

#: Twist phi (nodes,) [rad] and its rate (nodes,) [rad/s], nodes line after line with both ends of each.
Twist = tuple[Array, Array]


@component
class Torsion(Effect):
    """Twist phi about the axis of each line, a separate state: `i_p phi'' = (GJ phi_s + c phi_s' + k_tt e)_s`.

    Every node turns about the line with half of the polar inertia of its links. A link carries the torque
    `Q = GJ tau/l + c tau'/l + k_tt e`, tau the twist between its ends, e its strain. An end is held at a given angle,
    or is free with a moment on it. The tension gains the term `k_tt tau/l` (paper, (20)): the same constant in both
    equations, from the energy `k_tt e tau`. Each step of the lines includes one midpoint step of the twist, which loses
    no energy and is second order. The lines use the twist at the start of the step, which is first order.

    Two lines of a pair in `joined` twist as one across their common point: a universal joint, or, if `bending` joins
    them too, a clamp. Between other lines, and through a broken link, no torque is passed.

    Not modelled, as in the paper: bending does not cause twist and twist does not cause bending (no writhe, no
    hockles), and water does not resist twist.
    """

    name = "torsion"
    reach = 1
    GJ: Array = parameter("torsional stiffness", unit="N m^2", shape="link", above=0.0)
    polar_inertia: Array = parameter("polar moment of inertia per length", unit="kg m", shape="link", above=0.0)
    damping: Array = parameter(
        "torque per rate of twist per length", unit="N m^2 s", shape="link", low=0.0, default=0.0
    )
    coupling: Array = parameter(
        "k_tt, tension per twist per length, and torque per strain", unit="N m", shape="link", default=None
    )
    torque: Array = parameter("moment on last points that are free to turn", unit="N m", default=0.0)
    turn: Array = parameter("angle to which last points that are held are turned", unit="rad", default=0.0)
    turn_time: Array = parameter("duration of the turn, at a constant rate", unit="s", low=0.0, default=0.0)
    lines: tuple[str, ...] = option("lines that twist; all if not given", type=list, default=())
    joined: tuple[tuple[str, str], ...] = option(
        "lines that twist across their common point as one", type=Pairs, default=()
    )
    first: str = option("first points of the lines", choices=("held", "free"), default="held")
    last: str = option("last points of the lines", choices=("held", "free"), default="free")
    begins: str = option("twist at the start", choices=("at_rest", "untwisted"), default="at_rest")
    #: The state of the twist during a run.
    twist: Twist | None = None

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        names = names_of(scene.lines)
        for i, name in enumerate(values["lines"]):
            if name not in names:
                raise SceneError(f"effects.torsion.lines.{i}: {name!r} is not a line; {nearest(name, names)}")
        check_joined(values, scene)
        if values["coupling"] is not None and any(line.length_in_time for line in scene.lines):
            raise SceneError(
                "effects.torsion.coupling: needs strains over constant lengths, but [[line.length_in_time]] changes "
                "them; allowed: one of the two"
            )
        for key, last, other in (("torque", "free", "held"), ("turn", "held", "free")):
            if values[key] != 0.0 and values["last"] == other:
                what = f"{values[key]:g} only applies to last points that are {last}"
                raise SceneError(f"effects.torsion.{key}: {what}; allowed: 0 where `last` is {other!r}")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Effect:
        if values["coupling"] is None:
            return cls(**values)
        return CoupledTorsion(**values)

    def begin(self, model: ModelView) -> Twist:
        rest = self.at_rest(model)
        none = jnp.zeros_like(rest)
        if self.begins == "at_rest":
            return rest, none
        return none, none

    def entered(self, state: Twist) -> Torsion:
        return replace(self, twist=state)

    def _shafts(self, model: ModelView) -> Shafts:
        return Shafts(model.geometry, self.lines, self.joined, (self.first == "held", self.last == "held"))

    def advance(self, before: Kinematics, after: Kinematics, tension: Array, h: Array) -> Twist:
        model = after.model
        shafts = self._shafts(model)
        phi, rate = map(shafts.of_lines, self.twist or self.begin(model))
        inertia, stiffness, damping = self._coefficients(model)
        load = self.torque * shafts.last + shafts.at_nodes(-self._strain_torque(before, after))
        # w = (phi1 - phi0)/h:  (2 I/h + h K/2 + C) w = 2 I/h phi0' - K phi0 + load
        own = stiffness * 0.5 * h + damping
        right = 2.0 * inertia / h * rate + shafts.at_nodes(-stiffness * shafts.differences(phi)) + load
        mean = shafts.solve(2.0 * inertia / h, own, right, (self._turned_at(after.t) * shafts.turned - phi) / h)
        rate = jnp.where(shafts.held, mean, 2.0 * mean - rate)
        return shafts.on_lines(phi + h * mean), shafts.on_lines(rate)

    def at_rest(self, model: ModelView) -> Array:
        """Twist (nodes,) [rad] at the start, under the moments at the ends."""
        shafts = self._shafts(model)
        _, stiffness, _ = self._coefficients(model)
        zero = jnp.zeros(shafts.held.shape, stiffness.dtype)
        goal = self._turned_at(zero[0]) * shafts.turned
        return shafts.on_lines(shafts.solve(zero, stiffness, self.torque * shafts.last, goal))

    def _turned_at(self, t: Array) -> Array:
        """Angle [rad] to which last points are turned at time t [s]."""
        takes_time = self.turn_time > 0.0
        share = jnp.where(takes_time, t / jnp.where(takes_time, self.turn_time, 1.0), 1.0)
        return self.turn * jnp.clip(share, 0.0, 1.0)

    def _coefficients(self, model: ModelView) -> tuple[Array, Array, Array]:
        """Inertia of nodes (nodes,) [kg m^2], stiffness and damping of links (n,) [N m/rad], [N m s/rad]."""
        length = model.line.length
        half = 0.5 * self.polar_inertia * length
        stiffness = model.line.axial.zero_broken(self.GJ / length)
        return self._shafts(model).sums(half, half), stiffness, model.line.axial.zero_broken(self.damping / length)

    def _strain_torque(self, before: Kinematics, after: Kinematics) -> Array:
        """Torque (n,) [N m] due to the strain, over the step."""
        return jnp.zeros_like(after.line.length)


@component
class CoupledTorsion(Torsion):
    """The same with tension due to twist and torque due to strain."""

    def _strain_torque(self, before: Kinematics, after: Kinematics) -> Array:
        length = after.line.length
        strain = 0.5 * (safe_norm(before.links) + safe_norm(after.links)) / length - 1.0
        return after.line.axial.zero_broken(self.coupling * self._shafts(after.model).twists * strain)

    def twist_tension(self, model: ModelView) -> Array:
        """Tension (n,) [N] due to the twist."""
        phi = self.at_rest(model) if self.twist is None else self.twist[0]
        shafts = self._shafts(model)
        tension = self.coupling * shafts.twists * shafts.differences(shafts.of_lines(phi)) / model.line.length
        return model.line.axial.zero_broken(tension)

    force = sum_of_pieces

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        """Both nodes of every link."""
        return np.stack([model.geometry.first, model.geometry.last], axis=1)

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        link = r[:, 1] - r[:, 0]
        force = (self.twist_tension(k.model) / jnp.sqrt(dot(link, link) + 1e-30))[:, None] * link
        return jnp.stack([force, -force], axis=1)
