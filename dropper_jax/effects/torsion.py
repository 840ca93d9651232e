"""Torsion of lines, and the tension caused by twist."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.tridiagonal import solve_tridiagonal
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot, safe_norm
from dropper_jax.model import Effect, Graph, Kinematics, ModelView, sum_of_pieces
from dropper_jax.scene import SceneData

#: Twist phi (nodes,) [rad] and its rate (nodes,) [rad/s], nodes line after line with both ends of each.
Twist = tuple[jax.Array, jax.Array]


@component
class Torsion(Effect):
    """Twist phi about the axis of each line, a separate state: `i_p phi'' = (GJ phi_s + c phi_s' + k_tt e)_s`.

    Every node turns about the line with half of the polar inertia of its links. A link carries the torque
    `Q = GJ tau/l + c tau'/l + k_tt e`, tau the twist between its ends, e its strain. An end is held at a given angle,
    or is free with a moment on it. The tension gains the term `k_tt tau/l` (paper, (20)): the same constant in both
    equations, from the energy `k_tt e tau`. Each step of the lines includes one midpoint step of the twist, which loses
    no energy and is second order. The lines use the twist at the start of the step, which is first order.

    Not modelled, as in the paper: bending does not cause twist and twist does not cause bending (no writhe, no
    hockles), no torque is passed between lines, and water does not resist twist.
    """

    name: ClassVar[str] = "torsion"
    reach: ClassVar[int] = 1
    GJ: jax.Array = parameter("torsional stiffness", unit="N m^2", shape="link", low=0.0, open_low=True)
    polar_inertia: jax.Array = parameter(
        "polar moment of inertia per length", unit="kg m", shape="link", low=0.0, open_low=True
    )
    damping: jax.Array = parameter(
        "torque per rate of twist per length", unit="N m^2 s", shape="link", low=0.0, default=0.0
    )
    coupling: jax.Array | None = parameter(
        "k_tt, tension per twist per length, and torque per strain", unit="N m", shape="link", optional=True
    )
    torque: jax.Array = parameter("moment on last points that are free to turn", unit="N m", default=0.0)
    turn: jax.Array = parameter("angle to which last points that are held are turned", unit="rad", default=0.0)
    turn_time: jax.Array = parameter("duration of the turn, at a constant rate", unit="s", low=0.0, default=0.0)
    lines: tuple[str, ...] = option("lines that twist; all if not given", type=list, default=())
    first: str = option("first points of the lines", choices=("held", "free"), default="held")
    last: str = option("last points of the lines", choices=("held", "free"), default="free")
    begins: str = option("twist at the start", choices=("at_rest", "untwisted"), default="at_rest")
    #: The state of the twist during a run.
    twist: Twist | None = None

    @classmethod
    def check(cls, values: Mapping[str, Any], scene: SceneData) -> None:
        names = [line.name for line in scene.lines]
        for i, name in enumerate(values["lines"]):
            if name not in names:
                raise SceneError(f"effects.torsion.lines.{i}: {name!r} is not a line; {nearest(name, names)}")
        if values["first"] == values["last"] == "free":
            raise SceneError(
                "effects.torsion.last: 'free' lets lines spin freely, as `first` is 'free' too; allowed: 'held'"
            )
        for key, last, other in (("torque", "free", "held"), ("turn", "held", "free")):
            if values[key] != 0.0 and values["last"] == other:
                what = f"{values[key]:g} only applies to last points that are {last}"
                raise SceneError(f"effects.torsion.{key}: {what}; allowed: 0 where `last` is {other!r}")

    @classmethod
    def build(cls, values: Mapping[str, Any], scene: SceneData) -> Effect:
        return (cls if values["coupling"] is None else CoupledTorsion)(**values)

    def begin(self, model: ModelView) -> Twist:
        rest = self.at_rest(model)
        return (rest if self.begins == "at_rest" else jnp.zeros_like(rest)), jnp.zeros_like(rest)

    def entered(self, state: Twist) -> Torsion:
        return replace(self, twist=state)

    def advance(self, before: Kinematics, after: Kinematics, tension: jax.Array, h: jax.Array) -> Twist:
        phi, rate = self.twist
        model = after.model
        where = Where(after.model.geometry, self)
        inertia, stiffness, damping = self._along(model)
        load = where.last * self.torque + where.at_nodes(-self._strain_torque(before, after))
        # w = (phi1 - phi0)/h:  (2 I/h + h K/2 + C) w = 2 I/h phi0' - K phi0 + load
        own = stiffness * 0.5 * h + damping
        right = 2.0 * inertia / h * rate + where.at_nodes(-stiffness * where.differences(phi)) + load
        mean = where.solve(2.0 * inertia / h, own, right, (where.turned * self._turned_at(after.t) - phi) / h)
        return phi + h * mean, jnp.where(where.held, mean, 2.0 * mean - rate)

    def at_rest(self, model: ModelView) -> jax.Array:
        """Twist (nodes,) [rad] at the start, under the moments at the ends."""
        where = Where(model.geometry, self)
        _, stiffness, _ = self._along(model)
        zero = jnp.zeros(where.held.shape, stiffness.dtype)
        return where.solve(zero, stiffness, where.last * self.torque, where.turned * self._turned_at(zero[0]))

    def _turned_at(self, t: jax.Array) -> jax.Array:
        share = jnp.where(self.turn_time > 0.0, t / jnp.where(self.turn_time > 0.0, self.turn_time, 1.0), 1.0)
        return self.turn * jnp.clip(share, 0.0, 1.0)

    def _along(self, model: ModelView) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Inertia of nodes (nodes,) [kg m^2], stiffness and damping of links (n,) [N m/rad], [N m s/rad]."""
        length = model.line.length
        where = Where(model.geometry, self)
        half = 0.5 * self.polar_inertia * length
        return where.sums(half, half), self.GJ / length, self.damping / length

    def _strain_torque(self, before: Kinematics, after: Kinematics) -> jax.Array:
        """Torque (n,) [N m] due to the strain, over the step."""
        return jnp.zeros_like(after.line.length)


