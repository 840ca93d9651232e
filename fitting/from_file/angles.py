"""Columns of angles as continuous angles in radians: wraps, counts, degrees, and logs of an encoder's steps."""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.motion import LinkMotion
from fitting.from_file.pendulum import GRID_PER_PERIOD, half_range, main_period, unit_of_angle
from fitting.traces.trace import RADIANS, unwrap

#: Units of angles by the size of their full turn; any other full turn is that of an encoder's counts.
UNIT_OF_TURN = {360.0: "deg", 2 * np.pi: "rad"}
#: Full turns of angles and of usual encoders, in their units.
FULL_TURNS = np.array([*UNIT_OF_TURN, *2.0 ** np.arange(8, 25), 1000.0, 2000.0, 4000.0, 10000.0])
#: Range of whole numbers above which they are not degrees.
LARGEST_DEGREES = 400.0
#: Minimum fraction of the rows of a log of steps that differ from the last one, and, after a pause, by one step.
EVERY_STEP = 0.97
#: Interval before a row, over the median one, from which it is a pause; minimum fraction of pauses in a log.
PAUSE_RATIO = 2.0
FEWEST_PAUSES = 0.005
#: Minimum fraction of rows that repeat the last reading, and maximum noise in steps, for which a mean of rows keeps an
#: error by rounding.
MOST_REPEAT = 0.8
LITTLE_NOISE = 0.35
#: Longest turn of a swing without a change of the reading, in periods: its amplitude is then 5 steps.
LONGEST_TURN = 0.2


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
    step = max(step_of(column) for column in raw.T)
    is_named = unit is not None
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
        if not is_named:
            notes.append(f"angle in {unit}, as its wraps of {turn:.4g} show")
        size = RADIANS[unit]
        theta = unwrap(raw, 2 * np.pi / size)
    is_log = theta.shape[1] == 1 and is_log_of_steps(t, theta[:, 0], step)
    if is_log:
        # a row is written where the reading changes: the angle is then between the two readings, also if the encoder
        # is read at fixed times, then half an interval earlier
        theta = 0.5 * (theta[1:] + theta[:-1])
        t = t[1:]
        notes.append("a row at each step of the encoder: read as the middle of the step")
    elif theta.shape[1] == 1 and is_stepped(t, theta[:, 0], step):
        t, theta = changes_of(t, theta)
        notes.append("most rows repeat the reading: read where it changes, as the middle of the step")
    if unit is None:
        unit, why = decide_unit(file, t, theta)
        notes.append(f"angle in {unit}: {why}")
        size = RADIANS[unit]
    elif not notes:
        notes.append(f"angle in {unit}{contradiction(t, theta, unit)}")
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


def contradiction(t: np.ndarray, theta: np.ndarray, unit: str) -> str:
    """A remark if the period of one link changes with the amplitude as in another unit than the stated one."""
    if unit == "mrad" or theta.shape[1] > 1:
        return ""
    shown, gain = unit_of_angle(t, theta[:, 0], main_period(t, theta))
    if shown in (None, unit) or gain in (0.0, np.inf):
        return ""
    return f", but the period grows with the amplitude as in {shown}: check the unit, --unit {shown}"


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


#: Size of a wrap over the range of the angles, and over the usual change from row to row; maximum fraction of the rows.
WRAP_SHARE = 0.8
WRAP_RATIO = 10.0
MOST_WRAPS = 0.1


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


def step_of(column: np.ndarray) -> float:
    """Difference of two readings of a rounded column (k,) that covers many of its own steps; otherwise 0."""
    known = column[np.isfinite(column)]
    values = np.unique(known)
    steps = np.diff(values)
    steps = steps[steps > 1e-9 * np.max(np.abs(values), initial=1.0)]
    if len(steps) < 3 or len(values) > 0.5 * len(known):
        return step_of_log(known)
    step = float(np.min(steps))
    number = steps / step
    if np.mean(np.abs(number - np.round(number)) < 0.1) > 0.9:
        return step
    return 0.0


def step_of_log(known: np.ndarray) -> float:
    """The one size of all changes of a column, otherwise 0."""
    change = np.abs(np.diff(known))
    change = change[change > 0]
    if len(change) < 10:
        return 0.0
    step = float(np.median(change))
    if np.mean(np.abs(change / step - 1.0) < 0.02) > EVERY_STEP:
        return step
    return 0.0


def is_log_of_steps(t: np.ndarray, column: np.ndarray, step: float) -> bool:
    """Whether rows (k,) are written where the reading changes: none repeats the last one, and a row after a pause
    differs from it by one step. Fast rows may differ by more, if the encoder is read at fixed times.
    """
    if not step > 0:
        return False
    known = np.isfinite(column)
    change = np.abs(np.diff(column[known])) / step
    interval = np.diff(t[known])
    paused = interval > PAUSE_RATIO * np.median(interval)
    if np.mean(paused) < FEWEST_PAUSES:
        return False
    by_one = np.abs(change[paused] - 1.0) < 0.05
    return float(min(np.mean(change > 0.5), np.mean(by_one))) > EVERY_STEP


def changes_of(t: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times (c,) and angles (c, 1) at which a rounded reading (k, 1) changes: the middles of both rows.

    The motion ends where its amplitude is a few steps: its turns then take long without a change.
    """
    known = np.isfinite(theta[:, 0])
    t = t[known]
    theta = theta[known]
    row = np.flatnonzero(np.diff(theta[:, 0]))
    times = 0.5 * (t[row] + t[row + 1])
    angles = 0.5 * (theta[row] + theta[row + 1])
    pauses = np.flatnonzero(np.diff(times) > LONGEST_TURN * main_period(t, theta)) + 1
    longest = max(np.split(np.arange(len(times)), pauses), key=len)
    return times[longest], angles[longest]


def is_stepped(t: np.ndarray, column: np.ndarray, step: float) -> bool:
    """Whether the reading (k,) of a motion repeats in most rows and has little noise: no mean takes its rounding off.

    From row to row, noise changes the reading by 2/sqrt(pi) of its standard deviation on average, in addition to the
    motion, which distant rows show.
    """
    if not step > 0:
        return False
    known = np.isfinite(column)
    column = column[known]
    change = np.abs(np.diff(column))
    if np.mean(change > 0.5 * step) > 1.0 - MOST_REPEAT:
        return False
    period = main_period(t[known], column[:, None])
    distant = max(1, int(period / GRID_PER_PERIOD / np.median(np.diff(t[known]))))
    by_motion = np.sum(np.abs(np.diff(column[::distant])))
    noise = 0.5 * np.sqrt(np.pi) * (np.sum(change) - by_motion) / len(column)
    return bool(noise < LITTLE_NOISE * step)
