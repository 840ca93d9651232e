"""Cells of a text file: separator, decimal comma, one or two rows of names, clock times, missing samples."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.traces.text_lines import read_lines

#: Rows that decide between separators, and the fraction of their cells that must be numbers.
TRIED_ROWS = 200
NUMBER_FRACTION = 0.5
#: Weight of a separator that gives a single column.
ONE_COLUMN_WEIGHT = 0.5
#: What a file without samples lacks.
NO_ROWS = "has fewer than two rows of numbers. Give a text file with a row per sample: time and angle"
#: Text of a missing sample.
MISSING_TEXTS = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "#n/a", "#nv")
#: Units that may have a row of their own below the names.
UNIT_WORD = re.compile("s|ms|us|ns|µs|sec|min|deg|°|rad|mrad|m|cm|mm|px|pixel|counts")
#: Seconds of a day.
SECONDS_PER_DAY = 86400.0
#: Hours, minutes and seconds, after a date (in any order) or alone.
TIME_OF_DAY = re.compile(
    r"(?:\d{1,4}[-/.]\d\d?[-/.]\d{1,4}[T ])?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(?:Z|[+-]\d\d:?\d\d)?"
)


@dataclass(frozen=True)
class Cells:
    """The numbers of a file.

    Attributes:
        file: its name.
        comments: lines before and between the rows that are not samples.
        names: of the columns; a column without a name is called `column_1`, `column_2` ...
        values: (rows, columns); NaN is missing.
        clock: whether a column contained times of day (columns,).
    """

    file: str
    comments: tuple[str, ...]
    names: tuple[str, ...]
    values: np.ndarray
    clock: tuple[bool, ...]


def read_cells(path: Path) -> Cells:
    """The numbers of a file.

    Raises:
        SceneError: a file that cannot be read, is not text, is too large or has fewer than two rows of numbers.
    """
    lines = read_lines(path)
    separator, comma = find_separator(path.name, lines)
    rows = [split_cells(line, separator) for line in lines]
    good = [is_sample(row, comma) for row in rows]
    widths = Counter(map(len, compress(rows, good)))
    if widths.total() < 2:
        raise SceneError(f"{path.name}: {NO_ROWS}")
    width = widths.most_common(1)[0][0]
    samples = []
    before: list[list[str]] = []
    comments = []
    for line, row, usable in zip(lines, rows, good, strict=True):
        if separator is not None and len(row) == width - 1 and line.endswith(separator):
            row = [*row, ""]  # its last sample is missing
        if usable and len(row) == width:
            samples.append(row)
            continue
        comments.append(line.strip())
        if not samples and not usable and not line.lstrip().startswith("#"):
            before.append(row)
    values = np.array([cell_number(cell, comma) for row in samples for cell in row]).reshape(-1, width)
    clock = tuple(map(is_clock, zip(*samples[:10], strict=True)))
    for column in np.flatnonzero(clock):
        values[:, column] = continue_past_midnight(values[:, column])
    return Cells(path.name, tuple(comments), name_columns(before, width), values, clock)


def is_clock(column: Sequence[str]) -> bool:
    """Whether a cell of a column is a time of day."""
    return any(TIME_OF_DAY.fullmatch(cell.strip()) for cell in column)


def continue_past_midnight(times: np.ndarray) -> np.ndarray:
    """Times of day (rows,) [s], of which those after a midnight continue from those before it; NaN is missing."""
    times = times.copy()
    known = np.isfinite(times)
    steps = np.diff(times[known], prepend=times[known][:1])
    # a second run on the same day starts less than half a day before the end of the first
    times[known] += SECONDS_PER_DAY * np.cumsum(steps < -0.5 * SECONDS_PER_DAY)
    return times


def find_separator(file: str, lines: Sequence[str]) -> tuple[str | None, bool]:
    """The separator of columns (None: white space) and whether decimals have a comma, from the middle of a file.

    Raises:
        SceneError: no separator gives rows of equal numbers.
    """
    middle = lines[len(lines) // 3 :][:TRIED_ROWS]
    best: tuple[float, str | None, bool] | None = None
    # a comma between columns is tried last: rows of decimal commas have a comma too
    for separator, comma in ((";", True), ("\t", True), (None, True), (",", False), ("|", True)):
        rows = [split_cells(line, separator) for line in middle]
        width = max(map(len, rows))
        decimals = comma and any(re.fullmatch(r"\s*[+-]?\d*,\d+\s*", cell) for row in rows for cell in row)
        good = [row for row in rows if len(row) == width and is_sample(row, decimals)]
        score = len(good) / len(rows)
        if width == 1:
            score *= ONE_COLUMN_WEIGHT
        if score > NUMBER_FRACTION * ONE_COLUMN_WEIGHT and (best is None or score > best[0]):
            best = score, separator, bool(decimals)
    if best is None:
        raise SceneError(f"{file}: {NO_ROWS}")
    if best[1] == "," and best[0] > 0.9:
        check_commas(file, [split_cells(line, ",") for line in middle])
    return best[1], best[2]


def check_commas(file: str, rows: Sequence[Sequence[str]]) -> None:
    """Reject decimal commas between columns separated by commas: `0,016,12,5`."""
    padded = 0
    for row in rows:
        if len(row) < 4 or len(row) % 2 or not all(re.fullmatch(r"\s*[+-]?\d+\s*", cell) for cell in row):
            return
        padded += any(re.match(r"\s*0\d", cell) for cell in row[1::2])
    if padded > 0.1 * len(rows):
        raise SceneError(
            f"{file}: decimal commas in a file with comma-separated columns. Use semicolons between columns"
        )


def split_cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line."""
    if separator is None:
        return line.split()
    if '"' in line:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    cells = line.split(separator)
    if len(cells) > 1 and not cells[-1].strip():
        cells = cells[:-1]  # a separator at the end of every row
    return cells


