"""Wakes of lines in a current: Gaussian, each with the momentum of its drag, added so that momentum is conserved.

Element i of frontal area A_i and drag coefficient C_i at (x_i, y_i, z_i), x along the current, has the inflow u_i and
the drag `T_i/rho = 1/2 C_i A_i u_i^2`. Its wake is `u_i - a g(y) h(z)`, whose width grows as that of a plane
turbulent wake (Schlichting, Boundary-Layer Theory: half-width 0.25 sqrt(C D x), thus sigma^2 = 0.0451 C D x) and with
the turbulence of the water, `sigma = I x`; surface and seabed reflect it. The amplitude follows from momentum,

    integral (u_i - a g h) a g h dA = T_i/rho,

and wakes are added by Zong and Porte-Agel (2020): `U_s = sum_i (c_i/U_c) a_i g_i h_i` with the convection velocities
`c_i = u_i - a_i int(g h)^2/int(g h)` of each and `U_c = U - int U_s^2/int U_s` of all, found together (here a quadratic
equation). Thus `rho int (U - U_s) U_s dA = sum T_i` at every x. Drag and deficit are solved together, going downstream.

The model omits the flow around a dense farm due to pressure, and the turbulence of wakes. If the drag of a dense farm
exceeds the momentum of the water in the wake (at a deficit of about half), the deficit is limited and the wake contains
less momentum than the drag. `Wakes.balance` is their ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Growth of sigma^2 over C D x: (0.25/1.1774)^2.
GROWTH = (0.25 / 1.1774) ** 2
#: Sigma at the element over C D: the deficit there is about half of the flow.
START = 0.5
#: Number of heights over the depth for the integration of wakes.
HEIGHTS = 48
#: Distance in diameters behind an element at which its wake starts.
BEHIND = 2.0


@dataclass(frozen=True)
class Elements:
    """Elements of lines (n,): positions [m], x along the current, extents across it [m], diameter [m], drag
    coefficient."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    wide: np.ndarray
    high: np.ndarray
    diameter: np.ndarray
    drag: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """Frontal area (n,) [m^2]."""
        return self.diameter * np.hypot(self.wide, self.high)


@dataclass(frozen=True)
class Wakes:
    """Solved wakes: the current [m/s] without them, inflow of each element (n,) [m/s], its drag over rho (n,)."""

    elements: Elements
    speed: float
    depth: float
    turbulence: float
    met: np.ndarray
    drag: np.ndarray

    @property
    def balance(self) -> float:
        """Momentum deficit in the wake behind all elements over their total drag: 1, or less in a farm that is too
        dense."""
        total = float(np.sum(self.drag))
        end = float(np.max(self.elements.x)) + 10.0 * float(np.max(self.elements.diameter))
        return self.plane(end).momentum / total if total > 0.0 else 1.0

    def plane(self, x: float) -> Plane:
        """The wakes of all elements upstream of x [m]."""
        first = self.elements.x < x - BEHIND * self.elements.diameter
        return _plane(self.elements, first, self.met, self.drag, x, self.speed, self.depth, self.turbulence)

    def velocity(self, x: np.ndarray, y: np.ndarray, z: float) -> np.ndarray:
        """Velocity (nx, ny) [m/s] over a grid at a height [m]."""
        return np.array([self.speed - self.plane(one).deficit(y, np.array([z]))[:, 0] for one in x])


