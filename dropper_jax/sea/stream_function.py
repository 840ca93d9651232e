"""Waves by the stream function (Fourier approximation): Rienecker and Fenton (1981), in the form of Fenton (1988).

In the frame of the wave, with depth and gravity 1,

    psi = -U (1 + z) + sum_j V_j/(jk) sinh jk(1 + z)/cosh jk cos jks

meets `psi = -Q` and `1/2 (u^2 + w^2) + eta = head` at points of the surface; Newton's method, in steps of height.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.sea.steady import GivenWave, SteadyWave, cosine_series, highest

#: Numbers of harmonics that are tried in turn.
ORDERS = (10, 14, 20, 28, 40, 56, 80)
#: Error of the surface conditions between the points, over the height [-], below which no more harmonics are tried.
ENOUGH_HARMONICS_ERROR = 1e-6
#: The same error above which the wave counts as not solved.
MAX_ERROR = 1e-3
#: If Newton's method fails below this height over that of the highest wave [-], the number of harmonics is too small.
TOO_FEW_HARMONICS = 0.9
#: Solutions above this height over that of the highest wave [-] are spurious.
SPURIOUS_HEIGHT = 1.02
#: Steps of the height from a low wave, relative to it: the first, the largest and the smallest one.
FIRST_STEP = 0.125
LARGEST_STEP = 0.25
SMALLEST_STEP = 1.0 / 256.0
#: Iterations of Newton's method, and its imaginary step: derivatives by complex steps are exact.
ITERATIONS = 25
COMPLEX_STEP = 1e-30


class Inaccurate(ValueError):
    """The surface of a wave is not accurate with the largest number of harmonics; its length [m]."""

    def __init__(self, length: float) -> None:
        super().__init__(f"the surface has an error above {MAX_ERROR:g} of the height with {ORDERS[-1]} harmonics")
        self.length = length


class NotSolved(ValueError):
    """No wave was found; `reached` [m] is the maximum solved height, at a length [m].

    `few`: Newton's method failed far below the highest wave, because of too few harmonics.
    """

    def __init__(self, reached: float, length: float, depth: float) -> None:
        super().__init__(f"no steady wave is found above {reached:.4g} m")
        self.reached = reached
        self.length = length
        self.few = reached < TOO_FEW_HARMONICS * highest(length, depth)


def stream_function(given: GivenWave, order: int | None = None) -> SteadyWave:
    """The wave of a height with a period or a length.

    Args:
        order: number of harmonics; None uses as many as the surface needs.

    Raises:
        NotSolved: above the highest wave, or close to it.
        Inaccurate: the wave needs more harmonics than there are.
    """
    height, depth, gravity, period, length, *_ = given
    speed = np.sqrt(gravity * depth)
    time = np.sqrt(depth / gravity)
    if period is not None:
        period = period / time
    if length is not None:
        length = length / depth
    scaled = GivenWave(height / depth, 1.0, 1.0, period, length, given.current / speed, given.criterion)
    problem = _Problem(scaled, depth)
    found = _solve(problem, order)
    wave = _name_unknowns(found)
    eulerian = scaled.eulerian(wave.flow, wave.flux)
    celerity = wave.flow + eulerian
    return SteadyWave(
        theory="stream",
        height=height,
        depth=depth,
        length=depth * 2.0 * np.pi / wave.number,
        period=time * 2.0 * np.pi / (wave.number * celerity),
        celerity=speed * celerity,
        eulerian=speed * eulerian,
        transport=speed * (celerity - wave.flux),
        flow=speed * wave.flow,
        head=gravity * depth * wave.head,
        flux=speed * depth * wave.flux,
        surface=depth * _cosines(wave.surface),
        speed=speed * wave.harmonics,
        error=problem.between(found),
    )


def _solve(problem: _Problem, order: int | None) -> np.ndarray:
    """The unknowns of a wave with `order` harmonics, or as many as its surface needs.

    Raises:
        NotSolved: Newton's method fails with the given harmonics.
        Inaccurate: the error is too large.
    """
    orders = ORDERS
    if order is not None:
        orders = (*(n for n in ORDERS if n < order), order)
    found = _climb_orders(problem, orders)
    for n in orders:
        if n <= _order(found):
            continue
        if order is None and problem.between(found) < ENOUGH_HARMONICS_ERROR:
            break
        finer = _newton(problem, _refine_harmonics(found, n), problem.given.height)
        if finer is not None:
            found = finer
    number = _name_unknowns(found).number
    if order is not None and _order(found) < order:
        raise problem.not_solved(problem.given.height, number)
    if order is None and problem.between(found) > MAX_ERROR:
        raise Inaccurate(problem.length_of(number))
    return found


class _Unknowns(NamedTuple):
    """Wave number, surface (n + 1, ...) at points from crest to trough, harmonics (n, ...), flow, flux, head."""

    number: np.ndarray
    surface: np.ndarray
    harmonics: np.ndarray
    flow: np.ndarray
    flux: np.ndarray
    head: np.ndarray


def _name_unknowns(x: np.ndarray) -> _Unknowns:
    """The unknowns (2 n + 5, ...) by name."""
    n = _order(x)
    return _Unknowns(x[0], x[1 : n + 2], x[n + 2 : 2 * n + 2], *x[-3:])


def _order(x: np.ndarray) -> int:
    """Number of harmonics n of the unknowns (2 n + 5, ...)."""
    return (x.shape[0] - 5) // 2


class _Problem(NamedTuple):
    """The equations of one wave in units of depth and gravity; unknowns (k, eta_0..n, V_1..n, U, Q, head).

    Attributes:
        given: the wave in these units.
        depth: [m].
    """

    given: GivenWave
    depth: float

    def not_solved(self, reached: float, number: float | np.ndarray) -> NotSolved:
        """The error, in metres, with the maximum solved height and a wave number."""
        return NotSolved(self.depth * reached, self.length_of(number), self.depth)

    def length_of(self, number: float | np.ndarray) -> float:
        """The length [m] of a wave number."""
        return self.depth * 2.0 * np.pi / float(number)

    def surface(self, x: np.ndarray, eta: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Residual of both conditions (2, m, ...) at phases (m,) with the surface at eta (m, ...)."""
        wave = _name_unknowns(x)
        j = np.arange(1, _order(x) + 1)
        jk = j[:, None] * wave.number
        up = np.exp(jk * eta[:, None])
        down = np.exp(-jk * (eta[:, None] + 2.0))
        scale = wave.harmonics / (1.0 + np.exp(-2.0 * jk))
        phase = np.multiply.outer(angle, j)[..., None]
        cos = np.cos(phase)
        upright = (up - down) * scale
        u = -wave.flow + np.sum((up + down) * scale * cos, axis=1)
        w = np.sum(upright * np.sin(phase), axis=1)
        psi = -wave.flow * (1.0 + eta) + np.sum(upright / jk * cos, axis=1) + wave.flux
        return np.stack([psi, 0.5 * (u**2 + w**2) + eta - wave.head])

    def residual(self, x: np.ndarray, height: float) -> np.ndarray:
        """Rows (2 n + 5, q) for unknowns (2 n + 5, q)."""
        wave = _name_unknowns(x)
        eta = wave.surface
        n = _order(x)
        both = self.surface(x, eta, np.pi * np.arange(n + 1) / n).reshape(2 * n + 2, -1)
        mean = 0.5 * (eta[0] + eta[-1]) + np.sum(eta[1:-1], axis=0)
        distance = self.given.length
        if distance is None:
            distance = (wave.flow + self.given.eulerian(wave.flow, wave.flux)) * self.given.period
        return np.concatenate([both, [mean, eta[0] - eta[-1] - height, distance * wave.number - 2.0 * np.pi]])

    def between(self, x: np.ndarray) -> float:
        """Maximum error of the conditions half-way between the points, over the height."""
        n = _order(x)
        eta = _name_unknowns(x).surface
        angle = np.pi * (np.arange(n) + 0.5) / n
        found = cosine_series(angle, _cosines(eta))
        return float(np.max(np.abs(self.surface(x[:, None], found[:, None], angle))) / (eta[0] - eta[-1]))

    def linear_number(self) -> float:
        """Wave number of a linear wave on the current."""
        if self.given.length is not None:
            return 2.0 * np.pi / self.given.length
        omega = 2.0 * np.pi / self.given.period
        k = max(omega**2, omega)
        for _ in range(200):
            c = np.sqrt(np.tanh(k) / k) + self.given.current
            k = 0.5 * (k + omega / max(c, 1e-3))
        return k


