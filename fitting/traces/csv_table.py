"""CSV files of measured columns, under a header with `t`: numbers, empty or `nan` where a sample is missing."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError


class CsvTable(NamedTuple):
    """A file's name, its comments, the names of its columns, and its rows, still unread."""

    file: str
    comments: tuple[str, ...]
    names: list[str]
    rows: list[list[str]]

    def numbers(self) -> np.ndarray:
        """The columns (columns, k).

        Raises:
            SceneError: a row of another length, a cell that is no number.
        """
        return _numbers(self.file, self.names, self.rows)


def read_csv(path: Path, columns: str) -> CsvTable:
    """The columns of a CSV file; lines that begin with # are comments.

    Args:
        columns: what the header must have, for errors, such as `t, theta_1..n`.

    Raises:
        SceneError: a file that cannot be read, no samples, no column t.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise SceneError(f"{path.name}: not a text file in UTF-8; allowed: a CSV with columns {columns}") from None
    except OSError as error:
        raise SceneError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    comments = tuple(line.lstrip()[1:].strip() for line in text.splitlines() if line.lstrip().startswith("#"))
    body = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(body) < 2:
        raise SceneError(f"{path.name}: has no samples; allowed: a header {columns} and rows of numbers")
    try:
        rows = list(csv.reader(body))
    except csv.Error as error:
        raise SceneError(f"{path.name}: no CSV: {error}; allowed: columns {columns}") from None
    names = [name.strip() for name in rows[0]]
    if "t" not in names:
        raise SceneError(f"{path.name}: has no column 't'; found: {', '.join(names)[:80]}")
    return CsvTable(path.name, comments, names, rows[1:])


def refuse_twice(file: str, names: list[str]) -> None:
    """Refuse a column that is there twice."""
    if len(set(names)) != len(names):
        raise SceneError(f"{file}: a column is there twice; found: {', '.join(names)[:80]}")


def check_times(name: str, t: np.ndarray) -> None:
    """Refuse times that are missing or do not increase.

    Raises:
        SceneError: with the file or trace and the first such row.
    """
    if not np.isfinite(t).all():
        raise SceneError(f"{name}: t: row {int(np.argmin(np.isfinite(t))) + 1} is missing; allowed: every time")
    step = np.diff(t)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 2
        what = "is repeated" if step[row - 2] == 0 else "goes back"
        raise SceneError(f"{name}: t: {t[row - 1]:g} s in row {row} {what}; allowed: increasing times")


def _numbers(file: str, names: list[str], rows: list[list[str]]) -> np.ndarray:
    table = np.full((len(rows), len(names)), np.nan)
    for i, row in enumerate(rows):
        if len(row) != len(names):
            raise SceneError(f"{file}: row {i + 1} has {len(row)} values; allowed: {len(names)}, one per column")
        for j, cell in enumerate(row):
            if cell.strip().lower() in ("", "nan"):
                continue
            try:
                table[i, j] = float(cell)
            except ValueError:
                raise SceneError(f"{file}: row {i + 1}, {names[j]}: {cell.strip()!r} is not a number") from None
    table[np.isinf(table)] = np.nan
    return table.T
