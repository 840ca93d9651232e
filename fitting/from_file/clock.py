"""Times of a file: seconds, milliseconds or frames; rows that repeat, jump back or are a second run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.columns import Columns
from fitting.from_file.motion import LinkMotion
from fitting.from_file.pendulum import main_period

#: Seconds per unit of time.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Periods of pendulums from 2 cm to 60 m [s]: a unit of time is read such that the motion's period is one of these.
SHORTEST_PERIOD = 0.25
LONGEST_PERIOD = 16.0
#: Minimum number of rows with different times.
FEWEST_ROWS = 10
#: Rows of a part after a jump back, below which they are in disorder and not another run.
SECOND_RUN_ROWS = 30
#: A clock that starts later than this [s] is counted from its first row: seconds since 1970 would lose digits.
LATEST_START = 1e5


@dataclass(frozen=True)
class Rows:
    """Rows with times in the file's unit that increase.

    Attributes:
        t: (k,) in the unit of the file, from the first row on.
        values: (k, columns).
        start: time of the first row in the unit of the file.
        notes: what was left out.
    """

    t: np.ndarray
    values: np.ndarray
    start: float
    notes: tuple[str, ...]


def ordered_rows(file: str, t: np.ndarray, values: np.ndarray) -> Rows:
    """Rows with increasing times: the longest run, without repeated rows and in order.

    Raises:
        SceneError: fewer than `FEWEST_ROWS` rows remain.
    """
    notes = []
    known = np.isfinite(t) & np.isfinite(values).any(axis=1)
    t = t[known]
    values = values[known]
    edges = _starts_of_runs(t)
    if len(edges) > 2:
        longest = int(np.argmax(np.diff(edges)))
        first, end = edges[longest : longest + 2]
        notes.append(f"times start again {len(edges) - 2} times: the longest run is used, rows {first + 1} to {end}")
        t = t[first:end]
        values = values[first:end]
    backwards = int(np.sum(np.diff(t) < 0))
    if backwards:
        notes.append(f"times jump back in {backwards} rows: rows sorted by time")
        order = np.argsort(t, kind="stable")
        t = t[order]
        values = values[order]
    different, first = np.unique(t, return_index=True)
    if len(different) < len(t):
        notes.append(f"{len(t) - len(different)} rows repeat a time: averaged")
        t = different
        values, _ = mean_rows(values, first)
    if len(t) < FEWEST_ROWS:
        raise SceneError(f"{file}: has {len(t)} rows with different times; allowed: at least {FEWEST_ROWS}")
    return Rows(t - t[0], values, float(t[0]), tuple(notes))


def _starts_of_runs(t: np.ndarray) -> list[int]:
    """First row of each run in a file, and the number of all rows.

    Another run starts where the time jumps back by more than half of what has passed since the last start.
    """
    starts = [0]
    for i in np.flatnonzero(np.diff(t) < 0) + 1:
        back = t[i - 1] - t[i]
        if back > 0.5 * (t[i - 1] - t[starts[-1]]) and i - starts[-1] > SECOND_RUN_ROWS:
            starts.append(int(i))
    return [*starts, len(t)]


def mean_rows(values: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the known values of each row `first` (g,) and those up to the next, NaN without any; and their number.

    Args:
        values: (k,) or (k, n).
    """
    known = np.isfinite(values)
    number = np.add.reduceat(known.astype(int), first)
    total = np.add.reduceat(np.where(known, values, 0.0), first)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan), number


class Clock(NamedTuple):
    """Times of a motion.

    Attributes:
        times: (k,) [s].
        period: main period of the motion [s].
        starts_at_first_row: whether the time of the first row was subtracted.
        note: how the unit of time was found.
    """

    times: np.ndarray
    period: float
    starts_at_first_row: bool
    note: str


def read_clock(file: str, columns: Columns, rows: Rows, motion: LinkMotion, rate: float | None) -> Clock:
    """The clock of a motion, in seconds.

    Args:
        rate: frames or rows per second, if the user gives them.

    Raises:
        SceneError: frames without a rate, times of no unit.
    """
    period = main_period(motion.t, motion.theta)
    second, note = unit_of_time(file, columns, motion.t, period, rate)
    start = second * rows.start
    if abs(start) >= LATEST_START:
        start = 0.0
    return Clock(start + second * motion.t, second * period, bool(rows.start) and not start, note)


def unit_of_time(file: str, columns: Columns, t: np.ndarray, period: float, rate: float | None) -> tuple[float, str]:
    """Seconds per unit of the file's times, and how it was found.

    Args:
        t: times (k,) in the file's unit.
        period: of the motion, in the file's unit.
        rate: frames or rows per second, if the user gives them: times without a unit then count frames.

    Raises:
        SceneError: frames without a rate, times of no unit.
    """
    named = columns.time_unit
    if named in SECONDS:
        return SECONDS[named], f"times in {named}"
    column = None if columns.time is None else columns.time.name
    counts = named == "frames" or (named is None and (rate is not None or bool(np.all(np.diff(t) == 1.0))))
    rate = rate or columns.rate
    if column is None or counts:
        if rate is not None:
            return 1.0 / rate, f"{rate:g} frames per second"
        what = "has no column of times" if column is None else f"counts frames ({column!r})"
        raise SceneError(f"{file}: {what}. Give the frames per second: --rate 60")
    for unit, size in SECONDS.items():
        if SHORTEST_PERIOD < size * period < LONGEST_PERIOD:
            return size, f"times in {unit}, as a period of {size * period:.3g} s shows"
    if rate is not None:
        return 1.0 / rate, f"{rate:g} frames per second"
    raise SceneError(
        f"{file}: {column!r} has {period:.3g} units per swing, neither s, ms, us nor ns. If it counts frames, "
        "give their rate: --rate 60"
    )
