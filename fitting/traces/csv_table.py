"""CSV files of measured columns, with a header that contains `t`: numbers, empty or `nan` for missing samples.

Columns are separated by commas, semicolons, tabs or spaces. Decimal commas are accepted if columns are not separated by
commas. Text is UTF-8, or UTF-16 with a byte order mark, as written by spreadsheets.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.markdown import first_names
from fitting.traces.text_lines import read_lines

#: Number of names in an error message.
MOST_NAMES = 8


class CsvTable(NamedTuple):
    """A file's name, its comments, the names of its columns (empty: not used), and its unparsed rows."""

    file: str
    comments: tuple[str, ...]
    names: list[str]
    rows: list[list[str]]

    def columns(self) -> dict[str, np.ndarray]:
        """The used columns (k,) by name.

        Raises:
            SceneError: two columns of one name, a row of another length, a cell that is not a number.
        """
        used = [name for name in self.names if name]
        if len(set(used)) != len(used):
            raise SceneError(f"{self.file}: duplicate column; found: {first_names(used, MOST_NAMES)}")
        values = dict(zip(self.names, self._numbers(), strict=True))
        values.pop("", None)
        return values

    def _numbers(self) -> np.ndarray:
        """All columns (columns, k); those that are not used are NaN."""
        count = len(self.names)
        table = np.full((len(self.rows), count), np.nan)
        for i, row in enumerate(self.rows):
            where = f"{self.file}: row {i + 1}"
            if len(row) == 2 * count:
                raise SceneError(
                    f"{where} has {len(row)} values for {count} columns: decimal commas in a file with "
                    "comma-separated columns. Use decimal points, or semicolons between columns"
                )
            if len(row) != count:
                raise SceneError(f"{where} has {len(row)} values; allowed: {count}, one per column")
            for j, cell in enumerate(row):
                if not self.names[j]:
                    continue
                try:
                    table[i, j] = float(cell.strip() or "nan")
                except ValueError:
                    raise SceneError(
                        f"{where}, {self.names[j]}: {cell.strip()!r} is not a number; "
                        "leave the cells of missing samples empty"
                    ) from None
        table[np.isinf(table)] = np.nan
        return table.T


def read_csv(
    path: Path,
    columns: str,
    renamed: Mapping[str, str] | None = None,
    advice: Callable[[list[str]], str] = lambda names: "rename the column of times to t",
) -> CsvTable:
    """The columns of a CSV file; lines that begin with # are comments.

    Args:
        columns: the required header, for error messages, such as `t, theta_1..n`.
        renamed: by name, the column of the file that has it; further columns of these names are not used.
        advice: what to do if there is no column t, from the names of those that exist.

    Raises:
        SceneError: a file that cannot be read, no samples, no column t or another one that does not exist.
    """
    comments = []
    body = []
    for line in read_lines(path):
        if line.lstrip().startswith("#"):
            comments.append(line.lstrip()[1:].strip())
        else:
            body.append(line)
    if len(body) < 2:
        raise SceneError(f"{path.name}: has no samples; allowed: a header {columns} and rows of numbers")
    try:
        rows = _split(body)
    except csv.Error as error:
        raise SceneError(
            f"{path.name}: not a CSV file: {error}; is a quotation mark not closed? allowed: columns {columns}"
        ) from None
    names = [name.strip() for name in rows[0]]
    if all(map(_is_number, names)):
        raise SceneError(f"{path.name}: has no header; allowed: a first row with the names of the columns, {columns}")
    renamed = renamed or {}
    unused = dict.fromkeys(renamed, "")
    used = [unused.get(name, name) for name in names]
    for name, column in renamed.items():
        if column not in names:
            raise SceneError(f"columns: {column!r} is not in {path.name}; {nearest(column, names)}")
        used[names.index(column)] = name
    if "t" not in used:
        raise SceneError(f"{path.name}: has no column 't'; found: {first_names(names, MOST_NAMES)}; {advice(names)}")
    return CsvTable(path.name, tuple(comments), used, rows[1:])


def _split(body: list[str]) -> list[list[str]]:
    """Cells of all rows, with decimal points."""
    # column names contain none of these, so the header decides; csv.Sniffer mistakes decimal commas for separators
    separator = next((mark for mark in ";\t," if mark in body[0]), None)
    if separator is None and " " in body[0].strip():
        rows = [line.split() for line in body]
    else:
        # strict: an open quote is an error, not a cell with the rest of the file
        rows = list(csv.reader(body, delimiter=separator or ",", skipinitialspace=True, strict=True))
    if separator != ",":
        for row in rows[1:]:
            row[:] = [re.sub(r"^([^.,]*),([^.,]*)$", r"\1.\2", cell) for cell in row]
    return rows


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def check_times(name: str, t: np.ndarray) -> None:
    """Reject times that are missing or do not increase.

    Raises:
        SceneError: with the file or trace and the first such row.
    """
    if not np.isfinite(t).all():
        raise SceneError(f"{name}: t: row {int(np.argmin(np.isfinite(t))) + 1} is missing. Use a time in every row")
    step = np.diff(t)
    if len(step) and (step < 0).all():
        raise SceneError(f"{name}: t: decreases from row to row. Reverse the rows")
    if (step <= 0).any():
        row = np.argmax(step <= 0) + 2
        what = "goes back; allowed: increasing times"
        if step[row - 2] == 0:
            what = "is repeated; allowed: increasing times"
        elif row > 10 and t[row - 1] - t[0] < 0.1 * (t[row - 2] - t[0]):
            what = "starts again: two runs in one file. Use one file per run: cut this one before that row"
        raise SceneError(f"{name}: t: {t[row - 1]:g} s in row {row} {what}")


#: Number of exact repetitions from which a value may be a mark of missing samples.
FEWEST_MARKS = 3
#: Distance of a mark from the line through its neighbours, in typical distances of the column.
MARK_DISTANCE = 20.0
#: The same as a fraction of the range of its values: a coarse encoder at rest toggles between neighbours.
MARK_RANGE_SHARE = 0.1


def placeholder(values: np.ndarray) -> float | None:
    """The value that marks missing samples of a column (k,), such as -999 or 0; None if there is no such value.

    It is repeated exactly, and most of its repetitions lie far off the samples before and after them.
    """
    known = np.flatnonzero(np.isfinite(values))
    found, count = np.unique(values[known], return_counts=True)
    for value in found[np.argsort(-count)][: np.sum(count >= FEWEST_MARKS)]:
        mark = known[values[known] == value]
        others = known[values[known] != value]
        if len(others) < FEWEST_MARKS:
            continue
        off = np.abs(value - np.interp(mark, others, values[others]))
        inner = np.abs(values[others[1:-1]] - 0.5 * (values[others[:-2]] + values[others[2:]]))
        far = max(MARK_DISTANCE * np.median(inner), MARK_RANGE_SHARE * np.ptp(values[others]))
        if far > 0 and np.median(off) > far:
            return float(value)
    return None
