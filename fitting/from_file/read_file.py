"""A measured file of any program as a trace: columns, clock, unit, free swing and thinning, each with a note."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.scene.fit import FIT_UNITS
from fitting.from_file.angles import read_angles
from fitting.from_file.cells import Cells, read_cells
from fitting.from_file.clock import Rows, ordered_rows, unit_of_time
from fitting.from_file.columns import Columns, find_columns
from fitting.from_file.motion import Motion
from fitting.from_file.points import read_points
from fitting.from_file.swing import Swing, find_swing, gravity_of_last_link, main_period
from fitting.from_file.thinning import thin
from fitting.traces.noise import noise, without_spikes
from fitting.traces.planar import pendulum_period
from fitting.traces.trace import Convention, Trace

#: Metres per unit of length.
METRES = {name: size for name, (base, size) in FIT_UNITS.items() if base == "m"}
#: Ratio of a unit of length to that which gravity shows, within which the unit is taken.
FITS_UNIT = 1.3
#: Period of the smoothing of a chain, whose links swing faster than its main motion.
SMOOTHED = 0.6
#: Rows that show the noise.
FOR_NOISE = 6000
#: First time [s] above which the clock of a trace starts at its first row.
LATE = 1e5


@dataclass(frozen=True)
class Given:
    """What a user states about a file; None: found from it.

    Attributes:
        columns: by `time`, `theta_1`, `x_1`, `y_1` ..., the names of columns.
        unit: of angles, `rad`, `deg` or `counts`.
        rate: frames or rows per second [1/s].
        counts: of an encoder per turn.
        lengths: of the links [m].
        mass: of each link's end [kg].
        begin: start of the span that is used [s] of the file's clock.
    """

    columns: Mapping[str, str] | None = None
    unit: str | None = None
    rate: float | None = None
    counts: float | None = None
    lengths: tuple[float, ...] | None = None
    mass: float | None = None
    begin: float | None = None


#: Everything is found from the file.
NOTHING = Given()


@dataclass(frozen=True)
class Measured:
    """A file as a trace.

    Attributes:
        trace: angles from straight down [rad], thinned.
        zero: reading at rest that was subtracted [rad].
        swing: the free swing of one link; None for several.
        lengths: of the links [m] as points or the user give them; None: unknown.
        open_end: whether the length of the last link follows from the motion alone.
        notes: how everything was found.
    """

    trace: Trace
    zero: float
    swing: Swing | None
    lengths: np.ndarray | None
    open_end: bool
    notes: tuple[str, ...]


def read_measured(path: str | Path, given: Given = NOTHING, links: int | None = None) -> Measured:
    """A file as a trace.

    Args:
        links: of the scene, if there is one: lengths are then known.

    Raises:
        SceneError: one line with what is wrong or missing, and what to give.
    """
    path = Path(path)
    cells = read_cells(path)
    columns = find_columns(cells, given.columns)
    rows = used_rows(cells, columns)
    motion = motion_of(cells, columns, rows.t, rows.values, given)
    period = main_period(motion.t, motion.theta)
    second, how = clock_unit(cells.file, columns, motion.t, period, given)
    # dates in seconds since 1970 lose digits
    start = second * rows.start
    if abs(start) >= LATE:
        start = 0.0
    times = start + second * motion.t
    period = second * period
    count = motion.theta.shape[1]
    if links is not None and count != links:
        raise SceneError(f"{cells.file}: shows {count} links, but the scene has {links}. Use the scene of this file")
    notes = [*columns.notes, how, *rows.notes, *motion.notes]
    if rows.start and not start:
        notes.append("the clock starts at the first row")
    # zero and sign of a scene's own links follow from its pose
    convention = Convention(unit="rad")
    if count == 1 or columns.points or links is None:
        convention = Convention("down", 1, "rad")
    trace = Trace(path.stem, times, motion.theta, convention=convention)
    trace = cut_span(trace, given)
    swing = None
    zero = 0.0
    if count == 1:
        trace, swing, zero = free_part(cells.file, trace, period)
        notes += [*swing.notes, f"the reading at rest, {zero:.4g} rad, is subtracted"]
    lengths, note = lengths_in_metres(cells.file, columns.length_unit, motion, times, period, given, links)
    notes += note
    trace, note = thinned(trace, fastest_period(period, count, lengths))
    notes += note
    open_end = motion.lengths is not None and bool(np.isnan(motion.lengths[-1])) and count > 1
    return Measured(trace, zero, swing, lengths, open_end, tuple(notes))


def used_rows(cells: Cells, columns: Columns) -> Rows:
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


def clock_unit(file: str, columns: Columns, t: np.ndarray, period: float, given: Given) -> tuple[float, str]:
    """Unit of the file's clock [s] from its times (k,) and the main period in this unit, and how it was found."""
    name = None
    if columns.time is not None:
        name = columns.time.name
    unit = columns.time_unit
    if given.rate and unit is None:
        unit = "frames"
    return unit_of_time(file, t, period, unit, given.rate or columns.rate, name)