@component
class CoupledTorsion(Torsion):
    """The same with tension due to twist and torque due to strain."""

    def _strain_torque(self, before: Kinematics, after: Kinematics) -> jax.Array:
        length = after.line.length
        strain = 0.5 * (safe_norm(before.links) + safe_norm(after.links)) / length - 1.0
        return Where(after.model.geometry, self).twists * self.coupling * strain

    def twist_tension(self, model: ModelView) -> jax.Array:
        """Tension (n,) [N] due to the twist."""
        phi = self.at_rest(model) if self.twist is None else self.twist[0]
        where = Where(model.geometry, self)
        return where.twists * self.coupling * where.differences(phi) / model.line.length

    def force(self, k: Kinematics) -> jax.Array:
        return sum_of_pieces(self, k)

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        """Both nodes of every link."""
        return np.stack([model.geometry.first, model.geometry.last], axis=1)

    def piece_force(self, k: Kinematics, r: jax.Array, v: jax.Array) -> jax.Array:
        link = r[:, 1] - r[:, 0]
        force = (self.twist_tension(k.model) / jnp.sqrt(dot(link, link) + 1e-30))[:, None] * link
        return jnp.stack([force, -force], axis=1)


class Where:
    """Nodes line after line, both ends of each included: static arrays.

    Attributes:
        twists: of links, 1.0 if the line twists.
        held, turned, last: of nodes: those whose angle is given, those that `turn` turns, those that `torque` acts on.
    """

    def __init__(self, geometry: Graph, effect: Torsion) -> None:
        self.node = np.concatenate([np.arange(s.start, s.stop) + i for i, s in enumerate(geometry.spans)])
        nodes = geometry.links + len(geometry.members)
        self.twists, self.held = np.zeros(geometry.links), np.ones(nodes, bool)
        self.turned, self.last = np.zeros(nodes), np.zeros(nodes)
        for i, (member, span) in enumerate(zip(geometry.members, geometry.spans, strict=True)):
            if effect.lines and member.name not in effect.lines:
                continue
            first = span.start + i
            last = span.stop + i
            self.twists[span] = 1.0
            self.held[first : last + 1] = False
            self.held[first], self.held[last] = effect.first == "held", effect.last == "held"
            if effect.last == "held":
                self.turned[last] = 1.0
            else:
                self.last[last] = 1.0

    def differences(self, phi: jax.Array) -> jax.Array:
        """Over the links (n,)."""
        return phi[self.node + 1] - phi[self.node]

    def sums(self, first: jax.Array, last: jax.Array) -> jax.Array:
        """Values of links (n,) at their first and last nodes, summed on the nodes (nodes,)."""
        empty = jnp.zeros(len(self.held), first.dtype)
        return empty.at[self.node].add(first) + empty.at[self.node + 1].add(last)

    def at_nodes(self, torque: jax.Array) -> jax.Array:
        """Sums of torques (n,) that act on the last nodes of links, and with the opposite sign on the first."""
        return self.sums(-torque, torque)

    def solve(self, diagonal: jax.Array, between: jax.Array, right: jax.Array, goal: jax.Array) -> jax.Array:
        """x of `(diagonal + K) x = right`, K of springs `between` the nodes of links (n,), with x = goal at prescribed
        nodes."""
        between = self.twists * between
        low = self.sums(jnp.zeros_like(between), -between)
        up = self.sums(-between, jnp.zeros_like(between))
        free = ~self.held
        own = jnp.where(free, diagonal + self.sums(between, between), 1.0)
        right = jnp.where(free, right, goal)
        return solve_tridiagonal(jnp.where(free, low, 0.0), own, jnp.where(free, up, 0.0), right)
