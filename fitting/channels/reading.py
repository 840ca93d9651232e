"""The file of a fit to channels: measured quantities, sensors, their positions, data files, runs and cameras.

[[run]]
file = "monday.csv"                  # a column t [s] and those of the channels; or a list of files: columns that
                                     # several of them have are called "FILE.COLUMN", or taken from them in order

[[channel]]
name = "west"
kind = "tension"                     # angle, position, pixel, tension, depth, accelerometer, gyro
column = "load_cell"
unit = "kN"
line = "backbone"
end = "from"                         # or link = 3, at = 12.5 [m], node = 4, point = "anchor", by kind
noise = 1.0                          # first estimate; it is estimated again from the residuals
noise_unit = "%"

[[camera]]
name = "left"
position = [0.0, -5.0, -0.5]
look_at = [0.0, 0.0, -0.5]
focal = 1500.0                       # [px]
centre = [960.0, 540.0]              # [px]

[[motion]]                           # a fixed point that moves as measured
point = "left"
columns = ["left_x", "left_y", "left_z"]
unit = "mm"
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest, unreadable
from dropper_jax.base.read import (
    Plain,
    Table,
    Values,
    check_keys,
    read_items,
    read_list,
    read_table,
    read_text,
    refuse,
)
from dropper_jax.load.packaged import parse_toml
from dropper_jax.scene import SceneData
from dropper_jax.scene.fit import to_si
from fitting.channels.channel import Channel, Given
from fitting.channels.data import CameraSpec, Data, Run, Sensor
from fitting.channels.entries import (
    check_unique_names,
    optional_number,
    read_column_names,
    read_name,
    read_unit,
    require_value,
)
from fitting.channels.inertial import Accelerometer, Gyro
from fitting.channels.sensors import Angle, Depth, Pixel, Position, Tension, read_camera
from fitting.traces.csv_table import check_times, read_csv, refuse_twice

#: Minimum number of samples of a channel.
FEWEST_READINGS = 3
#: Kinds of channels, and the keys that tables of all kinds share.
CHANNEL_CLASSES: tuple[type[Channel], ...] = (Angle, Position, Pixel, Tension, Depth, Accelerometer, Gyro)
KINDS = {cls.kind: cls for cls in CHANNEL_CLASSES}
COMMON_KEYS = ("name", "kind", "column", "columns", "unit", "camera", "noise", "noise_unit", "offset", "gain", "delay")
POSITION_KEYS = ("line", "link", "node", "end", "at", "point")


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
    refuse_twice(table.file, table.names)
    values = dict(zip(table.names, table.numbers(), strict=True))
    t = values.pop("t")
    check_times(table.file, t)
    return Columns(table.file, t, values)


def read_sensor(table: Values, path: str, scene: SceneData, cameras: tuple[CameraSpec, ...]) -> Sensor:
    """A `[[channel]]`: its channel, and the sensor that is assumed.

    Raises:
        SceneError: an unknown kind, key, unit or camera, or a position that the scene does not have.
    """
    read_table(table, path)
    cls = KINDS[read_text(require_value(table, path, "kind", ", ".join(KINDS)), f"{path}.kind", KINDS)]
    check_keys(table, (*COMMON_KEYS, *POSITION_KEYS, *cls.KEYS), path)
    camera = None
    if "camera" in table:
        names = [camera.name for camera in cameras]
        name = table["camera"]
        if name not in names:
            raise SceneError(f"{path}.camera: {name!r} is not a camera; {nearest(str(name), names)}")
        camera = names.index(name)
    columns = read_column_names(table, path)
    unit = read_unit(table, path, "unit", cls.measures)
    if cls.scalar and len(columns) != 1:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 1, because this kind is a single number")
    common = {"name": read_name(table, path), "columns": columns, "unit": unit, "camera": camera}
    channel = cls.make(Given(table, path, common, scene, tuple(c.matrix for c in cameras)))
    noise = optional_number(table, path, "noise", None, above=0.0)
    noise_unit = table.get("noise_unit", unit)
    if noise_unit != "%":
        noise_unit = read_unit({"noise_unit": noise_unit}, path, "noise_unit", cls.measures)
    if noise is not None:
        noise, _ = to_si(noise, noise_unit)
    return Sensor(
        channel,
        noise,
        noise_unit == "%",
        to_si(optional_number(table, path, "offset", 0.0), unit)[0],
        optional_number(table, path, "gain", 1.0),
        optional_number(table, path, "delay", 0.0),
    )


class RecordedMotion(NamedTuple):
    """`[[motion]]`: a fixed point that moves as measured, its columns and their unit."""

    point: str
    columns: tuple[str, ...]
    unit: str


def read_motion(table: Values, path: str, scene: SceneData) -> RecordedMotion:
    """A `[[motion]]`.

    Raises:
        SceneError: a point that is not fixed, or not three columns.
    """
    check_keys(read_table(table, path), ("point", "columns", "unit"), path)
    fixed = scene.fixed_points
    point = table.get("point")
    if point not in fixed:
        raise SceneError(f"{path}.point: {point!r} is not a fixed point; {nearest(str(point), fixed)}")
    columns = read_column_names(table, path)
    if len(columns) != 3:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 3, x, y and z")
    return RecordedMotion(point, columns, read_unit(table, path, "unit", "m"))


def read_run(
    table: Values,
    path: str,
    folder: Path,
    sensors: tuple[Sensor, ...],
    motions: tuple[RecordedMotion, ...],
) -> Run:
    """A `[[run]]`: the samples of every sensor from its files in `folder`, and its own scene values.

    Raises:
        SceneError: a file that cannot be read, a column that no file or several files have, too few samples, samples
            before the scene starts.
    """
    check_keys(read_table(table, path), ("file", "name", "from", "until", "scene"), path)
    files, default = _files(require_value(table, path, "file", "a CSV, or a list of them"), path, folder)
    named = [sensor.channel.columns for sensor in sensors]
    low = optional_number(table, path, "from", -np.inf)
    high = optional_number(table, path, "until", np.inf)
    times = []
    values = []
    for i, sensor in enumerate(sensors):
        what = f"{path}: channel {sensor.channel.name!r}"
        columns = named[i]
        # channels with the same columns are those of the files that have them, in order, if there are as many of both
        owner = _one_file(files, columns, what, named[:i].count(columns), named.count(columns))
        t, y = owner.read(columns, sensor.channel.unit)
        keep = (t >= low) & (t <= high)
        if (np.isfinite(y[keep]).sum(axis=0) < FEWEST_READINGS).any():
            raise SceneError(f"{what} has fewer than {FEWEST_READINGS} samples; allowed: more")
        if t[keep][0] < 0:
            raise SceneError(f"{path}: t: {t[keep][0]:g} s is before the scene starts; allowed: from 0 s")
        times.append(t[keep])
        values.append(y[keep])
    own = dict(read_table(table.get("scene", {}), f"{path}.scene"))
    own |= _recorded_motions(files, motions, path)
    name = read_name(table, path, default)
    if "/" in name or "\\" in name:  # the fitted scene of a run is written under its name
        raise refuse(f"{path}.name", name, "cannot be used in the name of a file", "a name without a slash")
    return Run(name, tuple(times), tuple(values), own)


def _files(given: Plain, path: str, folder: Path) -> tuple[list[Columns], str]:
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
        files, name = _files(item, path, folder)
        found += files
        names.append(name)
    if not found:
        raise SceneError(f"{path}.file: is empty; allowed: a CSV, or a list of them")
    return found, names[0]


def _one_file(files: Sequence[Columns], columns: Sequence[str], what: str, index: int = 0, count: int = 1) -> Columns:
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


def _recorded_motions(files: Sequence[Columns], motions: tuple[RecordedMotion, ...], path: str) -> Table:
    """Values of the scene that make fixed points move as measured."""
    if not motions:
        return {}
    times = None
    paths = []
    for point, columns, unit in motions:
        what = f"{path}: motion of {point!r}"
        t, y = _one_file(files, columns, what).read(columns, unit)
        keep = np.isfinite(y).all(axis=1)
        if keep.sum() < FEWEST_READINGS:
            raise SceneError(f"{what} has fewer than {FEWEST_READINGS} samples; allowed: more")
        if times is not None and not np.array_equal(times, t[keep]):
            raise SceneError(f"{what} has other times; allowed: those of the other points that move")
        times = t[keep]
        paths.append(y[keep])
    return {
        "effects.recorded_motion.points": [motion.point for motion in motions],
        "effects.recorded_motion.time": times.tolist(),
        "effects.recorded_motion.positions": np.concatenate(paths).tolist(),
    }


def read_data(source: str | Path | Values, scene: SceneData, folder: Path | None = None) -> Data:
    """The data of a file, or of the same as plain values.

    Args:
        source: the TOML file or its table; in a table a run's `file` may also be columns by name, including `t`.
        scene: the measured scene.
        folder: location of the runs' files; default: that of the file.

    Raises:
        SceneError: one line with the path, the value and the allowed range.
    """
    if not isinstance(source, Mapping):
        folder = folder or Path(source).parent
        file = Path(source)
        try:
            source = parse_toml(file.read_bytes(), file.name)
        except OSError as error:
            raise unreadable(file.name, error) from None
    check_keys(source, ("run", "channel", "camera", "motion"), "")
    cameras = read_items(read_camera, source.get("camera", []), "camera")
    check_unique_names([c.name for c in cameras], "camera")
    sensors = read_items(read_sensor, source.get("channel", []), "channel", scene, cameras, needed=True)
    check_unique_names([s.channel.name for s in sensors], "channel")
    motions = read_items(read_motion, source.get("motion", []), "motion", scene)
    check_unique_names([motion.point for motion in motions], "motion")
    runs = read_items(read_run, source.get("run", []), "run", folder or Path(), sensors, motions, needed=True)
    check_unique_names([run.name for run in runs], "run")
    return Data(sensors, cameras, runs)
