"""Truth that another program makes: masses on a chain between two held ends, integrated by SciPy in Cartesian nodes.

With p_i the nodes' places in the plane (x, z), M_i their masses, links' lengths held by multipliers l_j,

    M_i p_i'' = -M_i g e_z - b_l p_i' - b_q |p_i'| p_i' + sum_j l_j dc_j/dp_i
    c_j = (|p_{j+1} - p_j|^2 - L_j^2)/2 = 0

where c_j'' = 0 gives the multipliers at every instant. DOP853 at 1e-9 keeps the lengths to 1e-8 in 12 s.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

G = 9.81


@dataclass(frozen=True)
class Chain:
    """A chain of n links.

    Attributes:
        length: of the links (n,) [m].
        mass: of the nodes between them (n - 1,) [kg].
        end: place of the second end (2,) [m], the first is at 0.
        linear, quadratic: damping [kg/s], [kg/m].
        gravity: components along x and z (2,) [m/s^2]; a tilted one is a rolled camera.
    """

    length: np.ndarray
    mass: np.ndarray
    end: np.ndarray
    linear: float
    quadratic: float
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, -G]))

    def links(self, p: np.ndarray) -> np.ndarray:
        """Link vectors (..., n, 2) of inner nodes (..., n - 1, 2)."""
        whole = np.concatenate(
            [np.zeros((*p.shape[:-2], 1, 2)), p, np.broadcast_to(self.end, (*p.shape[:-2], 1, 2))], -2
        )
        return np.diff(whole, axis=-2)

    def pose(self, polar: np.ndarray) -> np.ndarray:
        """Inner nodes whose first n - 2 links have these angles from the horizontal, positive downwards [rad]."""
        given = len(self.length) - 2

        def gap(last: np.ndarray) -> np.ndarray:
            d = self.length[:, None] * _unit(np.concatenate([polar[:given], last]))
            return d.sum(axis=0) - self.end

        angle = np.concatenate([polar[:given], fsolve(gap, polar[given:], xtol=1e-13)])
        return np.cumsum(self.length[:, None] * _unit(angle), axis=0)[:-1]

    def hanging(self, polar: np.ndarray) -> np.ndarray:
        """Inner nodes at rest, near a pose: forces of weight and links in balance, lengths kept."""
        n = len(self.length)

        def balance(x: np.ndarray) -> np.ndarray:
            d = self.links(x[: 2 * n - 2].reshape(-1, 2))
            pull = x[2 * n - 2 :, None] * d
            force = pull[1:] - pull[:-1] + self.mass[:, None] * self.gravity
            return np.concatenate([force.ravel(), np.sum(d**2, axis=1) - self.length**2])

        begun = np.concatenate([self.pose(polar).ravel(), np.full(n, self.mass.mean() * G / self.length.mean())])
        found, _, ok, message = fsolve(balance, begun, xtol=1e-13, full_output=True)
        if ok != 1 or np.abs(balance(found)).max() > 1e-9:
            raise RuntimeError(message)
        return found[: 2 * n - 2].reshape(-1, 2)

    def acceleration(self, p: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Of the inner nodes (n - 1, 2)."""
        d, w = self.links(p), np.diff(np.concatenate([np.zeros((1, 2)), v, np.zeros((1, 2))]), axis=0)
        force = self.mass[:, None] * self.gravity - self.linear * v
        force = force - self.quadratic * np.linalg.norm(v, axis=1, keepdims=True) * v
        inner, n = len(p), len(d)
        slope = np.zeros((n, inner, 2))
        for j in range(n):
            if j < inner:
                slope[j, j] = d[j]
            if j:
                slope[j, j - 1] = -d[j]
        flat, inverse = slope.reshape(n, -1), np.repeat(1 / self.mass, 2)
        right = -np.sum(w**2, axis=1) - flat @ (inverse * force.ravel())
        pull = np.linalg.solve((flat * inverse) @ flat.T, right)
        return (inverse * (force.ravel() + flat.T @ pull)).reshape(-1, 2)

    def swing(self, polar: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Inner nodes (k, n - 1, 2) at times t (k,), let go at rest at t[0]."""
        p, size = self.pose(polar), 2 * (len(self.length) - 1)

        def slope(_: float, y: np.ndarray) -> np.ndarray:
            v = y[size:].reshape(-1, 2)
            return np.concatenate([y[size:], self.acceleration(y[:size].reshape(-1, 2), v).ravel()])

        y0 = np.concatenate([p.ravel(), np.zeros(size)])
        found = solve_ivp(slope, (t[0], t[-1]), y0, method="DOP853", t_eval=t, rtol=1e-9, atol=1e-10)
        return found.y[:size].T.reshape(len(t), -1, 2)

    def angles(self, p: np.ndarray) -> np.ndarray:
        """Polar angles (k, n) of inner nodes (k, n - 1, 2), without jumps."""
        d = self.links(p)
        return np.unwrap(np.arctan2(-d[..., 1], d[..., 0]), axis=0)


def _unit(polar: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(polar), -np.sin(polar)], axis=-1)
