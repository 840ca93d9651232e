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

import dataclasses
import functools
import itertools

import numpy as np

#: Growth of sigma^2 over C D x: (0.25/1.1774)^2.
WAKE_GROWTH = (0.25 / 1.1774) ** 2
#: Sigma at the element over C D: the deficit there is about half of the flow.
START = 0.5
#: Distance in diameters behind an element at which its wake starts.
BEHIND = 2.0


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True)
class Wakes:
    """Solved wakes: the current [m/s] without them, inflow of each element (n,) [m/s], its drag over rho (n,).

    Sums are exact to rounding: they leave out pairs and Fourier modes below exp(-reach^2/2) = 1e-14 of their maximum.

    Attributes:
        reach: distance in sigma, and wave number times sigma, from which Gaussians and their spectra are left out.
        modes: number of Fourier modes across the current. Wakes too narrow for them are summed by pairs.
        chunk: wakes in one array operation, few enough for the cache.
        heights: nodes of integrals over the depth.
        phases: of the elements in the Fourier modes, by size of the period.
    """

    elements: Elements
    speed: float
    depth: float
    turbulence: float
    met: np.ndarray
    drag: np.ndarray
    reach: float = 8.0
    modes: int = 384
    chunk: int = 256
    heights: int = 48
    phases: dict[int, tuple[float, np.ndarray]] = dataclasses.field(default_factory=dict, repr=False)

    @property
    def balance(self) -> float:
        """Momentum deficit in the wake behind all elements over their total drag: 1, or less in a farm that is too
        dense."""
        total = float(np.sum(self.drag))
        end = float(np.max(self.elements.x)) + 10.0 * float(np.max(self.elements.diameter))
        return self.plane(end).momentum / total if total > 0.0 else 1.0

    def _phases(self, widest: float) -> tuple[float, np.ndarray]:
        """Step of the wave number [1/m] and cos, sin (n, 2, modes) of the phase of each element in the Fourier modes.

        Their period exceeds the farm's width by the reach of two wakes, so that no wake meets its periodic image. It
        grows in steps along the farm, so that few planes need new phases.
        """
        y = self.elements.y
        size = int(np.ceil(4.0 * np.log2(np.ptp(y) + np.sqrt(2.0) * self.reach * widest)))
        if size not in self.phases:
            self.phases.clear()
            step = 2 * np.pi / 2.0 ** (size / 4)
            angle = step * np.arange(self.modes) * (y - np.min(y))[:, None]
            self.phases[size] = step, np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return self.phases[size]

    def plane(self, x: float) -> Plane:
        """The wakes at x [m] of all elements upstream of it.

        Momentum contains `int U_s^2 dA`, a sum over all pairs. Pairs with a wide wake are summed as Fourier modes
        across the current, at a cost proportional to the number of wakes, narrow wakes with those within reach.
        """
        e = self.elements
        (first,) = np.nonzero(e.x < x - BEHIND * e.diameter)
        away = x - e.x[first]
        size = (e.drag * e.diameter)[first]
        grown = (START * size) ** 2 + WAKE_GROWTH * size * away + (self.turbulence * away) ** 2
        wide = np.sqrt(grown + e.wide[first] ** 2 / (2 * np.pi))
        order = np.argsort(wide)
        first = first[order]
        wide = wide[order]
        high = np.sqrt(grown[order] + e.high[first] ** 2 / (2 * np.pi))
        y, z, u, thrust = (values[first] for values in (e.y, e.z, self.met, self.drag))
        step, phases = self._phases(wide[-1] if len(wide) else 1.0)
        narrow = int(np.searchsorted(wide, self.reach / (step * self.modes)))
        nodes, weight = _heights(self.heights, self.depth)
        share = np.empty(len(wide))
        one = np.empty(len(wide))
        profiles = np.empty((narrow, len(nodes)))
        of_narrow, of_wide = np.zeros((2, 2, self.modes, len(nodes)))
        bounds = [*range(0, narrow, self.chunk), *range(narrow, len(wide), self.chunk), len(wide)]
        for start, stop in itertools.pairwise(bounds):
            part = slice(start, stop)
            upright = _upright(nodes, z[part], high[part], self.depth)
            one[part] = np.sqrt(2 * np.pi) * wide[part] * np.einsum("iz,z->i", upright, weight)
            two = np.sqrt(np.pi) * wide[part] * np.einsum("iz,iz,z->i", upright, upright, weight)
            # a wake cannot take more than a quarter of int(g h)^2/int((g h)^2) u^2
            root = np.sqrt(np.clip((u[part] * one[part]) ** 2 - 4.0 * two * thrust[part], 0.0, None))
            amplitude = (u[part] * one[part] - root) / (2.0 * two)
            share[part] = amplitude * (u[part] - amplitude * two / one[part])
            upright *= (share[part] * wide[part])[:, None]
            if start < narrow:
                profiles[part] = upright
            count = min(int(self.reach / (step * wide[start])) + 1, self.modes)
            waves = phases[first[part], :, :count]
            waves *= _gaussian(np.multiply.outer(wide[part], step * np.arange(count)))[:, None]
            total = of_narrow if start < narrow else of_wide
            total[:, :count] += _product(waves.reshape(stop - start, -1).T, upright).reshape(2, count, -1)
        twice = np.where(np.arange(self.modes) > 0, 2.0, 1.0)  # positive and negative wave numbers
        square = step * float(np.einsum("cqz,cqz,q,z->", of_wide, of_wide + 2.0 * of_narrow, twice, weight))
        square += self._pair_sum(y[:narrow], wide[:narrow], profiles * np.sqrt(weight))
        # with U_s = b sum_i c_i a_i g_i h_i, b = 1/U_c, momentum is a quadratic equation of b
        wanted = float(np.sum(share * one))
        left = (self.speed * wanted) ** 2 - 4.0 * square * wanted
        scale = 1.0
        if square > 0.0:
            scale = (self.speed * wanted - np.sqrt(max(left, 0.0))) / (2.0 * square)
        momentum = self.speed * scale * wanted - scale**2 * square
        return Plane(y, z, wide, high, scale * share, self.depth, momentum)

    def _pair_sum(self, y: np.ndarray, wide: np.ndarray, profile: np.ndarray) -> float:
        """`int U_s^2 dA` of wakes with profiles (n, nz) over the depth, over all pairs within reach across it."""
        order = np.argsort(y)
        y, wide, profile = (values[order] for values in (y, wide, profile))
        total = 0.0
        for start in range(0, len(y), self.chunk):
            stop = min(start + self.chunk, len(y))
            end = int(np.searchsorted(y, y[stop - 1] + np.sqrt(2.0) * self.reach * np.max(wide)))
            spread = np.add.outer(wide[start:stop] ** 2, wide[start:end] ** 2)
            across = _gaussian(np.subtract.outer(y[start:stop], y[start:end]) / np.sqrt(spread)) / np.sqrt(spread)
            across *= _product(profile[start:stop], profile[start:end].T)
            total += 2.0 * float(np.sum(across)) - float(np.sum(across[:, : stop - start]))
        return np.sqrt(2 * np.pi) * total

    def velocity(self, x: np.ndarray, y: np.ndarray, z: float) -> np.ndarray:
        """Velocity (nx, ny) [m/s] over a grid at a height [m]."""
        return np.array([self.speed - self.plane(one).deficit(y, np.array([z]))[:, 0] for one in x])