def fastest_period(period: float, count: int, lengths: np.ndarray | None) -> float:
    """Shortest period [s] of a motion of this main period and number of links, whose lengths (n,) [m] may be known."""
    if count == 1:
        return period
    if lengths is None:
        return 0.5 * period  # assumed for links of unknown lengths
    return pendulum_period(lengths)


def thinned(trace: Trace, fastest: float) -> tuple[Trace, list[str]]:
    """The trace with as many rows as a motion of this shortest period [s] needs, and a note if rows were left out."""
    t, theta, many = thin(trace.t, trace.theta, fastest)
    if len(t) == len(trace.t):
        return trace, []
    what = "one for each stretch of time"
    if many > 1:
        what = f"each the mean of about {many}"
    return replace(trace, t=t, theta=theta), [f"{len(trace.t)} rows thinned to {len(t)}, {what}"]


def motion_of(cells: Cells, columns: Columns, t: np.ndarray, values: np.ndarray, given: Given) -> Motion:
    """The motion by the columns' values (k, columns)."""
    if columns.points:
        return read_points(cells.file, t, values[:, ::2].T + 1j * values[:, 1::2].T)
    return read_angles(cells.file, t, values, given.unit or columns.angle_unit, given.counts)


def cut_span(trace: Trace, given: Given) -> Trace:
    """The trace from the time on that the user gives.

    Raises:
        SceneError: hardly a row is left.
    """
    if given.begin is None:
        return trace
    found = trace.between(given.begin, np.inf)
    if len(found.t) < 10:
        raise SceneError(
            f"{trace.name}: {len(found.t)} rows after --from {given.begin:g} s; the file has {trace.t[0]:g} to "
            f"{trace.t[-1]:g} s"
        )
    return found


def free_part(file: str, trace: Trace, period: float) -> tuple[Trace, Swing, float]:
    """The free swing of one link, about its zero, and that zero [rad]."""
    trace = without_spikes(trace)
    known = np.isfinite(trace.theta[:, 0])
    trace = replace(trace, t=trace.t[known], theta=trace.theta[known])
    # rows in the middle, where it swings; the noise of a long file would take longer than its fit
    middle = slice(max(0, (len(trace.t) - FOR_NOISE) // 2), (len(trace.t) + FOR_NOISE) // 2)
    sigma = float(noise(replace(trace, t=trace.t[middle], theta=trace.theta[middle]))[0])
    swing = find_swing(file, trace.t, trace.theta[:, 0], period, sigma)
    part = trace.between(swing.begin, swing.end)
    # the reading at rest nearest to the middle of the swing
    turns = np.round((np.median(part.theta) - swing.zero) / (2 * np.pi))
    zero = float(swing.zero + 2 * np.pi * turns)
    return replace(part, theta=part.theta - zero), swing, zero


def lengths_in_metres(
    file: str,
    unit: str | None,
    motion: Motion,
    times: np.ndarray,
    period: float,
    given: Given,
    links: int | None,
) -> tuple[np.ndarray | None, list[str]]:
    """Lengths of the links (n,) [m], and notes.

    Args:
        unit: of the points, if their names give it.
        times: of the motion (k,) [s].

    Raises:
        SceneError: several links without lengths.
    """
    count = motion.theta.shape[1]
    missing = ",".join(f"L{j + 1}" for j in range(count))
    if given.lengths is not None:
        if len(given.lengths) != count:
            raise SceneError(f"--lengths: {len(given.lengths)} values; {file} shows {count} links")
        return np.array(given.lengths), ["lengths as given"]
    if count == 1 or links is not None:
        return None, []
    if motion.lengths is None or motion.joint is None:
        raise SceneError(
            f"{file}: the angles of {count} links do not show their lengths. Give them [m]: --lengths {missing}"
        )
    shown = gravity_of_last_link(times, motion.joint, motion.theta[:, -1], SMOOTHED * period)
    lengths = motion.lengths.copy()
    if np.isnan(lengths[-1]):
        lengths[-1] = np.nanmean(lengths)
        if shown is not None:
            lengths[-1] = shown[1]
    if shown is None and unit not in METRES:
        raise SceneError(f"{file}: the points show no scale. Give the lengths of the links [m]: --lengths {missing}")
    scale = 1.0
    if shown is not None:
        scale = GRAVITY / shown[0]
    if unit is None:
        near = (name for name, size in METRES.items() if abs(np.log(scale / size)) < np.log(FITS_UNIT))
        unit = next(near, "px")
    text = ", ".join(f"{x / np.sum(lengths):.3g}" for x in lengths)
    if unit in METRES:
        return lengths * METRES[unit], [f"lengths from the points in {unit}, in parts of the whole: {text}"]
    return lengths * scale, [f"lengths from the points, scaled by gravity, in parts of the whole: {text}"]