@dataclass(frozen=True)
class Plane:
    """Wakes at one x: centres, widths, profiles over `heights`, amplitudes with their weights c_i/U_c."""

    y: np.ndarray
    z: np.ndarray
    wide: np.ndarray
    high: np.ndarray
    amplitude: np.ndarray
    depth: float
    momentum: float

    def deficit(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """U_s (ny, nz) [m/s]."""
        across = np.exp(-0.5 * ((y[:, None] - self.y) / self.wide) ** 2)
        return across * self.amplitude @ _upright(z, self.z, self.high, self.depth)


def solve_wakes(elements: Elements, speed: float, depth: float, turbulence: float = 0.05) -> Wakes:
    """Wakes of elements in a current [m/s] over a depth [m], from upstream to downstream.

    Args:
        turbulence: of the water without the farm, rms over mean.
    """
    met, drag = np.full(len(elements.x), float(speed)), np.zeros(len(elements.x))
    at, plane, first = -np.inf, None, np.zeros(len(met), bool)
    for i in np.argsort(elements.x, kind="stable"):
        if elements.x[i] > at + 0.5 * BEHIND * elements.diameter[i]:  # elements next to each other share a plane
            at = elements.x[i]
            first = elements.x < at - BEHIND * elements.diameter
            plane = _plane(elements, first, met, drag, at, speed, depth, turbulence) if np.any(first) else None
        if plane is not None:
            # at its centre, where Gaussians of this width equal a box of this extent
            lost = plane.deficit(elements.y[i : i + 1], elements.z[i : i + 1])
            met[i] = max(speed - float(lost[0, 0]), 0.0)
        drag[i] = 0.5 * elements.drag[i] * elements.area[i] * met[i] ** 2
    return Wakes(elements, float(speed), float(depth), turbulence, met, drag)


def _upright(z: np.ndarray, centre: np.ndarray, high: np.ndarray, depth: float) -> np.ndarray:
    """h_i (n, nz): Gaussians over z, mirrored at the surface and at the seabed."""
    found = np.zeros((len(centre), len(z)))
    for mirror in (centre, -centre, -2.0 * depth - centre):
        found += np.exp(-0.5 * ((z - mirror[:, None]) / high[:, None]) ** 2)
    return found


def _plane(
    elements: Elements,
    first: np.ndarray,
    met: np.ndarray,
    drag: np.ndarray,
    x: float,
    speed: float,
    depth: float,
    turbulence: float,
) -> Plane:
    """Amplitudes at x of the wakes of the elements `first`."""
    e, away = elements, x - elements.x[first]
    size = (e.drag * e.diameter)[first]
    grown = (START * size) ** 2 + GROWTH * size * away + (turbulence * away) ** 2
    wide = np.sqrt(grown + e.wide[first] ** 2 / (2 * np.pi))
    high = np.sqrt(grown + e.high[first] ** 2 / (2 * np.pi))
    y, z, u, thrust = e.y[first], e.z[first], met[first], drag[first]
    nodes, weight = np.polynomial.legendre.leggauss(HEIGHTS)
    upright = _upright(0.5 * depth * (nodes - 1.0), z, high, depth)
    weight = 0.5 * depth * weight
    one = np.sqrt(2 * np.pi) * wide * (upright @ weight)
    spread = wide[:, None] ** 2 + wide**2
    across = np.sqrt(2 * np.pi) * wide[:, None] * wide / np.sqrt(spread)
    both = across * np.exp(-0.5 * (y[:, None] - y) ** 2 / spread) * ((upright * weight) @ upright.T)
    two = np.diag(both)
    # a wake cannot take more than a quarter of int(g h)^2/int((g h)^2) u^2
    root = np.sqrt(np.clip((u * one) ** 2 - 4.0 * two * thrust, 0.0, None))
    amplitude = (u * one - root) / (2.0 * two)
    carried = u - amplitude * two / one
    # with U_s = b sum_i c_i a_i g_i h_i, b = 1/U_c, momentum is a quadratic equation of b
    share = amplitude * carried
    wanted, square = float(share @ one), float(share @ both @ share)
    left = (speed * wanted) ** 2 - 4.0 * square * wanted
    share = share * (speed * wanted - np.sqrt(max(left, 0.0))) / (2.0 * square) if square > 0.0 else share
    momentum = speed * float(share @ one) - float(share @ both @ share)
    return Plane(y, z, wide, high, share, depth, momentum)
