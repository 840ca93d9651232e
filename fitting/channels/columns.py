"""Files of measured columns: CSV with a column `t` [s] and named columns; a missing sample is empty."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError


class Columns(NamedTuple):
    """Times (k,) [s] and columns (k,) by name."""

    file: str
    t: np.ndarray
    values: dict[str, np.ndarray]


def read_columns(path: Path) -> Columns:
    """The columns of a CSV file; lines that begin with # are comments.

    Raises:
        SceneError: a file that cannot be read, no column t, a cell that is no number, times that do not increase.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise SceneError(f"{path.name}: not a text file in UTF-8; allowed: a CSV with a column t") from None
    except OSError as error:
        raise SceneError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    rows = list(csv.reader(row for row in text.splitlines() if row.strip() and not row.lstrip().startswith("#")))
    if len(rows) < 2:
        raise SceneError(f"{path.name}: has no samples; allowed: a header with t and rows of numbers")
    names = [name.strip() for name in rows[0]]
    if "t" not in names:
        raise SceneError(f"{path.name}: has no column 't'; found: {', '.join(names)[:80]}")
    if len(set(names)) != len(names):
        raise SceneError(f"{path.name}: a column is there twice; found: {', '.join(names)[:80]}")
    table = _numbers(path.name, names, rows[1:])
    t = table[:, names.index("t")]
    check_times(path.name, t)
    return Columns(path.name, t, {name: table[:, i] for i, name in enumerate(names) if name != "t"})


def check_times(file: str, t: np.ndarray) -> None:
    """Refuse times that are missing or do not increase.

    Raises:
        SceneError: with the file and the first such row.
    """
    if not np.isfinite(t).all():
        raise SceneError(f"{file}: t: row {int(np.argmin(np.isfinite(t))) + 1} is missing; allowed: every time")
    step = np.diff(t)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 2
        what = "is repeated" if step[row - 2] == 0 else "goes back"
        raise SceneError(f"{file}: t: {t[row - 1]:g} s in row {row} {what}; allowed: increasing times")


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
    return table
