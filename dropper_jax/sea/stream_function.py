"""Waves by the stream function (Fourier approximation): Rienecker and Fenton (1981), in the form of Fenton (1988).

In the frame of the wave, with depth and gravity 1,

    psi = -U (1 + z) + sum_j V_j/(jk) sinh jk(1 + z)/cosh jk cos jks

meets `psi = -Q` and `1/2 (u^2 + w^2) + eta = head` at points of the surface; Newton's method, in steps of height.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.sea.steady import SteadyWave, highest

#: Numbers of harmonics that are tried in turn.
ORDERS = (10, 14, 20, 28, 40, 56, 80)
#: Error of the surface conditions between the points, over the height: below the first no more harmonics are tried,
#: above the second the wave is not solved.
ACCURATE = 1e-6
UNUSABLE = 1e-3
#: If Newton's method fails below this fraction of the highest wave, the number of harmonics is too small.
TOO_FEW = 0.9
#: Solutions above this multiple of the highest wave are spurious.
SPURIOUS = 1.02
#: Steps of the height from a low wave, relative to it: the first, the largest and the smallest one.
FIRST_STEP = 0.125
LARGEST_STEP = 0.25
SMALLEST_STEP = 1.0 / 256.0
#: Iterations of Newton's method, and its imaginary step: derivatives by complex steps are exact.
ITERATIONS = 25
TINY = 1e-30


class NotSolved(ValueError):
    """No wave was found; `reached` [m] is the maximum solved height, at a length [m].

    `few`: Newton's method failed far below the highest wave, because of too few harmonics.
    """

    def __init__(self, reached: float, length: float, depth: float) -> None:
        super().__init__(f"no steady wave is found above {reached:.4g} m")
        self.reached = reached
        self.length = length
        self.few = reached < TOO_FEW * highest(length, depth)


def stream_function(
    height: float,
    depth: float,
    gravity: float,
    *,
    period: float | None = None,
    length: float | None = None,
    current: float = 0.0,
    criterion: str = "euler",
    order: int | None = None,
) -> SteadyWave:
    """A wave of a height [m] over a depth [m] with a period [s] or a length [m].

    Args:
        current: mean velocity of the water along the wave [m/s], in the sense of `criterion` (`steady.CRITERIA`).
        order: number of harmonics; None uses as many as the surface needs.

    Raises:
        NotSolved: above the highest wave, or close to it.
    """
    speed = np.sqrt(gravity * depth)
    time = np.sqrt(depth / gravity)
    problem = _Problem(
        None if period is None else period / time,
        None if length is None else length / depth,
        current / speed,
        criterion,
    )
    orders = ORDERS
    if order is not None:
        orders = (*(n for n in ORDERS if n < order), order)
    found = _climb_orders(problem, height / depth, orders, depth)
    error = problem.between(found)
    for n in orders:
        if n <= _order(found):
            continue
        if order is None and error < ACCURATE:
            break
        finer = _newton(problem, _refine_harmonics(found, n), height / depth)
        if finer is not None:
            found = finer
            error = problem.between(finer)
    if order is None:
        failed = error > UNUSABLE
    else:
        failed = _order(found) < order
    wave = _parts(found)
    if failed:
        raise NotSolved(height, depth * 2.0 * np.pi / wave.number, depth)
    eulerian = problem.eulerian(wave.flow, wave.flux)
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
        error=error,
    )


class _Unknowns(NamedTuple):
    """Wave number, surface (n + 1, ...) at points from crest to trough, harmonics (n, ...), flow, flux, head."""

    number: np.ndarray
    surface: np.ndarray
    harmonics: np.ndarray
    flow: np.ndarray
    flux: np.ndarray
    head: np.ndarray


def _parts(x: np.ndarray) -> _Unknowns:
    n = _order(x)
    return _Unknowns(x[0], x[1 : n + 2], x[n + 2 : 2 * n + 2], x[-3], x[-2], x[-1])


def _order(x: np.ndarray) -> int:
    return (x.shape[0] - 5) // 2


class _Problem:
    """The equations of one wave; unknowns (k, eta_0..n, V_1..n, U, Q, head)."""

    def __init__(self, period: float | None, length: float | None, current: float, criterion: str) -> None:
        self.period = period
        self.length = length
        self.current = current
        self.criterion = criterion

    def eulerian(self, flow: np.ndarray, flux: np.ndarray) -> np.ndarray | float:
        if self.criterion == "euler":
            return self.current
        return self.current + flux - flow

    def surface(self, x: np.ndarray, eta: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Residual of both conditions (2, m, ...) at phases (m,) with the surface at eta (m, ...)."""
        k, _, v, flow, flux, head = _parts(x)
        j = np.arange(1, v.shape[0] + 1)[:, None]
        jk = j * k
        up = np.exp(jk * eta[:, None])
        down = np.exp(-jk * (eta[:, None] + 2.0))
        scale = v / (1.0 + np.exp(-2.0 * jk))
        across = (up + down) * scale
        upright = (up - down) * scale
        cos = np.cos(angle[:, None] * j[:, 0])[..., None]
        sin = np.sin(angle[:, None] * j[:, 0])[..., None]
        u = -flow + np.sum(across * cos, axis=1)
        w = np.sum(upright * sin, axis=1)
        psi = -flow * (1.0 + eta) + np.sum(upright / jk * cos, axis=1) + flux
        return np.stack([psi, 0.5 * (u**2 + w**2) + eta - head])

    def residual(self, x: np.ndarray, height: float) -> np.ndarray:
        """Rows (2 n + 5, q) for unknowns (2 n + 5, q)."""
        k, eta, _, flow, flux, _ = _parts(x)
        n = _order(x)
        both = self.surface(x, eta, np.pi * np.arange(n + 1) / n).reshape(2 * n + 2, -1)
        mean = 0.5 * (eta[0] + eta[-1]) + np.sum(eta[1:-1], axis=0)
        if self.length is None:
            size = (flow + self.eulerian(flow, flux)) * self.period * k - 2.0 * np.pi
        else:
            size = k * self.length - 2.0 * np.pi
        return np.concatenate([both, np.stack([mean, eta[0] - eta[-1] - height, size])])

    def between(self, x: np.ndarray) -> float:
        """Maximum error of the conditions half-way between the points, over the height."""
        n = _order(x)
        eta = _parts(x).surface
        angle = np.pi * (np.arange(n) + 0.5) / n
        found = np.cos(np.outer(angle, np.arange(1, n + 1))) @ _cosines(eta)
        return float(np.max(np.abs(self.surface(x[:, None], found[:, None], angle))) / (eta[0] - eta[-1]))


