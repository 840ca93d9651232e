"""Which columns of a file are time, angles and points: by their names in several languages, and by their content."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import first_names
from fitting.from_file.cells import Cells
from fitting.from_file.column_names import (
    ANGLE_UNITS,
    ANGLE_WORDS,
    AXIS_WORDS,
    FRAME_WORDS,
    LENGTH_UNITS,
    PER_TIME,
    RATE_WORDS,
    TIME_UNITS,
    TIME_WORDS,
    Column,
    parse_name,
)
from fitting.traces.csv_table import MOST_NAMES

#: Frame rates in comments.
FRAME_RATE = re.compile(
    r"(?:fps|frame ?rate|sample ?rate|bildrate|sampling)\s*[:=]?\s*(\d+(?:[.,]\d+)?)"
    r"|(\d+(?:[.,]\d+)?)\s*(?:fps|hz|frames/s|bilder/s|images/s)\b",
    re.IGNORECASE,
)
#: Fraction of the rows in which a column of time increases.
INCREASING_FRACTION = 0.95


@dataclass(frozen=True)
class Columns:
    """The columns that are used.

    Attributes:
        time: None: the rows are counted.
        time_unit: `s`, `ms`, `us`, `ns`, `frames`, or None if the name does not give it.
        rate: frames per second from a comment [1/s], or None.
        angles: from the first link on.
        angle_unit: `deg`, `rad`, `mrad`, `counts`, or None.
        points: x and y of points, in the order of the file.
        length_unit: `m`, `cm`, `mm`, `px`, or None.
        notes: how they were found.
    """

    time: Column | None
    time_unit: str | None
    rate: float | None
    angles: Sequence[Column]
    angle_unit: str | None
    points: Sequence[tuple[Column, Column]]
    length_unit: str | None
    notes: tuple[str, ...]


def find_columns(cells: Cells, given: Mapping[str, str] | None = None, rate: float | None = None) -> Columns:
    """The columns of time and of angles or points.

    Args:
        given: by `time`, `theta_1`, `x_1`, `y_1` ..., the names of columns; others than these are found.
        rate: rows per second [1/s] as the user gives them; a file may then have no column of times.

    Raises:
        SceneError: no time, nothing that moves, or several columns that may be the angle.
    """
    file = cells.file
    columns = []
    for name, values, is_clock in zip(cells.names, cells.values.T, cells.clock, strict=True):
        columns.append(Column(name, *parse_name(name), values, is_clock))
    if len(columns) == 1 and rate is None and fps_of(cells) is None:
        raise SceneError(f"{file}: has one column. Give time and angle, or --rate with the rows per second of a film")
    named = given_columns(cells, columns, given or {})
    time = named.pop("time", None) or time_column(file, columns)
    if named:
        return with_units(cells, time, *given_motion(named))
    return with_units(cells, time, *moving_columns(file, [column for column in columns if column is not time]))


def given_columns(cells: Cells, columns: Sequence[Column], given: Mapping[str, str]) -> dict[str, Column]:
    """The columns that the user names, by `time`, `theta_1` ..."""
    found: dict[str, Column] = {}
    for role, name in given.items():
        if not re.fullmatch(r"time|t|theta_\d+|[xy]_\d+", role):
            raise SceneError(f"columns: {role!r} is unknown; allowed: time, theta_1..n, x_1, y_1, x_2, ...")
        if name not in cells.names:
            raise SceneError(f"columns: {name!r} is not in {cells.file}; found: {first_names(cells.names, MOST_NAMES)}")
        if role == "t":
            role = "time"
        found[role] = columns[cells.names.index(name)]
    return found


def given_motion(named: Mapping[str, Column]) -> tuple[list[Column], list[tuple[Column, Column]]]:
    """Angles, or x and y of points, of columns by `theta_1`, `x_1`, `y_1` ...

    Raises:
        SceneError: a number is missing, a point has one coordinate, or there are both angles and points.
    """
    numbers = sorted({int(role.split("_")[1]) for role in named})
    angles = [named[f"theta_{i}"] for i in numbers if f"theta_{i}" in named]
    points = []
    for i in numbers:
        x = named.get(f"x_{i}")
        y = named.get(f"y_{i}")
        if (x is None) != (y is None):
            raise SceneError(f"columns: point {i} needs both x_{i} and y_{i}")
        if x is not None and y is not None:
            points.append((x, y))
    if numbers != list(range(1, len(numbers) + 1)) or (angles and points):
        raise SceneError(f"columns: {', '.join(named)}; allowed: theta_1 to theta_n, or x_1, y_1 to x_n, y_n")
    return angles, points


def moving_columns(file: str, columns: Sequence[Column]) -> tuple[list[Column], list[tuple[Column, Column]]]:
    """Angles, or x and y of points, among columns of which none is the time.

    Raises:
        SceneError: nothing moves but rates, or several columns that may be the angle.
    """
    free = [column for column in columns if not column.has(FRAME_WORDS)]
    points = [(x, y) for x, y in point_pairs(free) if np.isfinite([x.values, y.values]).mean() > 0.1]
    if points:
        return [], points
    moving = [column for column in free if column.moves]
    angles = angle_columns(file, moving)
    if angles:
        return angles, []
    rates = [column.name for column in moving if column.is_rate]
    if rates:
        names = first_names(rates, MOST_NAMES)
        raise SceneError(f"{file}: shows rates alone: {names}. Give angles or points, or fit a gyro as a channel")
    still = first_names([column.name for column in free], MOST_NAMES) or "its columns"
    raise SceneError(f"{file}: nothing moves in {still}. Give a file with motion")


def with_units(
    cells: Cells, time: Column | None, angles: Sequence[Column], points: Sequence[tuple[Column, Column]]
) -> Columns:
    """The columns with their units, as the names and comments give them."""
    time_unit = None
    note = "rows counted as time, "
    if time is not None:
        note = f"time from {time.name!r}, "
        if time.is_clock:
            time_unit = "s"
        elif time.has(FRAME_WORDS):
            time_unit = "frames"
        elif time.unit in TIME_UNITS.values():
            time_unit = time.unit
    what = [column.name for column in angles] or [f"({x.name}, {y.name})" for x, y in points]
    kind = "angles" if angles else "points"
    return Columns(
        time=time,
        time_unit=time_unit,
        rate=fps_of(cells),
        angles=angles,
        angle_unit=common_unit(angles, ANGLE_UNITS),
        points=points,
        length_unit=common_unit(list(chain.from_iterable(points)), LENGTH_UNITS),
        notes=(f"{note}{kind} from {', '.join(what)}",),
    )


def common_unit(columns: Sequence[Column], units: Mapping[str, str]) -> str | None:
    """The one unit of these that the columns' names give."""
    found = {column.unit for column in columns} & set(units.values())
    if len(found) == 1:
        return found.pop()
    return None


