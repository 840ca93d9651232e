"""Lengths of the links of a measured file: as the user gives them, or from its points by their unit or by gravity."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.scene.fit import FIT_UNITS
from fitting.from_file.clock import Clock
from fitting.from_file.motion import LinkMotion
from fitting.from_file.pendulum import gravity_of_last_link
from fitting.traces.planar import pendulum_period

#: Metres per unit of length.
METRES = {name: size for name, (base, size) in FIT_UNITS.items() if base == "m"}
#: Maximum ratio of a unit of length and the one that gravity shows, in either direction, for which the unit is taken.
UNIT_RATIO = 1.3
#: Smoothing period of a chain over its main period: below 1, because its links swing faster than its main motion.
SMOOTHING_PERIODS = 0.6
#: Largest ratio of the period of a pendulum as long as all links to the main period: lengths in another unit exceed it.
PERIOD_RATIO = 6.0


def read_lengths(
    file: str, unit: str | None, motion: LinkMotion, clock: Clock, given: tuple[float, ...] | None
) -> tuple[np.ndarray | None, list[str]]:
    """Lengths of the links (n,) [m], and notes; None for one link, whose length follows from its swing.

    Args:
        unit: of the points, if their names give it.
        given: lengths [m] that the user states.

    Raises:
        SceneError: several links without lengths.
    """
    count = motion.theta.shape[1]
    missing = ",".join(f"L{j + 1}" for j in range(count))
    if given is not None:
        return _check_lengths(file, np.array(given), count, clock.period)
    if count == 1:
        return None, []
    if motion.lengths is None or motion.joint is None:
        raise SceneError(
            f"{file}: the angles of {count} links do not show their lengths. Give them [m]: --lengths {missing}"
        )
    smoothing = SMOOTHING_PERIODS * clock.period
    last_link = gravity_of_last_link(clock.times, motion.joint, motion.theta[:, -1], smoothing)
    if last_link is None and unit not in METRES:
        raise SceneError(f"{file}: the points show no scale. Give the lengths of the links [m]: --lengths {missing}")
    return _scaled_lengths(motion.lengths, unit, last_link)


def _check_lengths(file: str, lengths: np.ndarray, count: int, period: float) -> tuple[np.ndarray | None, list[str]]:
    """Lengths [m] that the user gives for a motion of `count` links with this main period [s], and notes.

    Raises:
        SceneError: another number of links, lengths of another period.
    """
    if len(lengths) != count:
        raise SceneError(f"--lengths: {len(lengths)} values; {file} shows {count} links")
    expected = pendulum_period(np.sum(lengths))
    if not 1 / PERIOD_RATIO < expected / period < PERIOD_RATIO:
        listed = ", ".join(f"{length:g}" for length in lengths)
        raise SceneError(
            f"--lengths: links of {listed} m swing in about {expected:.2g} s, those of {file} in {period:.2g} s. Give "
            "metres"
        )
    if count == 1:
        return None, ["one link: its effective length follows from the swing, --lengths is not needed"]
    return lengths, ["lengths as given"]


def _scaled_lengths(
    lengths: np.ndarray, unit: str | None, last_link: tuple[float, float] | None
) -> tuple[np.ndarray, list[str]]:
    """Lengths of the links (n,) [m] by the unit of their points, or by gravity, and how.

    Args:
        lengths: (n,) in the unit of the points; NaN for a last link of unknown length.
        last_link: gravity and length of the last link in the unit of the points, if the motion shows them.
    """
    lengths = lengths.copy()
    is_open = np.isnan(lengths[-1])
    if is_open:
        lengths[-1] = np.nanmean(lengths)
    scale = 1.0
    if last_link is not None:
        gravity, last_length = last_link
        scale = GRAVITY / gravity
        if is_open:
            lengths[-1] = last_length
    if unit is None:
        unit = _nearest_unit(scale)
    text = ", ".join(f"{x / np.sum(lengths):.3g}" for x in lengths)
    if unit in METRES:
        return lengths * METRES[unit], [f"lengths from the points in {unit}, in parts of the whole: {text}"]
    return lengths * scale, [f"lengths from the points, scaled by gravity, in parts of the whole: {text}"]


def _nearest_unit(scale: float) -> str:
    """The unit of length of this size [m], within `UNIT_RATIO`; otherwise pixels."""
    for name, size in METRES.items():
        if abs(np.log(scale / size)) < np.log(UNIT_RATIO):
            return name
    return "px"