def _newton(problem: _Problem, x: np.ndarray, height: float) -> np.ndarray | None:
    """The solution at a height from a guess; None if Newton's method fails."""
    for _ in range(ITERATIONS):
        # one evaluation for all columns of the Jacobian
        shifts = np.eye(x.size, x.size + 1, 1)
        with np.errstate(all="ignore"):
            rows = problem.residual(x[:, None] + 1j * COMPLEX_STEP * shifts, height)
        if not np.all(np.isfinite(rows)):
            return None
        try:
            change = np.linalg.solve(rows[:, 1:].imag / COMPLEX_STEP, rows[:, 0].real)
        except np.linalg.LinAlgError:
            return None
        x = x - change
        if np.max(np.abs(change[: _order(x) + 2])) < 1e-12 * max(1.0, x[0]):
            break
    else:
        return None
    eta = _name_unknowns(x).surface
    if np.all(np.diff(eta) < 1e-9) and x[0] > 0.0 and eta[-1] > -1.0:
        return x
    return None


def _climb_orders(problem: _Problem, orders: tuple[int, ...]) -> np.ndarray:
    """The wave with the minimum number of harmonics for its height; long waves need many."""
    *fewer, most = orders
    for n in fewer:
        try:
            return _climb(problem, n)
        except NotSolved as error:
            if not error.few:
                raise
    return _climb(problem, most)


