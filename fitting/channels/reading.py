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
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError, nearest, unreadable
from dropper_jax.base.read import (
    Table,
    Values,
    check_keys,
    read_items,
    read_table,
    read_text,
    refuse,
)
from dropper_jax.load.packaged import parse_toml
from dropper_jax.scene import SceneData
from dropper_jax.scene.fit import to_si
from fitting.channels.channel import Channel, Given
from fitting.channels.data import FEWEST_READINGS, CameraSpec, ChannelData, MeasuredRun, Sensor
from fitting.channels.data_files import Columns, file_with_columns, read_files
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

#: Kinds of channels, and the keys that tables of all kinds share.
CHANNEL_CLASSES: tuple[type[Channel], ...] = (Angle, Position, Pixel, Tension, Depth, Accelerometer, Gyro)
KINDS = {cls.kind: cls for cls in CHANNEL_CLASSES}
COMMON_KEYS = ("name", "kind", "column", "columns", "unit", "camera", "noise", "noise_unit", "offset", "gain", "delay")
POSITION_KEYS = ("line", "link", "node", "end", "at", "point")


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
    common: Table = {"name": read_name(table, path), "columns": columns, "unit": unit, "camera": camera}
    given = Given(table, path, common, scene, tuple(c.matrix for c in cameras))
    channel = cls(**common, **cls.sensor_fields(given))
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
) -> MeasuredRun:
    """A `[[run]]`: the samples of every sensor from its files in `folder`, and its own scene values.

    Raises:
        SceneError: a file that cannot be read, a column that no file or several files have, too few samples, samples
            before the scene starts.
    """
    check_keys(read_table(table, path), ("file", "name", "from", "until", "scene"), path)
    files, default = read_files(require_value(table, path, "file", "a CSV, or a list of them"), path, folder)
    named = [sensor.channel.columns for sensor in sensors]
    low = optional_number(table, path, "from", -np.inf)
    high = optional_number(table, path, "until", np.inf)
    times = []
    values = []
    for i, sensor in enumerate(sensors):
        what = f"{path}: channel {sensor.channel.name!r}"
        columns = named[i]
        # channels with the same columns are those of the files that have them, in order, if there are as many of both
        owner = file_with_columns(files, columns, what, named[:i].count(columns), named.count(columns))
        t, y = owner.read(columns, sensor.channel.unit)
        keep = (t >= low) & (t <= high)
        if (t[keep] < 0).any():
            raise SceneError(f"{path}: t: {t[keep][0]:g} s is before the scene starts; allowed: from 0 s")
        times.append(t[keep])
        values.append(y[keep])
    own = dict(read_table(table.get("scene", {}), f"{path}.scene"))
    own |= _recorded_motions(files, motions, path)
    name = read_name(table, path, default)
    if "/" in name or "\\" in name:  # the fitted scene of a run is written under its name
        raise refuse(f"{path}.name", name, "cannot be used in the name of a file", "a name without a slash")
    return MeasuredRun(name, tuple(times), tuple(values), own)


def _recorded_motions(files: Sequence[Columns], motions: tuple[RecordedMotion, ...], path: str) -> Table:
    """Values of the scene that make fixed points move as measured."""
    if not motions:
        return {}
    times = None
    paths = []
    for point, columns, unit in motions:
        what = f"{path}: motion of {point!r}"
        t, y = file_with_columns(files, columns, what).read(columns, unit)
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


def read_data(source: str | Path | Values, scene: SceneData, folder: Path | None = None) -> ChannelData:
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
    return ChannelData(sensors, cameras, runs)
