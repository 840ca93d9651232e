"""Angles of an encoder: the size of its steps, logs of its steps, and readings that repeat in most rows."""

from __future__ import annotations

import numpy as np

from fitting.from_file.pendulum import GRID_PER_PERIOD, main_period

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


def read_between_steps(
    t: np.ndarray, theta: np.ndarray, step: float, is_log: bool
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Times (k,) and angles (k, n) in the middle of the steps of an encoder, if it has steps; and how they were read.

    Args:
        is_log: whether a row is written where the reading changes: the angle is then between the two readings, also if
            the encoder is read at fixed times, then half an interval earlier.
    """
    if is_log:
        middle = 0.5 * (theta[1:] + theta[:-1])
        return t[1:], middle, ["a row at each step of the encoder: read as the middle of the step"]
    if theta.shape[1] == 1 and is_stepped(t, theta[:, 0], step):
        times, middle = changes_of(t, theta)
        return times, middle, ["most rows repeat the reading: read where it changes, as the middle of the step"]
    return t, theta, []


def reading_step(column: np.ndarray) -> float:
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
