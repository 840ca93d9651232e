"""Files of measured columns: CSV with a column `t` [s] and named columns; a missing sample is empty."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fitting.traces.csv_table import check_times, read_csv, refuse_twice


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
    table = read_csv(path, "t and those that the channels name")
    refuse_twice(table.file, table.names)
    values = dict(zip(table.names, table.numbers(), strict=True))
    t = values.pop("t")
    check_times(table.file, t)
    return Columns(table.file, t, values)
