"""Prescribed points that another program moves, interval by interval."""

from __future__ import annotations

import jax
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import as_array
from dropper_jax.effects.end_motion import quintic_of_end
from dropper_jax.model import Effect


@component
class CoupledMotion(Effect):
    """Positions of prescribed points between two instants at which another program gives them (see `coupling.coupled`).

    A cubic interpolates positions and velocities; with accelerations a quintic, in s = (t - begin)/width. The given
    values at both ends are met exactly. Rows are points, in the order of `points`; scenes cannot list this effect.
    """

    name = "coupled_motion"
    begin: Array = parameter("first instant", unit="s")
    width: Array = parameter("time to the second one", unit="s")
    home: Array = parameter("positions of the points in the scene (c, 3)", unit="m", shape="vectors")
    positions: Array = parameter("at both instants (2, c, 3)", unit="m", shape="vectors")
    velocities: Array = parameter("at both instants (2, c, 3)", unit="m/s", shape="vectors")
    accelerations: Array | None = parameter("at both instants (2, c, 3)", unit="m/s^2", shape="vectors", default=None)
    points: tuple[str, ...] = option("names of the points", type=list, default=())

    def moves(self, name: str) -> bool:
        return name in self.points

    def motion_of(self, name: str) -> Effect:
        i = self.points.index(name)
        given = (self.positions, self.velocities, self.accelerations)
        own = jax.tree.map(lambda rows: rows[:, i : i + 1], given)
        return CoupledMotion(self.begin, self.width, self.home[i : i + 1], *own, points=(name,))

    def displace(self, t: Array) -> Array:
        """Displacement (3,) [m] of the first point from its position in the scene at time t [s]."""
        h = self.width
        s = (t - self.begin) / h
        x0, x1 = self.positions[:, 0] - self.home[0]
        v0, v1 = self.velocities[:, 0]
        if self.accelerations is None:
            moved = s * s * (3 - 2 * s) * (x1 - x0) + h * (s * (1 - s) ** 2 * v0 - s * s * (1 - s) * v1)
            return x0 + moved
        a0, a1 = self.accelerations[:, 0]
        q = 1 - s
        return quintic_of_end(s, q, h, x0, v0, a0) + quintic_of_end(q, s, -h, x1, v1, a1)

    @classmethod
    def uniform(
        cls, points: tuple[str, ...], positions: np.ndarray, velocities: np.ndarray, bent: bool
    ) -> CoupledMotion:
        """Points that leave their positions (c, 3) [m] at time 0 with velocities [m/s]; `bent` with accelerations."""
        return cls(
            begin=as_array(0.0),
            width=as_array(1.0),
            home=as_array(positions),
            positions=as_array([positions, positions + velocities]),
            velocities=as_array([velocities, velocities]),
            accelerations=as_array(np.zeros((2, *positions.shape))) if bent else None,
            points=points,
        )