def is_sample(row: Sequence[str], comma: bool) -> bool:
    """Whether a row has numbers, and otherwise only missing samples."""
    others = [cell for cell in row if not math.isfinite(cell_number(cell, comma))]
    return len(others) < len(row) and all(cell.strip().lower() in MISSING_TEXTS for cell in others)


def cell_number(cell: str, comma: bool) -> float:
    """The number of a cell, in seconds for a time of day; NaN is missing."""
    text = cell.strip().strip('"')
    digits = text
    if comma and "," in text:
        digits = text.replace(".", "").replace(",", ".")
    try:
        value = float(digits)
    except ValueError:
        time = TIME_OF_DAY.fullmatch(text)
        if time is None:
            return math.nan
        hours, minutes, seconds = time.groups()
        value = 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds.replace(",", "."))
    if math.isfinite(value):
        return value
    return math.nan


def name_columns(before: Sequence[Sequence[str]], width: int) -> tuple[str, ...]:
    """Names of the columns from the rows above the samples: the last row of that width, below a row of groups.

    `mass_A,,,mass_B,,` above `t,x,y,t,x,y` gives `mass_A t`, `mass_A x` ...
    """
    heads = []
    for row in before:
        if abs(len(row) - width) <= 1:
            heads.append([cell.strip().strip('"') for cell in [*row, ""][:width]])
    if not heads:
        return tuple(f"column_{i + 1}" for i in range(width))
    if len(heads) > 1 and are_units(heads[-1]):
        for i, unit in enumerate(heads.pop()):
            if unit:
                heads[-1][i] += f" [{unit.strip('[]()')}]"
    groups = heads[-2] if len(heads) > 1 else [""] * width
    group = ""
    found = []
    for i, (above, name) in enumerate(zip(groups, heads[-1], strict=True)):
        group = above or group
        if name != group:
            name = f"{group} {name}".strip()
        found.append(name or f"column_{i + 1}")
    return tuple(found)


def are_units(row: Sequence[str]) -> bool:
    """Whether a row contains the units of the columns: nothing longer than a unit, and one that is known."""
    if not any(UNIT_WORD.fullmatch(cell.strip("[]()")) for cell in row):
        return False
    return all(re.fullmatch(r"[\[(]?[^\w]*[a-zA-Z°/µ²%]*[\])]?", cell) for cell in row)
