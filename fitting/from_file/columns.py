"""Which columns of a file are time, angles and points: by their names in several languages, and by their content."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.markdown import first_names
from fitting.from_file.cells import Cells
from fitting.traces.csv_table import NAMED


def words(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


#: Words of names, without accents: English, German, French, Spanish, Italian, Portuguese, Dutch, Nordic, Polish, Czech,
#: Finnish, Chinese, Japanese.
TIME = words(
    """
    t time timestamp elapsed clock seconds millis zeit uhrzeit temps heure tiempo hora tempo tijd tid czas cas aika
    sekunden sec msec 时间 時間 時刻
    """
)
FRAME = words("frame frames bild bildnummer image cuadro fotogramma quadro beeld klatka snimek index idx")
ANGLE = words(
    """
    theta angle angles winkel angulo angolo hoek vinkel kat uhel kulma phi alpha encoder counts count ticks
    deflection auslenkung inclination θ φ α 角度 deg rad
    """
)
RATE = words(
    """
    omega velocity vel v vx vy speed rate acc acceleration a ax ay geschwindigkeit vitesse velocidad velocita w ω se
    sigma error
    """
)
AXES = {"x": "x", "u": "x", "y": "y", "z": "y", "v": "y"}
#: Units by their words: what is measured, and the unit.
TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sekunden", "secondes", "segundos"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds", "millisekunden"), "ms"),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), "us"),
}
ANGLE_UNITS = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "grad", "°", "º", "grados", "gradi", "degres"), "deg"),
    **dict.fromkeys(("rad", "rads", "radian", "radians", "radianti", "radianes"), "rad"),
    "mrad": "mrad",
    **dict.fromkeys(("counts", "count", "ticks", "pulses", "steps", "inkremente"), "counts"),
}
LENGTH_UNITS = {"m": "m", "cm": "cm", "mm": "mm", "px": "px", "pixel": "px", "pixels": "px", "pix": "px"}
UNITS = {**TIME_UNITS, **ANGLE_UNITS, **LENGTH_UNITS}
#: Frame rates in comments.
FPS = re.compile(
    r"(?:fps|frame ?rate|sample ?rate|bildrate|sampling)\s*[:=]?\s*(\d+(?:[.,]\d+)?)"
    r"|(\d+(?:[.,]\d+)?)\s*(?:fps|hz|frames/s|bilder/s|images/s)\b",
    re.IGNORECASE,
)
#: Fraction of the rows in which a column of time increases.
INCREASES = 0.95


@dataclass(frozen=True)
class Columns:
    """The columns that are used.

    Attributes:
        time: number of the column of times; None: the rows are counted.
        time_unit: `s`, `ms`, `us`, `frames`, or None if the name does not give it.
        rate: frames per second from a comment [1/s], or None.
        angles: numbers of the columns of angles, from the first link on.
        angle_unit: `deg`, `rad`, `mrad`, `counts`, or None.
        points: (x, y) columns of points, in the order of the file.
        length_unit: `m`, `cm`, `mm`, `px`, or None.
        notes: how they were found.
    """

    time: int | None
    time_unit: str | None
    rate: float | None
    angles: tuple[int, ...]
    angle_unit: str | None
    points: tuple[tuple[int, int], ...]
    length_unit: str | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Name:
    """A column's name as words and numbers, and its unit."""

    words: tuple[str, ...]
    unit: str | None


def parse_name(name: str) -> Name:
    """Words of a name without accents and units: `Winkel 1 [°]` is ("winkel", "1") in degrees."""
    text = "".join(c for c in unicodedata.normalize("NFKD", name.lower()) if not unicodedata.combining(c))
    inside = re.findall(r"[\[(/]\s*([^\])]*?)\s*[\])]?\s*$", text)
    unit = next((UNITS[part] for part in inside if part in UNITS), None)
    if unit is not None:
        text = re.sub(r"[\[(/][^\])]*[\])]?\s*$", "", text)
    words = re.findall(r"[^\W\d_]+|\d+|°", text)
    if unit is None and len(words) > 1 and words[-1] in UNITS:
        unit = UNITS[words.pop()]
    if unit is None and len(words) == 1 and words[0] in UNITS and words[0] not in ("m", "s"):
        unit = UNITS[words[0]]
    return Name(tuple(words), unit)


