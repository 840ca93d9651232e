"""A measured file of any program as a trace: columns, clock, unit, free swing and thinning, each with a note."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.from_file.angles import read_angles
from fitting.from_file.cells import Cells, read_cells
from fitting.from_file.clock import Rows, ordered_rows, read_clock
from fitting.from_file.columns import Columns, find_columns
from fitting.from_file.lengths import read_lengths
from fitting.from_file.motion import LinkMotion
from fitting.from_file.pendulum import main_period
from fitting.from_file.points import read_points
from fitting.from_file.swing import FEWEST_PERIODS, Swing, find_swing
from fitting.from_file.thinning import thin_rows
from fitting.traces.noise import noise, without_spikes
from fitting.traces.planar import pendulum_period
from fitting.traces.trace import Convention, Trace

#: Number of rows from the middle of a file that show its noise, which takes longer than the fit if it uses all rows.
NOISE_ROWS = 6000
#: Shortest period of a chain of unknown lengths, as a fraction of its main period.
SHORTEST_PERIOD = 0.5
#: Minimum number of rows of the span that the user gives.
FEWEST_ROWS_IN_SPAN = 10


@dataclass(frozen=True)
class FileOptions:
    """What a user states about a file; None: found from the file.

    Attributes:
        columns: names of columns by `time`, `theta_1`, `x_1`, `y_1` ...
        unit: of angles, `rad`, `deg` or `counts`.
        rate: frames or rows per second [1/s].
        counts: counts per turn of an encoder.
        lengths: of the links [m].
        mass: of each link's end [kg].
        begin, end: span that is used, on the trace's clock [s], which is the file's unless that starts late
            (`clock.LATEST_START`).
    """

    columns: Mapping[str, str] | None = None
    unit: str | None = None
    rate: float | None = None
    counts: float | None = None
    lengths: tuple[float, ...] | None = None
    mass: float | None = None
    begin: float | None = None
    end: float | None = None


#: Everything is found from the file.
NO_OPTIONS = FileOptions()


@dataclass(frozen=True)
class MeasuredFile:
    """A file as a trace.

    Attributes:
        trace: angles from straight down [rad], thinned.
        zero: reading at rest that was subtracted [rad].
        swing: the free swing of one link; None for several.
        lengths: of the links [m] as points or the user give them; None: unknown.
        open_end: whether the length of the last link follows from the motion alone.
        pivot_error: standard errors of a pivot that points do not show (2,), sideways and up, over the length of the
            first link; None if it is known.
        notes: how everything was found.
    """

    trace: Trace
    zero: float
    swing: Swing | None
    lengths: np.ndarray | None
    open_end: bool
    pivot_error: np.ndarray | None
    notes: tuple[str, ...]


def read_measured(path: str | Path, given: FileOptions = NO_OPTIONS, links: int | None = None) -> MeasuredFile:
    """A file as a trace.

    Args:
        given: what the user states about the file.
        links: of the scene, if there is one: lengths are then known.

    Raises:
        SceneError: one line with what is wrong or missing, and what to give.
    """
    path = Path(path)
    cells = read_cells(path)
    columns = find_columns(cells, given.columns, given.rate)
    rows = _used_rows(cells, columns)
    motion = _read_motion(cells, columns, rows, given)
    count = motion.theta.shape[1]
    clock = read_clock(cells.file, columns, rows, motion, given.rate)
    if links is not None and count != links:
        raise SceneError(f"{cells.file}: shows {count} links, but the scene has {links}. Use the scene of this file")
    notes = [*columns.notes, clock.note, *rows.notes, *motion.notes]
    if clock.starts_at_first_row:
        notes.append("the clock starts at the first row")
    # zero and sign of a scene's own links follow from its pose
    convention = Convention(unit="rad")
    if count == 1 or columns.points or links is None:
        convention = Convention("down", 1, "rad")
    trace = Trace(path.stem, clock.times, motion.theta, convention=convention)
    if (given.begin, given.end) != (None, None):
        trace = _cut_span(trace, given)
        if np.ptp(trace.t) > FEWEST_PERIODS * clock.period:  # a shorter span does not show its period
            clock = clock._replace(period=main_period(trace.t, trace.theta))
    swing = None
    zero = 0.0
    if count == 1:
        trace, swing, zero = _free_swing(cells.file, trace, clock.period)
        notes += [*swing.notes, f"the reading at rest, {zero:.4g} rad, is subtracted"]
    lengths = None
    if links is None or given.lengths is not None:
        lengths, length_notes = read_lengths(cells.file, columns.length_unit, motion, clock, given.lengths)
        notes += length_notes
    trace, thinning_notes = _thin_trace(trace, _shortest_period(count, lengths, clock.period))
    notes += thinning_notes
    open_end = motion.lengths is not None and bool(np.isnan(motion.lengths[-1])) and count > 1
    return MeasuredFile(trace, zero, swing, lengths, open_end, motion.pivot_error, tuple(notes))


def _used_rows(cells: Cells, columns: Columns) -> Rows:
    """The rows with their times, and the columns that show the motion.

    Raises:
        SceneError: one of these columns is empty there, or too few rows.
    """
    t = np.arange(len(cells.values), dtype=float)
    if columns.time is not None:
        t = columns.time.values
    used = columns.angles or [column for pair in columns.points for column in pair]
    rows = ordered_rows(cells.file, t, np.stack([column.values for column in used], axis=1))
    for column, values in zip(used, rows.values.T, strict=True):
        if not np.isfinite(values).any():
            raise SceneError(f"{cells.file}: {column.name!r} is empty in the rows that are used. Name other columns")
    return rows


def _read_motion(cells: Cells, columns: Columns, rows: Rows, given: FileOptions) -> LinkMotion:
    """The motion by the values of the columns."""
    if columns.points:
        return read_points(cells.file, rows.t, rows.values[:, ::2].T + 1j * rows.values[:, 1::2].T)
    return read_angles(cells.file, rows.t, rows.values, given.unit or columns.angle_unit, given.counts)


def _shortest_period(count: int, lengths: np.ndarray | None, period: float) -> float:
    """Shortest period [s] of a motion of `count` links with this main period [s]; lengths (n,) [m], if known."""
    if count == 1:
        return period
    if lengths is None:
        return SHORTEST_PERIOD * period
    return pendulum_period(lengths)


def _thin_trace(trace: Trace, fastest: float) -> tuple[Trace, list[str]]:
    """The trace with as many rows as a motion of this shortest period [s] needs, and a note if rows were left out."""
    t, theta, many = thin_rows(trace.t, trace.theta, fastest)
    if len(t) == len(trace.t):
        return trace, []
    what = f"each the mean of about {many}" if many > 1 else "one for each stretch of time"
    return replace(trace, t=t, theta=theta), [f"{len(trace.t)} rows thinned to {len(t)}, {what}"]


def _cut_span(trace: Trace, given: FileOptions) -> Trace:
    """The trace in the span that the user gives.

    Raises:
        SceneError: fewer than `FEWEST_ROWS_IN_SPAN` rows are left.
    """
    begin = -np.inf
    end = np.inf
    options = []
    if given.begin is not None:
        begin = given.begin
        options.append(f"after --from {begin:g} s")
    if given.end is not None:
        end = given.end
        options.append(f"before --until {end:g} s")
    found = trace.between(begin, end)
    if len(found.t) < FEWEST_ROWS_IN_SPAN:
        raise SceneError(
            f"{trace.name}: {len(found.t)} rows {' and '.join(options)}; the file has {trace.t[0]:g} to "
            f"{trace.t[-1]:g} s"
        )
    return found


def _free_swing(file: str, trace: Trace, period: float) -> tuple[Trace, Swing, float]:
    """The free swing of one link about its zero, the swing's values, and that zero [rad]."""
    trace = without_spikes(trace)
    known = np.isfinite(trace.theta[:, 0])
    trace = replace(trace, t=trace.t[known], theta=trace.theta[known])
    first = max(0, (len(trace.t) - NOISE_ROWS) // 2)
    last = (len(trace.t) + NOISE_ROWS) // 2
    middle = replace(trace, t=trace.t[first:last], theta=trace.theta[first:last])
    sigma = float(noise(middle)[0])
    swing = find_swing(file, trace.t, trace.theta[:, 0], period, sigma)
    part = trace.between(swing.begin, swing.end)
    # the reading at rest nearest to the middle of the swing
    turns = np.round((np.median(part.theta) - swing.zero) / (2 * np.pi))
    zero = float(swing.zero + 2 * np.pi * turns)
    return replace(part, theta=part.theta - zero), swing, zero
