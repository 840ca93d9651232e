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
from collections.abc import Iterator

import numpy as np

#: Growth of sigma^2 over C D x: (0.25/1.1774)^2.
WAKE_GROWTH = (0.25 / 1.1774) ** 2
#: Sigma at the element over C D: the deficit there is about half of the flow.
START_WIDTH = 0.5
#: Distance in diameters behind an element at which its wake starts.
START_DISTANCE = 2.0
#: Distance in diameters behind the last element at which the momentum balance is evaluated: all wakes have started.
BALANCE_DISTANCE = 10.0
#: Default turbulence intensity of the current (assumed).
TURBULENCE = 0.05
#: Periods of the Fourier modes for each doubling: more follow the widths closer, but need new phases more often.
PERIODS_PER_OCTAVE = 4
#: Numbers in a block of a product, so few that BLAS uses one thread.
BLOCK_SIZE = 2**18


@dataclasses.dataclass(frozen=True)
class Elements:
    """Elements of lines (n,), of each the centre, the extents across the current, and what determines its drag.

    Attributes:
        x: position along the current [m].
        y: position across it [m].
        z: height [m].
        width: horizontal extent across the current [m].
        height: vertical extent [m].
        diameter: diameter [m].
        drag_coefficient: drag coefficient on the frontal area.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    width: np.ndarray
    height: np.ndarray
    diameter: np.ndarray
    drag_coefficient: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """Frontal area (n,) [m^2]."""
        return self.diameter * np.hypot(self.width, self.height)


@dataclasses.dataclass(frozen=True)
class Plane:
    """Wakes at one x.

    Attributes:
        y: centres across the current (n,) [m].
        z: heights of the centres (n,) [m].
        sigma_y: standard deviations across the current (n,) [m].
        sigma_z: vertical standard deviations (n,) [m].
        amplitude: amplitudes times c_i/U_c (n,) [m/s].
        depth: of the water [m].
        momentum: momentum deficit over rho [m^4/s^2].
    """

    y: np.ndarray
    z: np.ndarray
    sigma_y: np.ndarray
    sigma_z: np.ndarray
    amplitude: np.ndarray
    depth: float
    momentum: float

    def deficit_on_grid(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """U_s (ny, nz) [m/s] at all pairs of y (ny,) and z (nz,) [m]."""
        across = np.exp(-0.5 * ((y[:, None] - self.y) / self.sigma_y) ** 2)
        return across * self.amplitude @ _vertical_profiles(z, self.z, self.sigma_z, self.depth)

    def deficit_at(self, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """U_s (k,) [m/s] at positions y, z (k,) [m]."""
        across = _overwrite_with_gaussian((y - self.y[:, None]) / self.sigma_y[:, None])
        profiles = _vertical_profiles(z, self.z, self.sigma_z, self.depth)
        return np.einsum("i,ik->k", self.amplitude, across * profiles)


@dataclasses.dataclass
class WakeSolver:
    """Wakes of elements in a uniform current, solved from upstream to downstream.

    Sums are exact to rounding: they leave out pairs and Fourier modes below exp(-reach^2/2) = 1e-14 of their maximum.

    Attributes:
        elements: elements of the lines.
        speed: current without the wakes [m/s].
        depth: of the water [m].
        turbulence: of the water without the farm, rms over mean.
        reach: distance in sigma, and wave number times sigma, from which Gaussians and their spectra are left out.
        modes: number of Fourier modes across the current. Wakes too narrow for them are summed by pairs.
        chunk: wakes in one array operation, few enough for the cache.
        heights: nodes of integrals over the depth: 48 change inflows of random lines in 25 m by 7e-7, 32 by 1e-4.
    """

    elements: Elements
    speed: float
    depth: float
    turbulence: float = TURBULENCE
    reach: float = 8.0
    modes: int = 384
    chunk: int = 256
    heights: int = 48
    #: Result of `_phases` for the latest period, by the period's number.
    _phase_cache: dict[int, tuple[float, np.ndarray]] = dataclasses.field(default_factory=dict, init=False, repr=False)

    def solve(self) -> Wakes:
        """The inflow and the drag of all elements: each plane contains the wakes of the elements solved before it."""
        e = self.elements
        inflow = np.full(len(e.x), self.speed)
        drag = np.zeros(len(e.x))
        half_drag_area = 0.5 * e.drag_coefficient * e.area
        for group in self._groups():
            plane = self.plane(e.x[group[0]], inflow, drag)
            for part in np.array_split(group, len(group) // self.chunk + 1):
                # at the centre, where the Gaussian equals a box of the element's extent
                inflow[part] = np.maximum(self.speed - plane.deficit_at(e.y[part], e.z[part]), 0.0)
            drag[group] = half_drag_area[group] * inflow[group] ** 2
        return Wakes(self, inflow, drag)

    def _groups(self) -> list[np.ndarray]:
        """Elements in the order of x, in groups next to each other that share a plane."""
        e = self.elements
        order = np.argsort(e.x, kind="stable")
        plane_x = -np.inf
        starts = []
        for k, i in enumerate(order):
            if e.x[i] > plane_x + 0.5 * START_DISTANCE * e.diameter[i]:
                plane_x = e.x[i]
                starts.append(k)
        return np.split(order, starts[1:])

    def plane(self, x: float, inflow: np.ndarray, drag: np.ndarray) -> Plane:
        """The wakes at x [m] of all elements upstream of it, from their inflow [m/s] and drag over rho [m^4/s^2]."""
        upstream, sigma_y, sigma_z = self._widths(x)
        y = self.elements.y[upstream]
        z = self.elements.z[upstream]
        profiles, area, square = self._integrals(z, sigma_y, sigma_z)
        flux = _momentum_per_area(inflow[upstream], drag[upstream], area, square)
        profiles *= (flux * sigma_y)[:, None]
        factor, momentum = self._combine(float(np.sum(flux * area)), self._squared_sum(upstream, sigma_y, profiles))
        return Plane(y, z, sigma_y, sigma_z, factor * flux, self.depth, momentum)

    def _widths(self, x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elements whose wakes have started at x, from the narrowest wake to the widest, and sigma_y, sigma_z [m]."""
        e = self.elements
        (upstream,) = np.nonzero(e.x < x - START_DISTANCE * e.diameter)
        distance = x - e.x[upstream]
        drag_width = (e.drag_coefficient * e.diameter)[upstream]
        variance = (START_WIDTH * drag_width) ** 2 + WAKE_GROWTH * drag_width * distance
        variance = variance + (self.turbulence * distance) ** 2
        # a Gaussian of this variance has the height and the area of a box of the element's extent
        sigma_y = np.sqrt(variance + e.width[upstream] ** 2 / (2 * np.pi))
        sigma_z = np.sqrt(variance + e.height[upstream] ** 2 / (2 * np.pi))
        order = np.argsort(sigma_y)
        return upstream[order], sigma_y[order], sigma_z[order]

    def _integrals(
        self, z: np.ndarray, sigma_y: np.ndarray, sigma_z: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Profiles h (n, nz) over the depth, `int g h dA` and `int (g h)^2 dA` (n,) [m^2]."""
        nodes, weight = depth_quadrature(self.heights, self.depth)
        profiles = np.empty((len(z), len(nodes)))
        area = np.empty(len(z))
        square = np.empty(len(z))
        for part in self._chunks(len(z)):
            profile = _vertical_profiles(nodes, z[part], sigma_z[part], self.depth)
            area[part] = np.sqrt(2 * np.pi) * sigma_y[part] * np.einsum("iz,z->i", profile, weight)
            square[part] = np.sqrt(np.pi) * sigma_y[part] * np.einsum("iz,iz,z->i", profile, profile, weight)
            profiles[part] = profile
        return profiles, area, square

    def _squared_sum(self, upstream: np.ndarray, sigma_y: np.ndarray, profiles: np.ndarray) -> float:
        """`int (sum_i c_i a_i g_i h_i)^2 dA` [m^6/s^4], from the profiles `c_i a_i sigma_y h_i` (n, nz).

        It is a sum over all pairs. Pairs with a wide wake are summed as Fourier modes across the current, at a cost
        proportional to the number of wakes, narrow wakes with those within reach.
        """
        spacing, phases = self._phases(sigma_y[-1] if len(sigma_y) else 1.0)
        narrow = int(np.searchsorted(sigma_y, self.reach / (spacing * self.modes)))
        of_narrow = self._spectrum(spacing, phases, upstream[:narrow], sigma_y[:narrow], profiles[:narrow])
        of_wide = self._spectrum(spacing, phases, upstream[narrow:], sigma_y[narrow:], profiles[narrow:])
        _, weight = depth_quadrature(self.heights, self.depth)
        both_signs = np.where(np.arange(self.modes) > 0, 2.0, 1.0)  # of the wave number
        wide = spacing * float(np.einsum("cqz,cqz,q,z->", of_wide, of_wide + 2.0 * of_narrow, both_signs, weight))
        y = self.elements.y[upstream[:narrow]]
        return wide + self._pair_sum(y, sigma_y[:narrow], profiles[:narrow] * np.sqrt(weight))

    def _phases(self, widest: float) -> tuple[float, np.ndarray]:
        """Spacing of the wave numbers [1/m] and cos, sin (n, 2, modes) of the elements' phases in the Fourier modes.

        Their period exceeds the farm's width by the reach of two wakes, so that no wake meets its periodic image. It
        grows in steps along the farm, so that few planes need new phases.
        """
        y = self.elements.y
        period = np.ptp(y) + np.sqrt(2.0) * self.reach * widest
        number = int(np.ceil(PERIODS_PER_OCTAVE * np.log2(period)))
        if number not in self._phase_cache:
            self._phase_cache.clear()
            spacing = 2 * np.pi / 2.0 ** (number / PERIODS_PER_OCTAVE)
            angle = spacing * np.arange(self.modes) * (y - np.min(y))[:, None]
            self._phase_cache[number] = spacing, np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return self._phase_cache[number]

    def _spectrum(
        self,
        spacing: float,
        phases: np.ndarray,
        upstream: np.ndarray,
        sigma_y: np.ndarray,
        profiles: np.ndarray,
    ) -> np.ndarray:
        """Cosine and sine parts (2, modes, nz) of the sum of wakes in each Fourier mode."""
        spectrum = np.zeros((2, self.modes, profiles.shape[1]))
        for part in self._chunks(len(sigma_y)):
            count = min(int(self.reach / (spacing * sigma_y[part.start])) + 1, self.modes)
            decay = _overwrite_with_gaussian(np.multiply.outer(sigma_y[part], spacing * np.arange(count)))
            waves = phases[upstream[part], :, :count] * decay[:, None]
            spectrum[:, :count] += _product(waves.reshape(len(decay), -1).T, profiles[part]).reshape(2, count, -1)
        return spectrum

    def _pair_sum(self, y: np.ndarray, sigma_y: np.ndarray, profiles: np.ndarray) -> float:
        """`_squared_sum` of profiles times the root of the weight over the depth, over all pairs within reach."""
        order = np.argsort(y)
        y, sigma_y, profiles = (values[order] for values in (y, sigma_y, profiles))
        total = 0.0
        for part in self._chunks(len(y)):
            end = int(np.searchsorted(y, y[part][-1] + np.sqrt(2.0) * self.reach * np.max(sigma_y)))
            near = slice(part.start, end)
            spread = np.sqrt(np.add.outer(sigma_y[part] ** 2, sigma_y[near] ** 2))
            products = _overwrite_with_gaussian(np.subtract.outer(y[part], y[near]) / spread) / spread
            products *= _product(profiles[part], profiles[near].T)
            # pairs within the chunk are in it in both orders, pairs with later wakes in one
            total += 2.0 * float(np.sum(products)) - float(np.sum(products[:, : len(y[part])]))
        return np.sqrt(2 * np.pi) * total

    def _combine(self, drag: float, square: float) -> tuple[float, float]:
        """Factor 1/U_c [s/m] and momentum deficit over rho [m^4/s^2] of `U_s = 1/U_c sum_i c_i a_i g_i h_i`.

        With the factor b, `int (U - U_s) U_s dA = drag` is `U b drag - b^2 square = drag`, a quadratic equation. The
        drag is that of all wakes over rho [m^4/s^2], or less where a wake cannot take it.
        """
        root = np.sqrt(max((self.speed * drag) ** 2 - 4.0 * square * drag, 0.0))
        factor = 1.0
        if square > 0.0:
            factor = (self.speed * drag - root) / (2.0 * square)
        return factor, self.speed * factor * drag - factor**2 * square

    def _chunks(self, count: int) -> Iterator[slice]:
        """Slices of `chunk` out of this number of wakes."""
        for start in range(0, count, self.chunk):
            yield slice(start, start + self.chunk)


@dataclasses.dataclass(frozen=True)
class Wakes:
    """Solved wakes.

    Attributes:
        solver: the solver, with the elements and the water.
        inflow: inflow of each element (n,) [m/s].
        drag: its drag over rho (n,) [m^4/s^2].
    """

    solver: WakeSolver
    inflow: np.ndarray
    drag: np.ndarray

    @property
    def elements(self) -> Elements:
        """Elements of the lines."""
        return self.solver.elements

    @property
    def speed(self) -> float:
        """Current without the wakes [m/s]."""
        return self.solver.speed

    @property
    def depth(self) -> float:
        """Depth of the water [m]."""
        return self.solver.depth

    @property
    def balance(self) -> float:
        """Momentum deficit in the wake behind all elements over their total drag: 1, or less in a farm that is too
        dense."""
        total = float(np.sum(self.drag))
        end = float(np.max(self.elements.x)) + BALANCE_DISTANCE * float(np.max(self.elements.diameter))
        return self.plane(end).momentum / total if total > 0.0 else 1.0

    def plane(self, x: float) -> Plane:
        """The wakes at x [m] of all elements upstream of it."""
        return self.solver.plane(x, self.inflow, self.drag)

    def velocity(self, x: np.ndarray, y: np.ndarray, z: float) -> np.ndarray:
        """Velocity (nx, ny) [m/s] over a grid at a height [m]."""
        heights = np.array([z])
        return np.array([self.speed - self.plane(at).deficit_on_grid(y, heights)[:, 0] for at in x])


def solve_wakes(elements: Elements, speed: float, depth: float, turbulence: float = TURBULENCE) -> Wakes:
    """Wakes of elements in a current [m/s] over a depth [m].

    Args:
        turbulence: of the water without the farm, rms over mean.
    """
    return WakeSolver(elements, float(speed), float(depth), turbulence).solve()


@functools.lru_cache(maxsize=8)
def depth_quadrature(count: int, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Gauss nodes (count,) [m] from the seabed at -depth to the surface at 0, and their weights [m], both read-only."""
    nodes, weight = np.polynomial.legendre.leggauss(count)
    found = 0.5 * depth * (nodes - 1.0), 0.5 * depth * weight
    for array in found:
        array.setflags(write=False)  # the cache shares them
    return found


def _momentum_per_area(inflow: np.ndarray, drag: np.ndarray, area: np.ndarray, square: np.ndarray) -> np.ndarray:
    """`c_i a_i` of each wake (n,) [m^2/s^2], from `area = int g h dA` and `square = int (g h)^2 dA`.

    The amplitude a solves `a area u - a^2 square = drag`. A wake cannot take more than `(u area)^2/(4 square)`.
    """
    root = np.sqrt(np.clip((inflow * area) ** 2 - 4.0 * square * drag, 0.0, None))
    amplitude = (inflow * area - root) / (2.0 * square)
    return amplitude * (inflow - amplitude * square / area)


def _overwrite_with_gaussian(distance: np.ndarray) -> np.ndarray:
    """`exp(-d^2/2)`; destroys `distance`, whose memory it uses: new arrays take longer than the exponentials."""
    distance *= distance
    distance *= -0.5
    return np.exp(distance, out=distance)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`a @ b` by blocks of rows: in small products the threads of BLAS wait for longer than they compute."""
    rows = max(BLOCK_SIZE // b.size, 1)
    return np.concatenate([a[start : start + rows] @ b for start in range(0, len(a), rows)])


def _vertical_profiles(z: np.ndarray, centre: np.ndarray, sigma_z: np.ndarray, depth: float) -> np.ndarray:
    """h_i (n, nz): Gaussians over z, mirrored at the surface and at the seabed."""
    found = np.zeros((len(centre), len(z)))
    for mirror in (centre, -centre, -2.0 * depth - centre):
        found += _overwrite_with_gaussian((z - mirror[:, None]) / sigma_z[:, None])
    return found