def fps_of(cells: Cells) -> float | None:
    """Frame rate in the comments [1/s]."""
    for comment in cells.comments:
        found = FRAME_RATE.search(comment)
        if found:
            return float((found[1] or found[2]).replace(",", "."))
    return None


def is_increasing(values: np.ndarray) -> bool:
    """Whether a column increases in nearly all rows."""
    step = np.diff(values[np.isfinite(values)])
    return len(step) > 5 and np.mean(step >= 0) > INCREASING_FRACTION and np.mean(step > 0) > 0.3


def time_column(file: str, columns: Sequence[Column]) -> Column | None:
    """The column of times: by name, by times of day, by a unit of time, by content; frames are the last choice.

    Raises:
        SceneError: a column of times that does not increase.
    """
    clocks = [column for column in columns if column.is_clock]
    named = [column for column in columns if column.has(TIME_WORDS) and not column.has(RATE_WORDS)]
    named += [column for column in columns if column.unit in TIME_UNITS.values()]
    frames = [column for column in columns if column.has(FRAME_WORDS)]
    for column in (*clocks, *named, *frames):
        if is_increasing(column.values):
            return column
    if named:
        if is_increasing(-named[0].values):
            raise SceneError(f"{file}: {named[0].name} decreases from row to row. Reverse the rows")
        return named[0]
    return next((column for column in columns if is_increasing(column.values) and column.moves), None)


def point_pairs(columns: Sequence[Column]) -> list[tuple[Column, Column]]:
    """(x, y) columns of points, of names that differ only in the axis; by their numbers, otherwise by their columns."""
    axes: dict[tuple[str, ...], dict[str, Column]] = {}
    for column in columns:
        own = [word for word in column.words if word in AXIS_WORDS]
        rest = tuple(word for word in column.words if word not in AXIS_WORDS)
        other = (set(rest) - {"a"}) & (RATE_WORDS | ANGLE_WORDS | TIME_WORDS)
        if len(own) == 1 and not other and not PER_TIME.search(column.name):
            # `u, v` and `x, z` are pairs too, but of x, y, z the plane is that of x and y
            axes.setdefault(rest, {}).setdefault(AXIS_WORDS[own[0]], column)
    pairs = [(pair["x"], pair["y"]) for pair in axes.values() if len(pair) == 2]
    if all(x.ordinal is not None for x, _ in pairs):
        pairs.sort(key=lambda pair: pair[0].ordinal)
    return pairs


def angle_columns(file: str, moving: Sequence[Column]) -> list[Column]:
    """The columns of angles: by name, otherwise the only one that swings.

    Raises:
        SceneError: several columns may be the angle.
    """
    usable = [column for column in moving if not column.is_rate]
    named = [column for column in usable if column.has(ANGLE_WORDS) or column.unit in ANGLE_UNITS.values()]
    if named:
        return sorted(without_copies(named), key=lambda column: column.ordinal or 0)
    swinging = [column for column in usable if not is_increasing(column.values) and not is_increasing(-column.values)]
    swinging = without_copies(swinging)
    if len(swinging) > 1:
        names = [column.name for column in swinging]
        raise SceneError(
            f"{file}: several columns may be the angle: {first_names(names, MOST_NAMES)}. Name it: --columns "
            f"theta_1={names[0]}"
        )
    return swinging


def without_copies(columns: Sequence[Column]) -> list[Column]:
    """The columns without those that are another one in another unit."""
    found: list[Column] = []
    for column in columns:
        if not any(are_proportional(column.values, other.values) for other in found):
            found.append(column)
    return found


def are_proportional(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two columns are the same motion in two units, or about two zeros."""
    known = np.isfinite(one) & np.isfinite(other)
    return known.sum() >= 10 and abs(np.corrcoef(one[known], other[known])[0, 1]) > 0.99999