def _newton(problem: _Problem, x: np.ndarray, height: float) -> np.ndarray | None:
    """The solution at a height from a guess; None if Newton's method fails."""
    for _ in range(ITERATIONS):
        # one evaluation for all columns of the Jacobian
        shifted = x[:, None] + 1j * TINY * np.eye(x.size)
        with np.errstate(all="ignore"):
            rows = problem.residual(np.concatenate([x[:, None].astype(complex), shifted], axis=1), height)
        if not np.all(np.isfinite(rows)):
            return None
        try:
            change = np.linalg.solve(rows[:, 1:].imag / TINY, rows[:, 0].real)
        except np.linalg.LinAlgError:
            return None
        x = x - change
        if np.max(np.abs(change[: _order(x) + 2])) < 1e-12 * max(1.0, x[0]):
            break
    else:
        return None
    eta = _parts(x).surface
    falling = np.all(np.diff(eta) < 1e-9) and x[0] > 0.0 and eta[-1] > -1.0
    if falling:
        return x
    return None


def _climb_orders(problem: _Problem, height: float, orders: tuple[int, ...], depth: float) -> np.ndarray:
    """The wave with the minimum number of harmonics for its height; long waves need many."""
    *fewer, most = orders
    for n in fewer:
        try:
            return _climb(problem, height, n, depth)
        except NotSolved as error:
            if not error.few:
                raise
    return _climb(problem, height, most, depth)


def _climb(problem: _Problem, height: float, order: int, depth: float) -> np.ndarray:
    """From a low linear wave to the height, in steps that are halved if Newton's method fails."""
    done = 0.0
    step = FIRST_STEP
    past = []
    while done < 1.0:
        share = min(done + step, 1.0)
        x = _newton(problem, _guess(problem, past, share, height, order), share * height)
        if x is None:
            step *= 0.5
            if step < SMALLEST_STEP:
                if past:
                    length = 2.0 * np.pi / past[-1][1][0]
                else:
                    length = _first(problem)[1]
                raise NotSolved(depth * done * height, depth * length, depth)
            continue
        if share * height > SPURIOUS * highest(2.0 * np.pi / x[0], 1.0):
            raise NotSolved(depth * done * height, depth * 2.0 * np.pi / x[0], depth)
        past = [*past[-1:], (share, x)]
        done = share
        step = min(1.5 * step, LARGEST_STEP)
    return past[-1][1]


def _first(problem: _Problem) -> tuple[float, float]:
    """Wave number and length of a linear wave on the current."""
    if problem.length is not None:
        return 2.0 * np.pi / problem.length, problem.length
    k = max((2.0 * np.pi / problem.period) ** 2, 2.0 * np.pi / problem.period)
    for _ in range(200):
        c = np.sqrt(np.tanh(k) / k) + problem.current
        k = 0.5 * (k + 2.0 * np.pi / (problem.period * max(c, 1e-3)))
    return k, 2.0 * np.pi / k


def _guess(problem: _Problem, past: list, share: float, height: float, order: int) -> np.ndarray:
    """Initial guess: a linear wave first, then extrapolation of one or two solutions."""
    if len(past) == 2:
        (a, before), (b, last) = past
        return last + (share - b) / (b - a) * (last - before)
    if past:
        return past[0][1]
    k, _ = _first(problem)
    a = 0.5 * share * height
    c = np.sqrt(np.tanh(k) / k)
    eta = a * np.cos(np.pi * np.arange(order + 1) / order)
    v = np.zeros(order)
    v[0] = a * k * c / np.tanh(k)
    return np.concatenate([[k], eta, v, [c, c, 0.5 * c**2]])


def _cosines(eta: np.ndarray) -> np.ndarray:
    """Harmonics (n,) of a surface at n + 1 points from crest to trough."""
    n = len(eta) - 1
    weight = np.ones(n + 1)
    weight[[0, -1]] = 0.5
    found = 2.0 / n * np.cos(np.pi * np.outer(np.arange(1, n + 1), np.arange(n + 1)) / n) @ (weight * eta)
    found[-1] *= 0.5
    return found


def _refine_harmonics(x: np.ndarray, order: int) -> np.ndarray:
    """The same wave with more harmonics."""
    k, eta, v, *rest = _parts(x)
    angle = np.pi * np.arange(order + 1) / order
    surface = np.cos(np.outer(angle, np.arange(1, len(v) + 1))) @ _cosines(eta)
    return np.concatenate([[k], surface, v, np.zeros(order - len(v)), rest])
