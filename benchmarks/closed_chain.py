"""Truth that another program makes: point masses on rigid links, integrated by SciPy in Cartesian nodes."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

G = 9.81
#: Damping over the mass of a chain that settles [1/s].
SETTLING = 10.0


def rigid_line(
    t: np.ndarray,
    r0: np.ndarray,
    v0: np.ndarray,
    lengths: np.ndarray,
    masses: np.ndarray,
    *,
    b_l: float,
    b_q: float = 0.0,
    stiffness: float = 0.0,
    ends: tuple[Callable[[float], np.ndarray], ...] = (),
) -> np.ndarray:
    """Nodes (times, n + 1, 3) [m] of point masses on rigid links, by SciPy's DOP853 on Lagrange's first kind.

        m a = m g - b_l v - b_q |v| v - K r + G' lam,      d_j . a_j = -|d_j'|^2 - 2 w (d.d') - w^2 (|d|^2 - L^2)/2

    d_j the links, K of the bending energy `EI/(2 l) sum |d_(j+1)/L - d_j/L|^2` (on links of constant length the same as
    of unit vectors), the last terms hold the lengths (Baumgarte, w = 20/s).

    Args:
        r0, v0: nodes at the start (n + 1, 3), both ends included.
        masses: of the free nodes.
        stiffness: EI [N m^2].
        ends: places, velocities and accelerations of the held ends (held, 9) over time; of one end: it is the first.
    """
    n = len(lengths)
    held = len(ends)
    free = np.arange(1, n) if held == 2 else np.arange(1, n + 1)
    difference = np.diff(np.eye(n + 1), axis=0)
    bend = np.diff(difference / lengths[:, None], axis=0)
    between = 0.5 * (lengths[1:] + lengths[:-1])
    spring = stiffness * bend.T @ (bend / between[:, None])
    own = difference[:, free]
    gravity = np.array([0.0, 0.0, -G])
    hold = 20.0

    def whole(time: float, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r = np.zeros((n + 1, 3))
        v = np.zeros((n + 1, 3))
        a = np.zeros((n + 1, 3))
        r[free], v[free] = state.reshape(2, -1, 3)
        for node, end in zip((0, n), ends, strict=False):
            r[node], v[node], a[node] = end(time).reshape(3, 3)
        return r, v, a

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        r, v, a = whole(time, state)
        speed = np.linalg.norm(v[free], axis=1, keepdims=True)
        force = masses[:, None] * gravity - b_l * v[free] - b_q * speed * v[free] - (spring @ r)[free]
        d = difference @ r
        dd = difference @ v
        rows = own[:, :, None] * d[:, None, :]
        flat = rows.reshape(n, -1)
        off = 2 * hold * np.sum(d * dd, 1) + 0.5 * hold**2 * (np.sum(d * d, 1) - lengths**2)
        goal = -np.sum(dd * dd, 1) - off - np.sum(d * (difference @ a), 1)
        inverse = np.repeat(1 / masses, 3)
        pull = np.linalg.solve((flat * inverse) @ flat.T, goal - flat @ (inverse * force.ravel()))
        return np.concatenate([v[free].ravel(), inverse * (force.ravel() + flat.T @ pull)])

    first = np.concatenate([r0[free].ravel(), v0[free].ravel()])
    found = solve_ivp(rate, (0.0, float(t[-1])), first, "DOP853", t, rtol=1e-9, atol=1e-11)
    if not found.success:
        raise RuntimeError(found.message)
    return np.array([whole(time, y)[0] for time, y in zip(t, found.y.T, strict=True)])


def still(place: np.ndarray) -> Callable[[float], np.ndarray]:
    """An end at rest."""
    return lambda _: np.concatenate([place, np.zeros(6)])


@dataclass(frozen=True)
class Chain:
    """A chain of n links in the plane (x, z) between two held ends; its places are those of the nodes between them.

    Attributes:
        length: of the links (n,) [m].
        mass: of the nodes between them (n - 1,) [kg].
        end: place of the second end (2,) [m], the first is at 0.
        linear, quadratic: damping [kg/s], [kg/m].
    """

    length: np.ndarray
    mass: np.ndarray
    end: np.ndarray
    linear: float
    quadratic: float

    def links(self, p: np.ndarray) -> np.ndarray:
        """Link vectors (..., n, 2) of inner nodes (..., n - 1, 2)."""
        first, last = (np.broadcast_to(end, (*p.shape[:-2], 1, 2)) for end in (np.zeros(2), self.end))
        return np.diff(np.concatenate([first, p, last], axis=-2), axis=-2)

    def pose(self, polar: np.ndarray) -> np.ndarray:
        """Inner nodes whose first n - 2 links have these angles from the horizontal, positive downwards [rad]."""
        given = len(self.length) - 2

        def gap(last: np.ndarray) -> np.ndarray:
            d = self.length[:, None] * _unit(np.concatenate([polar[:given], last]))
            return d.sum(axis=0) - self.end

        angle = np.concatenate([polar[:given], fsolve(gap, polar[given:], xtol=1e-13)])
        return np.cumsum(self.length[:, None] * _unit(angle), axis=0)[:-1]

    def hanging(self, polar: np.ndarray) -> np.ndarray:
        """Inner nodes at rest, near a pose: where a damped swing from it ends."""
        return replace(self, linear=self.mass.mean() * SETTLING, quadratic=0.0).swing(polar, np.array([0.0, 20.0]))[-1]

    def swing(self, polar: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Inner nodes (k, n - 1, 2) at times t (k,) from 0 on, released at rest."""
        nodes = in_space(np.concatenate([np.zeros((1, 2)), self.pose(polar), self.end[None]]))
        damping = {"b_l": self.linear, "b_q": self.quadratic}
        ends = (still(nodes[0]), still(nodes[-1]))
        path = rigid_line(t, nodes, np.zeros_like(nodes), self.length, self.mass, **damping, ends=ends)
        return path[:, 1:-1, [0, 2]]

    def angles(self, p: np.ndarray) -> np.ndarray:
        """Polar angles (k, n) of inner nodes (k, n - 1, 2), without jumps."""
        d = self.links(p)
        return np.unwrap(np.arctan2(-d[..., 1], d[..., 0]), axis=0)


def in_space(places: np.ndarray) -> np.ndarray:
    """Places (..., 3) in the plane y = 0 of places (..., 2)."""
    return np.insert(places, 1, 0.0, axis=-1)


def _unit(polar: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(polar), -np.sin(polar)], axis=-1)
