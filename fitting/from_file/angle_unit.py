"""Radians or degrees of angles without a named unit: the period of a pendulum grows with its amplitude."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.pendulum import GRID_PER_PERIOD, HALF_WIDTH, fit_swing_equation, main_period, smooth_derivatives

#: Difference of the log likelihoods of two units of the angle that decides between them.
DECIDING_GAIN = 4.0
#: Periods of the stretches that are compared, and their minimum amplitude as a fraction of the maximum.
BLOCK_PERIODS = 3
LEAST_AMPLITUDE = 0.05
#: Sum of squares of a stretch, in the median one, above which it is not free.
FREE_RATIO = 4.0
#: Amplitude of one link in the unknown unit below which it is radians: as degrees it would hardly move.
SMALL_AMPLITUDE = 0.3


def decide_unit(file: str, t: np.ndarray, theta: np.ndarray) -> tuple[str, str]:
    """Radians or degrees of angles (k, n) without a named unit, and why.

    Raises:
        SceneError: undecided.
    """
    reach = float(np.max(half_range(theta)))
    if theta.shape[1] > 1:
        unit = "deg" if reach > 2 * np.pi else "rad"
        return unit, f"angles reach {reach:.3g}"
    unit, ratio = unit_of_angle(t, theta[:, 0], main_period(t, theta))
    if unit is None:
        raise SceneError(f"{file}: the angle may be in rad or deg. Give its unit: --unit deg or --unit rad")
    if ratio == np.inf:
        return unit, f"as degrees, {reach:.2g} would hardly be a motion"
    if ratio == 0.0:
        return unit, "its range suggests it, the period does not decide; --unit states it"
    return unit, "the period grows with the amplitude as in this unit"


def unit_contradiction(t: np.ndarray, theta: np.ndarray, unit: str) -> str:
    """A remark if the period of one link changes with the amplitude as in another unit than the stated one."""
    if unit == "mrad" or theta.shape[1] > 1:
        return ""
    shown, gain = unit_of_angle(t, theta[:, 0], main_period(t, theta))
    if shown in (None, unit) or gain in (0.0, np.inf):
        return ""
    return f", but the period grows with the amplitude as in {shown}: check the unit, --unit {shown}"


def unit_of_angle(t: np.ndarray, raw: np.ndarray, period: float) -> tuple[str | None, float]:
    """`rad` or `deg`, by the period's change with the amplitude, and the gain in log likelihood; None if undecided.

    Args:
        raw: (k,) in the unknown unit, without wraps.
    """
    reach = half_range(raw)
    if reach < SMALL_AMPLITUDE:
        return "rad", np.inf
    _, motion, _ = smooth_derivatives(t, raw, period)
    length = min(BLOCK_PERIODS * GRID_PER_PERIOD, len(motion))
    if not length:
        return None, 0.0
    blocks = motion[: len(motion) // length * length].reshape(-1, length, 3)
    size = blocks[..., 0].std(axis=1)
    loud = blocks[size > LEAST_AMPLITUDE * size.max()]
    squares = np.array([squares_by_unit(block) for block in loud])
    smaller = squares.min(axis=1)
    calm = smaller < FREE_RATIO * np.median(smaller)  # without a hand that releases it
    # one k for all amplitudes: in the wrong unit it changes with them
    free = loud[calm].reshape(-1, 3)
    in_radians, in_degrees = np.maximum(squares_by_unit(free), 1e-300)
    # difference of the log likelihoods; accelerations a few samples apart are independent
    gain = 0.5 * len(free) / HALF_WIDTH * float(np.log(in_degrees / in_radians))
    if gain >= DECIDING_GAIN:
        return "rad", gain
    if gain <= -DECIDING_GAIN:
        return "deg", -gain
    # a pendulum that passes the upright does not turn round before it hangs again
    if reach > np.pi:
        return "deg", 0.0
    if gain > -1.0:
        return "rad", 0.0
    return None, 0.0


def squares_by_unit(motion: np.ndarray) -> list[float]:
    """Sums of squares of a motion (k, 3) read in radians and in degrees, in the unit of its angle."""
    return [fit_swing_equation(motion * unit, True)[1] / unit**2 for unit in (1.0, np.pi / 180)]


def half_range(values: np.ndarray) -> np.ndarray:
    """Half the range (n,) of values (k, n) without 0.5 % of them at both ends."""
    return 0.5 * np.subtract(*np.nanquantile(values, [0.995, 0.005], axis=0))
