"""Columns of angles as continuous angles in radians: wraps, counts, degrees, and steps of an encoder."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.angle_unit import decide_unit, unit_contradiction
from fitting.from_file.encoder import is_log_of_steps, read_between_steps, reading_step
from fitting.from_file.motion import LinkMotion
from fitting.traces.trace import RADIANS, unwrap

#: Units of angles by the size of their full turn; any other full turn is that of an encoder's counts.
UNIT_OF_TURN = {360.0: "deg", 2 * np.pi: "rad"}
#: Full turns of angles and of usual encoders, in their units.
FULL_TURNS = np.array([*UNIT_OF_TURN, *2.0 ** np.arange(8, 25), 1000.0, 2000.0, 4000.0, 10000.0])
#: Range of whole numbers above which they are not degrees.
LARGEST_DEGREES = 400.0
#: Size of a wrap over the range of the angles, and over the usual change from row to row; maximum fraction of the rows.
WRAP_SHARE = 0.8
WRAP_RATIO = 10.0
MOST_WRAPS = 0.1


def read_angles(file: str, t: np.ndarray, raw: np.ndarray, unit: str | None, counts: float | None) -> LinkMotion:
    """Angles of columns (k, n) in the file's unit.

    Args:
        unit: by name or as the user gives it; None: from the values and the motion.
        counts: of an encoder per turn, if known.

    Raises:
        SceneError: counts without their number per turn, an undecided unit.
    """
    notes = []
    turn = full_turn(raw)
    step = max(reading_step(column) for column in raw.T)
    stated = unit
    if unit is None:
        unit = unit_of_values(raw, turn, step, counts)
    theta = raw
    if unit == "counts":
        turn = counts or turn
        if turn is None:
            raise SceneError(f"{file}: the angle is in counts of an encoder. Give the counts per turn: --counts 4096")
        notes.append(f"angle in counts, {turn:g} per turn")
        size = 2 * np.pi / turn
        theta = unwrap(raw, turn)
    elif unit is not None:
        if stated is None:
            notes.append(f"angle in {unit}, as its wraps of {turn:.4g} show")
        size = RADIANS[unit]
        theta = unwrap(raw, 2 * np.pi / size)
    is_log = theta.shape[1] == 1 and is_log_of_steps(t, theta[:, 0], step)
    t, theta, reading = read_between_steps(t, theta, step, is_log)
    notes += reading
    if unit is None:
        unit, why = decide_unit(file, t, theta)
        notes.append(f"angle in {unit}: {why}")
        size = RADIANS[unit]
    elif not notes:
        notes.append(f"angle in {unit}{unit_contradiction(t, theta, unit)}")
    if step and not is_log:
        notes.append(f"readings in steps of {step * size:.3g} rad")
    return LinkMotion(t, size * theta, tuple(notes))


def unit_of_values(raw: np.ndarray, turn: float | None, step: float, counts: float | None) -> str | None:
    """Unit of angles (k, n) that wrap at this full turn, or of readings that can only be counts; None if undecided."""
    known = raw[np.isfinite(raw)]
    is_whole = step >= 1.0 and np.all(known == np.round(known))
    reach = np.max(np.nanmax(raw, axis=0) - np.nanmin(raw, axis=0))
    if counts is not None or (is_whole and reach > LARGEST_DEGREES):
        return "counts"
    if turn is None:
        return None
    return UNIT_OF_TURN.get(turn, "counts")


def full_turn(raw: np.ndarray) -> float | None:
    """Full turn at which angles (k, n) wrap, in their unit; None if they do not wrap."""
    jumps = np.concatenate([np.abs(np.diff(column[np.isfinite(column)])) for column in raw.T])
    reach = float(np.nanmax(raw) - np.nanmin(raw))
    is_wrap = jumps > WRAP_SHARE * reach
    large = jumps[is_wrap]
    usual = np.quantile(jumps, 0.9)
    if not len(large) or len(large) > MOST_WRAPS * len(jumps) or np.median(large) < WRAP_RATIO * usual:
        return None
    # a wrap is a full turn less the motion from row to row, which the rows before and after it show
    motion = np.convolve(np.where(is_wrap, 0.0, jumps), [0.5, 0.0, 0.5], "same")
    size = np.median((jumps + motion)[is_wrap])
    turn = FULL_TURNS[np.argmin(np.abs(FULL_TURNS - size))]
    if np.all(np.abs(large - turn) < max(0.1 * turn, 3 * usual)) and 0.9 * turn < reach <= 1.001 * turn:
        return float(turn)
    return None