def find_columns(cells: Cells, given: Mapping[str, str] | None = None) -> Columns:
    """The columns of time and of angles or points.

    Args:
        given: by `time`, `theta_1`, `x_1`, `y_1` ..., the names of columns.

    Raises:
        SceneError: no time, nothing that moves, or several columns that may be the angle.
    """
    names = [parse_name(name) for name in cells.names]
    if cells.values.shape[1] == 1:
        if given is None and not fps_of(cells):
            advice = "Give time and angle, or --rate with the rows per second of a film"
            raise SceneError(f"{cells.file}: has one column. {advice}")
        raise SceneError(f"{cells.file}: has one column of numbers")
    if given:
        return given_columns(cells, names, given)
    time = time_column(cells, names)
    used = set() if time is None else {time}
    used |= {i for i, name in enumerate(names) if set(name.words) & FRAME}
    free = [i for i in range(len(names)) if i not in used]
    points = [pair for pair in point_pairs(names, free) if np.isfinite(cells.values[:, pair]).mean() > 0.1]
    angles = []
    if not points:
        angles = angle_columns(cells, names, [i for i in free if moves(cells.values[:, i])])
    if not points and not angles:
        still = [cells.names[i] for i in free]
        raise SceneError(
            f"{cells.file}: nothing moves in {first_names(still, NAMED) or 'its columns'}. Give a file with motion"
        )
    return describe(cells, names, time, angles, points)


def given_columns(cells: Cells, names: Sequence[Name], given: Mapping[str, str]) -> Columns:
    """The columns that the user names."""
    where: dict[str, int] = {}
    for role, column in given.items():
        if not re.fullmatch(r"time|t|theta_\d+|[xy]_\d+", role):
            raise SceneError(f"columns: {role!r} is unknown; allowed: time, theta_1..n, x_1, y_1, x_2, ...")
        if column not in cells.names:
            raise SceneError(f"columns: {column!r} is not in {cells.file}; found: {first_names(cells.names, NAMED)}")
        where["time" if role == "t" else role] = cells.names.index(column)
    time = where.get("time", time_column(cells, names))
    angles = [where[role] for role in sorted(where) if role.startswith("theta")]
    numbers = sorted({role[2:] for role in where if role[:2] in ("x_", "y_")}, key=int)
    if lacks := next((k for k in numbers if not (f"x_{k}" in where and f"y_{k}" in where)), None):
        raise SceneError(f"columns: point {lacks} needs both x_{lacks} and y_{lacks}")
    points = [(where[f"x_{k}"], where[f"y_{k}"]) for k in numbers]
    return describe(cells, names, time, angles, points)


def describe(
    cells: Cells,
    names: Sequence[Name],
    time: int | None,
    angles: Sequence[int],
    points: Sequence[tuple[int, int]],
) -> Columns:
    """The columns with their units, as the names and comments give them."""
    time_unit = None
    if time is not None:
        if cells.clock[time]:
            time_unit = "s"
        elif set(names[time].words) & FRAME:
            time_unit = "frames"
        else:
            time_unit = names[time].unit
        if time_unit not in ("s", "ms", "us", "frames"):
            time_unit = None
    units = {names[i].unit for i in angles} & set(ANGLE_UNITS.values())
    lengths = {names[i].unit for pair in points for i in pair} & set(LENGTH_UNITS.values())
    what = [cells.names[i] for i in angles] or [f"({cells.names[x]}, {cells.names[y]})" for x, y in points]
    kind = "angles" if angles else "points"
    if time is not None:
        note = f"time from {cells.names[time]!r}, "
    else:
        note = "rows counted as time, "
    return Columns(
        time,
        time_unit,
        fps_of(cells),
        tuple(angles),
        units.pop() if len(units) == 1 else None,
        tuple(points),
        lengths.pop() if len(lengths) == 1 else None,
        (f"{note}{kind} from {', '.join(what)}",),
    )


def fps_of(cells: Cells) -> float | None:
    """Frame rate in the comments [1/s]."""
    for comment in cells.comments:
        found = FPS.search(comment)
        if found:
            return float((found[1] or found[2]).replace(",", "."))
    return None


def increases(values: np.ndarray) -> bool:
    """Whether a column increases in nearly all rows."""
    step = np.diff(values[np.isfinite(values)])
    return len(step) > 5 and np.mean(step >= 0) > INCREASES and np.mean(step > 0) > 0.3


