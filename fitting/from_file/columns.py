"""Which columns of a file are time, angles and points: by their names in several languages, and by their content."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import first_names
from fitting.from_file.cells import Cells
from fitting.traces.csv_table import MOST_NAMES


def word_set(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


#: Words of names, without accents: English, German, French, Spanish, Italian, Portuguese, Dutch, Nordic, Polish, Czech,
#: Finnish, Chinese, Japanese.
TIME_WORDS = word_set(
    """
    t time timestamp elapsed clock seconds millis zeit uhrzeit temps heure tiempo hora tempo tijd tid czas cas aika
    sekunden sec msec 时间 時間 時刻
    """
)
FRAME_WORDS = word_set("frame frames bild bildnummer image cuadro fotogramma quadro beeld klatka snimek index idx")
ANGLE_WORDS = word_set(
    """
    theta angle angles winkel angulo angolo hoek vinkel kat uhel kulma phi alpha encoder counts count ticks
    deflection auslenkung inclination θ φ α 角度 deg rad
    """
)
RATE_WORDS = word_set(
    """
    omega velocity vel v vx vy speed rate acc acceleration a ax ay geschwindigkeit vitesse velocidad velocita w ω se
    sigma error gyro gyroscope
    """
)
#: A unit per time: `(rad/s)`, `[m s^-2]`.
PER_TIME = re.compile(r"/\s*s(?:ec)?(?:\b|\d|²)|(?:rad|deg|°|m)[\s·*.]+s\s*\^?\s*[-−⁻]\s*[12¹²]")
AXIS_WORDS = {"x": "x", "u": "x", "y": "y", "z": "y", "v": "y"}
#: Units by their words: what is measured, and the unit.
TIME_UNITS = {
    **dict.fromkeys(word_set("s sec secs second seconds sekunden secondes segundos"), "s"),
    **dict.fromkeys(word_set("ms msec millis milliseconds millisekunden"), "ms"),
    **dict.fromkeys(word_set("us µs μs usec micros microseconds"), "us"),
    **dict.fromkeys(word_set("ns nsec nanos nanoseconds"), "ns"),
}
ANGLE_UNITS = {
    **dict.fromkeys(word_set("deg degs degree degrees grad ° º grados gradi degres"), "deg"),
    **dict.fromkeys(word_set("rad rads radian radians radianti radianes"), "rad"),
    "mrad": "mrad",
    **dict.fromkeys(word_set("counts count ticks pulses steps inkremente"), "counts"),
}
LENGTH_UNITS = {"m": "m", "cm": "cm", "mm": "mm", **dict.fromkeys(word_set("px pixel pixels pix"), "px")}
UNITS = {**TIME_UNITS, **ANGLE_UNITS, **LENGTH_UNITS}
#: Frame rates in comments.
FRAME_RATE = re.compile(
    r"(?:fps|frame ?rate|sample ?rate|bildrate|sampling)\s*[:=]?\s*(\d+(?:[.,]\d+)?)"
    r"|(\d+(?:[.,]\d+)?)\s*(?:fps|hz|frames/s|bilder/s|images/s)\b",
    re.IGNORECASE,
)
#: Fraction of the rows in which a column of time increases.
INCREASING_FRACTION = 0.95


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file.

    Attributes:
        name: as written.
        words: of the name, without accents and units.
        unit: by the name, or None.
        values: (k,).
        is_clock: whether it contained times of day.
    """

    name: str
    words: tuple[str, ...]
    unit: str | None
    values: np.ndarray
    is_clock: bool

    def has(self, words: frozenset[str]) -> bool:
        """Whether one of these words is in the name."""
        return not words.isdisjoint(self.words)

    @property
    def ordinal(self) -> int | None:
        """The number in the name."""
        return next((int(word) for word in self.words if word.isdecimal()), None)


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


def parse_name(name: str) -> tuple[tuple[str, ...], str | None]:
    """Words of a name without accents and units, and the unit: `Winkel 1 [°]` is ("winkel", "1") in degrees."""
    text = "".join(c for c in unicodedata.normalize("NFKD", name.lower()) if not unicodedata.combining(c))
    inside = re.findall(r"[\[(/]\s*([^\])]*?)\s*[\])]?\s*$", text)
    unit = next((UNITS[part] for part in inside if part in UNITS), None)
    if unit is not None:
        text = re.sub(r"[\[(/][^\])]*[\])]?\s*$", "", text)
    words = re.findall(r"[^\W\d_]+|\d+|°", text)
    if unit is None and words and words[-1] in UNITS and not PER_TIME.search(text):
        if len(words) > 1:
            unit = UNITS[words.pop()]
        elif words[0] not in ("m", "s"):
            unit = UNITS[words[0]]
    return tuple(words), unit


