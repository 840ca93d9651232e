"""Runs of a channels file: `[[run]]` with its samples, `[[motion]]` of fixed points that move as measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, check_keys, read_list, read_table, read_text
from dropper_jax.scene import SceneData
from dropper_jax.scene.fit import in_si
from fitting.channels.data import Run, Sensor
from fitting.channels.entries import columns_of, name_of, number_of, unit_of
from fitting.traces.csv_table import check_times, read_csv, refuse_twice

#: Minimum number of samples of a channel.
FEWEST = 3


class Columns(NamedTuple):
    """Times (k,) [s] and columns (k,) by name."""

    file: str
    t: np.ndarray
    values: dict[str, np.ndarray]


def read_columns(path: Path) -> Columns:
    """The columns of a CSV file; lines that begin with # are comments.

    Raises:
        SceneError: a file that cannot be read, no column t, a cell that is not a number, times that do not increase.
    """
    table = read_csv(path, "t and those that the channels name")
    refuse_twice(table.file, table.names)
    values = dict(zip(table.names, table.numbers(), strict=True))
    t = values.pop("t")
    check_times(table.file, t)
    return Columns(table.file, t, values)


def read_motion(table: Mapping[str, Any], path: str, scene: SceneData) -> tuple[str, tuple[str, ...], str]:
    """A fixed point that moves as measured, its columns and their unit."""
    check_keys(table, ("point", "columns", "unit"), path)
    held = [point.name for point in scene.points if point.kind == "fixed"]
    if table.get("point") not in held:
        raise SceneError(
            f"{path}.point: {table.get('point')!r} is not a fixed point; {nearest(str(table.get('point')), held)}"
        )
    columns = columns_of(table, path)
    if len(columns) != 3:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 3, x, y and z")
    return table["point"], columns, unit_of(table, path, "unit", "m")


def read_run(
    table: Mapping[str, Any],
    path: str,
    folder: Path,
    sensors: tuple[Sensor, ...],
    motions: tuple[tuple[str, tuple[str, ...], str], ...],
    scene: SceneData,
) -> Run:
    check_keys(table, ("file", "name", "from", "until", "scene"), path)
    if "file" not in table:
        raise SceneError(f"{path}.file: missing; needed: a CSV, or a list of them")
    files, default = _files(table["file"], path, folder)
    low, high = number_of(table, path, "from", -np.inf), number_of(table, path, "until", np.inf)
    times, values = [], []
    for sensor in sensors:
        found = _find(files, sensor.channel.columns, f"{path}: channel {sensor.channel.name!r}")
        factor = in_si(1.0, sensor.channel.unit)[0]
        y = factor * np.stack([found.values[name] for name in sensor.channel.columns], axis=1)
        keep = (found.t >= low) & (found.t <= high)
        if (np.isfinite(y[keep]).sum(axis=0) < FEWEST).any():
            raise SceneError(f"{path}: channel {sensor.channel.name!r} has fewer than {FEWEST} samples; allowed: more")
        if found.t[keep][0] < 0:
            raise SceneError(f"{path}: t: {found.t[keep][0]:g} s is before the scene starts; allowed: from 0 s")
        times.append(found.t[keep])
        values.append(y[keep])
    own = dict(read_table(table.get("scene", {}), f"{path}.scene"))
    own.update(_recorded_motions(files, motions, scene, path))
    return Run(name_of(table, path, default), tuple(times), tuple(values), own)


def _files(given: Plain, path: str, folder: Path) -> tuple[list[Columns], str]:
    """The files of a run and its default name."""
    if isinstance(given, Mapping):
        t = np.asarray(given.get("t", ()), float)
        if t.ndim != 1 or len(t) < 2:
            raise SceneError(f"{path}.file: has no times t; allowed: at least 2")
        check_times(f"{path}.file", t)
        columns = {name: np.asarray(v, float) for name, v in given.items() if name != "t"}
        for name, column in columns.items():
            if column.shape != t.shape:
                raise SceneError(f"{path}.file: {name} has {column.size} values for {len(t)} times; allowed: as many")
        return [Columns(path, t, columns)], path.replace(".", "_")
    items = [given] if isinstance(given, str) else read_list(given, f"{path}.file", None, "a file or a list of files")
    found = [
        _files(item, path, folder)[0][0]
        if isinstance(item, Mapping)
        else read_columns(folder / read_text(item, f"{path}.file.{i}"))
        for i, item in enumerate(items)
    ]
    if not found:
        raise SceneError(f"{path}.file: is empty; allowed: a CSV, or a list of them")
    return found, Path(items[0]).stem if isinstance(items[0], str) else path.replace(".", "_")


def _find(files: Sequence[Columns], columns: Sequence[str], what: str) -> Columns:
    """The single file that contains all of these columns."""
    found = [file for file in files if all(name in file.values for name in columns)]
    if len(found) == 1:
        return found[0]
    if found:
        raise SceneError(f"{what}: {', '.join(columns)} occurs in {len(found)} files; allowed: in one")
    known = [name for file in files for name in file.values]
    missing = next((name for name in columns if name not in known), columns[0])
    raise SceneError(f"{what}: column {missing!r} is in no file with the others; {nearest(missing, known)}")


def _recorded_motions(
    files: Sequence[Columns], motions: tuple[tuple[str, tuple[str, ...], str], ...], scene: SceneData, path: str
) -> dict[str, Any]:
    """Values of the scene that make fixed points move as measured."""
    if not motions:
        return {}
    times, paths = None, []
    for point, columns, unit in motions:
        found = _find(files, columns, f"{path}: motion of {point!r}")
        y = in_si(1.0, unit)[0] * np.stack([found.values[name] for name in columns], axis=1)
        keep = np.isfinite(y).all(axis=1)
        if keep.sum() < FEWEST:
            raise SceneError(f"{path}: motion of {point!r} has fewer than {FEWEST} samples; allowed: more")
        if times is not None and not np.array_equal(times, found.t[keep]):
            raise SceneError(
                f"{path}: motion of {point!r} has other times; allowed: those of the other points that move"
            )
        times = found.t[keep]
        paths.append((point, y[keep]))
    return {
        "effects.recorded_motion.points": [point for point, _ in paths],
        "effects.recorded_motion.time": times.tolist(),
        "effects.recorded_motion.positions": np.concatenate([y for _, y in paths], axis=0).tolist(),
    }
