"""The file of a fit to channels: what was measured, by which sensor and where, in which files; runs and cameras.

[[run]]
file = "monday.csv"                  # a column t [s] and those of the channels; or a list of files

[[channel]]
name = "west"
kind = "tension"                     # angle, position, pixel, tension, depth
column = "load_cell"
unit = "kN"
line = "backbone"
end = "from"                         # or link = 3, at = 12.5 [m], node = 4, point = "anchor", by kind
noise = 1.0                          # as first believed; the residuals tell it anew
noise_unit = "%"

[[camera]]
name = "left"
position = [0.0, -5.0, -0.5]
look_at = [0.0, 0.0, -0.5]
focal = 1500.0                       # [px]
centre = [960.0, 540.0]              # [px]

[[motion]]                           # a held point that moves as measured
point = "left"
columns = ["left_x", "left_y", "left_z"]
unit = "mm"
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import check_keys, read_integer, read_list, read_number, read_table, read_text, refuse
from dropper_jax.scene import SceneData
from dropper_jax.scene.fit import UNITS, in_si
from fitting.channels.angle import Angle
from fitting.channels.channel import Channel, Context
from fitting.channels.columns import Columns, read_columns
from fitting.channels.pixel import Pixel, projection
from fitting.channels.place import Where
from fitting.channels.position import Depth, Position
from fitting.channels.tension import Tension
from fitting.traces.csv_table import check_times

KINDS: dict[str, type[Channel]] = {cls.kind: cls for cls in (Angle, Position, Pixel, Tension, Depth)}
COMMON = ("name", "kind", "column", "columns", "unit", "camera", "noise", "noise_unit", "offset", "gain", "delay")
PLACES = ("line", "link", "node", "end", "at", "point")
#: Fewest samples of a channel.
FEWEST = 3


@dataclass(frozen=True)
class CameraSpec:
    """`[[camera]]`: its projection (3, 4), and its clock: stamp t is taken at `rate t - delay` of the scene's time."""

    name: str
    matrix: tuple[tuple[float, ...], ...]
    delay: float = 0.0
    rate: float = 1.0


@dataclass(frozen=True)
class Sensor:
    """A channel with what is believed of its sensor: `measured(t) = offset + gain * true(t - delay)` [SI].

    Attributes:
        noise: deviation [SI]; a share of the value where `relative`; None: told by the samples.
    """

    channel: Channel
    noise: float | None = None
    relative: bool = False
    offset: float = 0.0
    gain: float = 1.0
    delay: float = 0.0


@dataclass(frozen=True, eq=False)
class Run:
    """One run: times (k,) [s] and values (k, m) [SI] of every channel, NaN where missing, and its own scene values."""

    name: str
    t: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    own: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Data:
    """What was measured."""

    sensors: tuple[Sensor, ...]
    cameras: tuple[CameraSpec, ...]
    runs: tuple[Run, ...]


def read_data(source: str | Path | Mapping[str, Any], scene: SceneData, folder: Path | None = None) -> Data:
    """The data of a file, or of the same as plain values.

    Args:
        source: the TOML file or its table; in a table a run's `file` may also be columns by name, `t` among them.
        scene: what was measured.
        folder: where the runs' files are; default: beside the file.

    Raises:
        SceneError: one line with the path, the value and what is allowed.
    """
    if not isinstance(source, Mapping):
        folder, source = folder or Path(source).parent, _parsed(Path(source))
    check_keys(source, ("run", "channel", "camera", "motion"), "")
    cameras = tuple(_camera(table, f"camera.{i}") for i, table in enumerate(_tables(source, "camera")))
    _once([c.name for c in cameras], "camera")
    sensors = tuple(
        _sensor(table, f"channel.{i}", scene, cameras) for i, table in enumerate(_tables(source, "channel"))
    )
    if not sensors:
        raise SceneError("channel: missing; needed: one or more [[channel]] tables")
    _once([s.channel.name for s in sensors], "channel")
    motions = tuple(_motion(table, f"motion.{i}", scene) for i, table in enumerate(_tables(source, "motion")))
    _once([point for point, _, _ in motions], "motion")
    tables = _tables(source, "run")
    if not tables:
        raise SceneError("run: missing; needed: one or more [[run]] tables")
    runs = tuple(_run(table, f"run.{i}", folder or Path(), sensors, motions, scene) for i, table in enumerate(tables))
    _once([run.name for run in runs], "run")
    return Data(sensors, cameras, runs)