def _climb(problem: _Problem, order: int) -> np.ndarray:
    """From a low linear wave to the height, in steps that are halved if Newton's method fails."""
    height = problem.given.height
    done = 0.0
    step = FIRST_STEP
    past = []
    while done < 1.0:
        share = min(done + step, 1.0)
        x = _newton(problem, _guess(problem, past, share, order), share * height)
        if x is None:
            step *= 0.5
            if step < SMALLEST_STEP:
                number = problem.linear_number()
                if past:
                    number = past[-1][1][0]
                raise problem.not_solved(done * height, number)
            continue
        if share * height > SPURIOUS_HEIGHT * highest(2.0 * np.pi / x[0], 1.0):
            raise problem.not_solved(done * height, x[0])
        past = [*past[-1:], (share, x)]
        done = share
        step = min(1.5 * step, LARGEST_STEP)
    return past[-1][1]


def _guess(problem: _Problem, past: list[tuple[float, np.ndarray]], share: float, order: int) -> np.ndarray:
    """Initial guess at a share of the height: a linear wave, or extrapolated from the last one or two shares and
    solutions."""
    if len(past) == 2:
        (a, before), (b, last) = past
        return last + (share - b) / (b - a) * (last - before)
    if past:
        return past[0][1]
    k = problem.linear_number()
    c = np.sqrt(np.tanh(k) / k)
    eta = 0.5 * share * problem.given.height * np.cos(np.pi * np.arange(order + 1) / order)
    first = eta[0] * k * c / np.tanh(k)
    return np.concatenate([[k], eta, [first], np.zeros(order - 1), [c, c, 0.5 * c**2]])


def _cosines(eta: np.ndarray) -> np.ndarray:
    """Harmonics (n,) of a surface at n + 1 points from crest to trough."""
    n = len(eta) - 1
    harmonics = np.fft.rfft(np.concatenate([eta, eta[-2:0:-1]])).real / n  # of the whole wave
    harmonics[-1] *= 0.5
    return harmonics[1:]


def _refine_harmonics(x: np.ndarray, order: int) -> np.ndarray:
    """The same wave with more harmonics."""
    wave = _name_unknowns(x)
    surface = cosine_series(np.pi * np.arange(order + 1) / order, _cosines(wave.surface))
    more = np.zeros(order - len(wave.harmonics))
    return np.concatenate([x[:1], surface, wave.harmonics, more, x[-3:]])
