"""Files of measured columns, and the one that has the columns of a sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, read_list, read_text
from dropper_jax.scene.fit import to_si
from fitting.traces.csv_table import check_times, read_csv


class Columns(NamedTuple):
    """Times (k,) [s] and columns (k,) by name."""

    file: str
    t: np.ndarray
    values: dict[str, np.ndarray]

    def find_name(self, column: str) -> str | None:
        """The name here of a column `COLUMN` or `FILE.COLUMN`; None if it is not in this file."""
        for name in (column, column.removeprefix(f"{Path(self.file).stem}.")):
            if name in self.values:
                return name
        return None

    def read(self, columns: Sequence[str], unit: str) -> tuple[np.ndarray, np.ndarray]:
        """Times (k,) [s] and values (k, m) [SI] of columns that are in this file."""
        found = [self.values[self.find_name(column) or column] for column in columns]
        return self.t, to_si(1.0, unit)[0] * np.stack(found, axis=1)


def read_columns(path: Path) -> Columns:
    """The columns of a CSV file; lines that begin with # are comments.

    Raises:
        SceneError: a file that cannot be read, no column t, a cell that is not a number, times that do not increase.
    """
    table = read_csv(path, "t and those that the channels name")
    values = table.columns()
    t = values.pop("t")
    check_times(table.file, t)
    return Columns(table.file, t, values)


def read_files(given: Plain, path: str, folder: Path) -> tuple[list[Columns], str]:
    """The files of a run and its default name."""
    if isinstance(given, Mapping):
        columns = {}
        for name, values in given.items():
            try:
                columns[name] = np.asarray(values, float)
            except (TypeError, ValueError):
                raise SceneError(f"{path}.file: {name} is not a list of numbers; allowed: numbers, or nan") from None
        t = columns.pop("t", np.zeros(0))
        if t.ndim != 1 or len(t) < 2:
            raise SceneError(f"{path}.file: has no times t; allowed: at least 2")
        check_times(f"{path}.file", t)
        for name, column in columns.items():
            if column.shape != t.shape:
                raise SceneError(f"{path}.file: {name} has {column.size} values for {len(t)} times; allowed: as many")
        return [Columns(path, t, columns)], path.replace(".", "_")
    if isinstance(given, str):
        return [read_columns(folder / given)], Path(given).stem
    found = []
    names = []
    for i, item in enumerate(read_list(given, f"{path}.file", None, "a file or a list of files")):
        if not isinstance(item, Mapping):
            item = read_text(item, f"{path}.file.{i}")
        files, name = read_files(item, path, folder)
        found += files
        names.append(name)
    if not found:
        raise SceneError(f"{path}.file: is empty; allowed: a CSV, or a list of them")
    return found, names[0]


def file_with_columns(
    files: Sequence[Columns], columns: Sequence[str], what: str, index: int = 0, count: int = 1
) -> Columns:
    """The file that contains all of these columns: the only one, or number `index` of as many as `count`."""
    found = [file for file in files if all(map(file.find_name, columns))]
    if len(found) == 1 or (found and len(found) == count):
        return found[index % len(found)]
    if found:
        names = ", ".join(f'"{Path(found[0].file).stem}.{column}"' for column in columns)
        raise SceneError(
            f"{what}: {', '.join(columns)} occurs in {len(found)} files; allowed: in one, or one channel for each of "
            f"the files, in their order. Name the file too: [{names}]"
        )
    known = list(chain.from_iterable(file.values for file in files))
    missing = columns[0]  # unless a column is in no file at all, it is not together with the others
    for column in reversed(columns):
        if not any(file.find_name(column) for file in files):
            missing = column
    raise SceneError(f"{what}: column {missing!r} is in no file with the others; {nearest(missing, known)}")