def _parsed(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path.name}: is no TOML: {error}") from None


def _tables(source: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    allowed = f"one or more [[{key}]] tables"
    items = read_list(source.get(key, []), key, None, allowed)
    return [read_table(item, f"{key}.{i}") for i, item in enumerate(items)]


def _once(names: Sequence[str], section: str) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise SceneError(f"{section}.{i}: {name!r} is there twice; allowed: every name once")


def _name(table: Mapping[str, Any], path: str, default: str | None = None) -> str:
    if "name" not in table and default is None:
        raise SceneError(f"{path}.name: missing; needed: a name without a point")
    name = read_text(table.get("name", default), f"{path}.name")
    if not name.strip() or ("name" in table and "." in name):
        raise refuse(f"{path}.name", name, "cannot stand in the path of a parameter", "a name without a point")
    return name.replace(".", "_")


def _number(table: Mapping[str, Any], path: str, key: str, default: float | None, **limits: Any) -> float | None:
    return read_number(table[key], f"{path}.{key}", {"unit": "-", **limits}) if key in table else default


def _vector(table: Mapping[str, Any], path: str, key: str, count: int) -> np.ndarray:
    if key not in table:
        raise SceneError(f"{path}.{key}: missing; needed: {count} numbers")
    items = read_list(table[key], f"{path}.{key}", count, f"{count} numbers")
    return np.array([read_number(x, f"{path}.{key}.{i}", {"unit": "-"}) for i, x in enumerate(items)])


def _camera(table: Mapping[str, Any], path: str) -> CameraSpec:
    check_keys(table, ("name", "position", "look_at", "focal", "centre", "projection", "delay", "rate"), path)
    if "projection" in table:
        rows = read_list(table["projection"], f"{path}.projection", 3, "3 rows of 4 numbers")
        matrix = np.array([_vector({"row": row}, f"{path}.projection.{i}", "row", 4) for i, row in enumerate(rows)])
    else:
        position, look_at = (_vector(table, path, key, 3) for key in ("position", "look_at"))
        ahead = look_at - position
        if np.hypot(ahead[0], ahead[1]) < 1e-9:
            raise SceneError(f"{path}.look_at: straight above or below the camera; allowed: elsewhere, or `projection`")
        focal = _number(table, path, "focal", None, low=0.0, open_low=True)
        if focal is None:
            raise SceneError(f"{path}.focal: missing; needed: focal length [px]")
        matrix = projection(position, look_at, focal, _vector(table, path, "centre", 2))
    return CameraSpec(
        _name(table, path),
        tuple(map(tuple, matrix.tolist())),
        _number(table, path, "delay", 0.0),
        _number(table, path, "rate", 1.0, low=0.0, open_low=True),
    )


def _unit(table: Mapping[str, Any], path: str, key: str, measures: str) -> str:
    fitting = [name for name, (base, _) in UNITS.items() if base == measures]
    if key not in table:
        raise SceneError(f"{path}.{key}: missing; needed: {', '.join(fitting)}")
    unit = read_text(table[key], f"{path}.{key}")
    if unit not in fitting:
        raise SceneError(f"{path}.{key}: {unit!r} does not measure this; allowed: {', '.join(fitting)}")
    return unit


def _columns(table: Mapping[str, Any], path: str) -> tuple[str, ...]:
    if ("column" in table) == ("columns" in table):
        raise SceneError(
            f"{path}: names its columns {'twice' if 'column' in table else 'nowhere'}; allowed: column or columns"
        )
    if "column" in table:
        return (read_text(table["column"], f"{path}.column"),)
    items = read_list(table["columns"], f"{path}.columns", None, "a list of names of columns")
    if not items:
        raise SceneError(f"{path}.columns: is empty; allowed: names of columns")
    return tuple(read_text(name, f"{path}.columns.{i}") for i, name in enumerate(items))


def _sensor(table: Mapping[str, Any], path: str, scene: SceneData, cameras: tuple[CameraSpec, ...]) -> Sensor:
    if "kind" not in table:
        raise SceneError(f"{path}.kind: missing; needed: {', '.join(KINDS)}")
    cls = KINDS[read_text(table["kind"], f"{path}.kind", KINDS)]
    check_keys(table, (*COMMON, *PLACES, *cls.KEYS), path)
    names = [camera.name for camera in cameras]
    camera = table.get("camera")
    if camera is not None and camera not in names:
        raise SceneError(f"{path}.camera: {camera!r} is no camera; {nearest(str(camera), names)}")
    columns, unit = _columns(table, path), _unit(table, path, "unit", cls.measures)
    if cls not in (Position, Pixel) and len(columns) != 1:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 1, this kind is one number")
    common = {
        "name": _name(table, path),
        "columns": columns,
        "unit": unit,
        "camera": None if camera is None else names.index(camera),
    }
    where = Where(
        **{key: read_text(table[key], f"{path}.{key}") for key in ("line", "end", "point") if key in table},
        **{key: read_integer(table[key], f"{path}.{key}") for key in ("link", "node") if key in table},
        **({"at": _number(table, path, "at", None)} if "at" in table else {}),
    )
    channel = cls.make(common, table, where, Context(scene, tuple(c.matrix for c in cameras), path))
    factor = in_si(1.0, unit)[0]
    relative = table.get("noise_unit") == "%"
    size = _number(table, path, "noise", None, low=0.0, open_low=True)
    if "noise_unit" in table and not relative:
        factor_of_noise = in_si(1.0, _unit(table, path, "noise_unit", cls.measures))[0]
    else:
        factor_of_noise = 0.01 if relative else factor
    return Sensor(
        channel,
        None if size is None else size * factor_of_noise,
        relative,
        _number(table, path, "offset", 0.0) * factor,
        _number(table, path, "gain", 1.0),
        _number(table, path, "delay", 0.0),
    )


def _motion(table: Mapping[str, Any], path: str, scene: SceneData) -> tuple[str, tuple[str, ...], str]:
    """A held point that moves as measured, its columns and their unit."""
    check_keys(table, ("point", "columns", "unit"), path)
    held = [point.name for point in scene.points if point.kind == "fixed"]
    if table.get("point") not in held:
        raise SceneError(
            f"{path}.point: {table.get('point')!r} is not a held point; {nearest(str(table.get('point')), held)}"
        )
    columns = _columns(table, path)
    if len(columns) != 3:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 3, x, y and z")
    return table["point"], columns, _unit(table, path, "unit", "m")


def _run(
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
    low, high = _number(table, path, "from", -np.inf), _number(table, path, "until", np.inf)
    times, values = [], []
    for sensor in sensors:
        found = _find(files, sensor.channel.columns, f"{path}: channel {sensor.channel.name!r}")
        factor = in_si(1.0, sensor.channel.unit)[0]
        y = factor * np.stack([found.values[name] for name in sensor.channel.columns], axis=1)
        keep = (found.t >= low) & (found.t <= high)
        if (np.isfinite(y[keep]).sum(axis=0) < FEWEST).any():
            raise SceneError(f"{path}: channel {sensor.channel.name!r} has fewer than {FEWEST} samples; allowed: more")
        if found.t[keep][0] < 0:
            raise SceneError(f"{path}: t: {found.t[keep][0]:g} s is before the scene begins; allowed: from 0 s")
        times.append(found.t[keep])
        values.append(y[keep])
    own = dict(read_table(table.get("scene", {}), f"{path}.scene"))
    own.update(_moved(files, motions, scene, path))
    return Run(_name(table, path, default), tuple(times), tuple(values), own)


def _files(given: Any, path: str, folder: Path) -> tuple[list[Columns], str]:
    """The files of a run and its name by default."""
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
    """The one file that has all of these columns."""
    found = [file for file in files if all(name in file.values for name in columns)]
    if len(found) == 1:
        return found[0]
    if found:
        raise SceneError(f"{what}: {', '.join(columns)} is in {len(found)} files; allowed: in one")
    known = [name for file in files for name in file.values]
    missing = next((name for name in columns if name not in known), columns[0])
    raise SceneError(f"{what}: column {missing!r} is in no file with the others; {nearest(missing, known)}")


def _moved(
    files: Sequence[Columns], motions: tuple[tuple[str, tuple[str, ...], str], ...], scene: SceneData, path: str
) -> dict[str, Any]:
    """Values of the scene by which held points move as measured."""
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
        "effects.recorded_motion.places": np.concatenate([y for _, y in paths], axis=0).tolist(),
    }