@dataclasses.dataclass(frozen=True)
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

    def deficit_at(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """U_s (n,) [m/s] at positions (y_k, z_k)."""
        across = _gaussian((y - self.y[:, None]) / self.wide[:, None])
        return np.einsum("i,ik->k", self.amplitude, across * _upright(z, self.z, self.high, self.depth))


def solve_wakes(elements: Elements, speed: float, depth: float, turbulence: float = 0.05) -> Wakes:
    """Wakes of elements in a current [m/s] over a depth [m], from upstream to downstream.

    Args:
        turbulence: of the water without the farm, rms over mean.
    """
    count = len(elements.x)
    wakes = Wakes(elements, float(speed), float(depth), turbulence, np.full(count, float(speed)), np.zeros(count))
    order = np.argsort(elements.x, kind="stable")
    at = -np.inf
    starts = []
    for k, i in enumerate(order):
        if elements.x[i] > at + 0.5 * BEHIND * elements.diameter[i]:  # elements next to each other share a plane
            at = elements.x[i]
            starts.append(k)
    facing = 0.5 * elements.drag * elements.area
    for together in np.split(order, starts[1:]):
        plane = wakes.plane(elements.x[together[0]])
        for some in np.array_split(together, len(together) // wakes.chunk + 1):
            # at its centre, where Gaussians of this width equal a box of this extent
            lost = plane.deficit_at(elements.y[some], elements.z[some])
            wakes.met[some] = np.maximum(wakes.speed - lost, 0.0)
        wakes.drag[together] = facing[together] * wakes.met[together] ** 2
    return wakes


@functools.lru_cache(maxsize=8)
def _heights(count: int, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes and weights (count,) [m] over the depth."""
    nodes, weight = np.polynomial.legendre.leggauss(count)
    return 0.5 * depth * (nodes - 1.0), 0.5 * depth * weight


def _gaussian(distance: np.ndarray) -> np.ndarray:
    """`exp(-d^2/2)`, in the memory of d: new arrays of this size take longer than the exponentials."""
    distance *= distance
    distance *= -0.5
    return np.exp(distance, out=distance)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`a @ b` by blocks of rows so small that BLAS uses one thread: its threads wait for longer than they compute."""
    rows = max(2**18 // b.size, 1)
    return np.concatenate([a[start : start + rows] @ b for start in range(0, len(a), rows)])


def _upright(z: np.ndarray, centre: np.ndarray, high: np.ndarray, depth: float) -> np.ndarray:
    """h_i (n, nz): Gaussians over z, mirrored at the surface and at the seabed."""
    found = np.zeros((len(centre), len(z)))
    for mirror in (centre, -centre, -2.0 * depth - centre):
        found += _gaussian((z - mirror[:, None]) / high[:, None])
    return found