def find_columns(cells: Cells, given: Mapping[str, str] | None = None, rate: float | None = None) -> Columns:
    """The columns of time and of angles or points.

    Args:
        given: by `time`, `theta_1`, `x_1`, `y_1` ..., the names of columns.
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
    if given:
        return given_columns(cells, columns, given)
    time = time_column(file, columns)
    free = [column for column in columns if column is not time and not column.has(FRAME_WORDS)]
    points = [(x, y) for x, y in point_pairs(free) if np.isfinite([x.values, y.values]).mean() > 0.1]
    angles = []
    if not points:
        angles = angle_columns(file, [column for column in free if moves(column.values)])
    rates = [column.name for column in free if is_rate(column) and moves(column.values)]
    if not points and not angles and rates:
        names = first_names(rates, MOST_NAMES)
        raise SceneError(f"{file}: shows rates alone: {names}. Give angles or points, or fit a gyro as a channel")
    if not points and not angles:
        still = first_names([column.name for column in free], MOST_NAMES) or "its columns"
        raise SceneError(f"{file}: nothing moves in {still}. Give a file with motion")
    return describe(cells, time, angles, points)


def given_columns(cells: Cells, columns: Sequence[Column], given: Mapping[str, str]) -> Columns:
    """The columns that the user names."""
    where: dict[str, Column] = {}
    for role, name in given.items():
        if not re.fullmatch(r"time|t|theta_\d+|[xy]_\d+", role):
            raise SceneError(f"columns: {role!r} is unknown; allowed: time, theta_1..n, x_1, y_1, x_2, ...")
        if name not in cells.names:
            raise SceneError(f"columns: {name!r} is not in {cells.file}; found: {first_names(cells.names, MOST_NAMES)}")
        if role == "t":
            role = "time"
        where[role] = columns[cells.names.index(name)]
    time = where.pop("time", None)
    if time is None:
        time = time_column(cells.file, columns)
    angles = []
    points = []
    for number in sorted({int(role.split("_")[1]) for role in where}):
        x = where.get(f"x_{number}")
        y = where.get(f"y_{number}")
        if f"theta_{number}" in where:
            angles.append(where[f"theta_{number}"])
        if x is not None and y is not None:
            points.append((x, y))
        elif x is not None or y is not None:
            raise SceneError(f"columns: point {number} needs both x_{number} and y_{number}")
    return describe(cells, time, angles, points)


def describe(
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


def increases(values: np.ndarray) -> bool:
    """Whether a column increases in nearly all rows."""
    step = np.diff(values[np.isfinite(values)])
    return len(step) > 5 and np.mean(step >= 0) > INCREASING_FRACTION and np.mean(step > 0) > 0.3


def moves(values: np.ndarray) -> bool:
    """Whether a column takes several values."""
    known = values[np.isfinite(values)]
    return len(known) > 5 and np.ptp(known) > 1e-9 * np.max(np.abs(known), initial=1.0)


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
        if increases(column.values):
            return column
    if named:
        if increases(-named[0].values):
            raise SceneError(f"{file}: {named[0].name} decreases from row to row. Reverse the rows")
        return named[0]
    return next((column for column in columns if increases(column.values) and moves(column.values)), None)


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
    usable = [column for column in moving if not is_rate(column)]
    named = [column for column in usable if column.has(ANGLE_WORDS) or column.unit in ANGLE_UNITS.values()]
    if named:
        return sorted(without_copies(named), key=lambda column: column.ordinal or 0)
    swinging = [column for column in usable if not increases(column.values) and not increases(-column.values)]
    swinging = without_copies(swinging)
    if len(swinging) > 1:
        names = [column.name for column in swinging]
        raise SceneError(
            f"{file}: several columns may be the angle: {first_names(names, MOST_NAMES)}. Name it: --columns "
            f"theta_1={names[0]}"
        )
    return swinging


def is_rate(column: Column) -> bool:
    """Whether a name or its unit is that of a rate, or a name that of an error; single letters count alone only."""
    if PER_TIME.search(column.name):
        return True
    return any(len(word) > 1 or len(column.words) == 1 for word in RATE_WORDS.intersection(column.words))


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