def moves(values: np.ndarray) -> bool:
    """Whether a column takes several values."""
    known = values[np.isfinite(values)]
    return len(known) > 5 and float(np.ptp(known)) > 1e-9 * max(1.0, float(np.max(np.abs(known))))


def time_column(cells: Cells, names: Sequence[Name]) -> int | None:
    """The column of times: by name, by times of day, by a unit of time, by content; frames are the last choice.

    Raises:
        SceneError: a column of times that does not increase.
    """
    count = len(names)
    clocks = [i for i in range(count) if cells.clock[i]]
    named = [i for i in range(count) if set(names[i].words) & TIME and not set(names[i].words) & RATE]
    named += [i for i in range(count) if names[i].unit in TIME_UNITS.values() and i not in named]
    good = [i for i in [*clocks, *named] if increases(cells.values[:, i])]
    if good:
        return good[0]
    frames = [i for i in range(count) if set(names[i].words) & FRAME and increases(cells.values[:, i])]
    if frames:
        return frames[0]
    if named:
        column = cells.values[:, named[0]]
        if increases(-column):
            raise SceneError(f"{cells.file}: {cells.names[named[0]]} decreases from row to row. Reverse the rows")
        return named[0]
    content = [i for i in range(count) if increases(cells.values[:, i]) and moves(cells.values[:, i])]
    return next(iter(content), None)


def point_pairs(names: Sequence[Name], free: Sequence[int]) -> list[tuple[int, int]]:
    """(x, y) columns of points, of names that differ only in the axis."""
    axes: dict[tuple[str, ...], dict[str, int]] = {}
    for i in free:
        words = names[i].words
        own = [word for word in words if word in AXES]
        if len(own) != 1 or (set(words) - set(AXES) - {"a"}) & (RATE | ANGLE | TIME):
            continue
        rest = tuple(word for word in words if word not in AXES)
        axis = AXES[own[0]]
        # `u, v` and `x, z` are pairs too, but of x, y, z the plane is that of x and y
        if axis not in axes.setdefault(rest, {}):
            axes[rest][axis] = i
    pairs = {rest: pair for rest, pair in axes.items() if len(pair) == 2}
    return [(pairs[rest]["x"], pairs[rest]["y"]) for rest in sorted(pairs, key=lambda rest: sorting_key(rest, pairs))]


def sorting_key(rest: tuple[str, ...], pairs: Mapping[tuple[str, ...], Mapping[str, int]]) -> tuple[float, int]:
    """Order of a point: by its number, otherwise by its column."""
    number = next((int(word) for word in rest if word.isdecimal()), None)
    numbered = all(any(word.isdecimal() for word in one) for one in pairs)
    return (float(number) if numbered and number is not None else 0.0, min(pairs[rest].values()))


def angle_columns(cells: Cells, names: Sequence[Name], moving: Sequence[int]) -> list[int]:
    """The columns of angles: by name, otherwise the only one that swings.

    Raises:
        SceneError: several columns may be the angle.
    """
    usable = [i for i in moving if not is_rate(names[i])]
    named = [i for i in usable if set(names[i].words) & ANGLE or names[i].unit in ANGLE_UNITS.values()]
    named = without_copies(cells, named)
    if named:
        return sorted(named, key=lambda i: (next((int(w) for w in names[i].words if w.isdecimal()), 0), i))
    swinging = [i for i in usable if not increases(cells.values[:, i]) and not increases(-cells.values[:, i])]
    swinging = without_copies(cells, swinging)
    if len(swinging) > 1:
        found = first_names([cells.names[i] for i in swinging], NAMED)
        raise SceneError(
            f"{cells.file}: several columns may be the angle: {found}. Name it: --columns "
            f"theta_1={cells.names[swinging[0]]}"
        )
    return swinging


def is_rate(name: Name) -> bool:
    """Whether a name is that of a rate or an error; single letters count alone only."""
    words = set(name.words) & RATE
    return any(len(word) > 1 or len(name.words) == 1 for word in words)


def without_copies(cells: Cells, columns: Sequence[int]) -> list[int]:
    """The columns without those that are another one in another unit."""
    found: list[int] = []
    for i in columns:
        if not any(alike(cells.values[:, i], cells.values[:, j]) for j in found):
            found.append(i)
    return found


def alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two columns are the same motion in two units."""
    known = np.isfinite(one) & np.isfinite(other)
    if known.sum() < 10:
        return False
    return abs(float(np.corrcoef(one[known], other[known])[0, 1])) > 0.99999
