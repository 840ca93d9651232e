"""Sensors and cameras of a channels file: `[[channel]]`, `[[camera]]`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import check_keys, read_integer, read_list, read_text
from dropper_jax.scene import SceneData
from dropper_jax.scene.fit import in_si
from fitting.channels.angle import Angle
from fitting.channels.channel import Channel, Context
from fitting.channels.data import CameraSpec, Sensor
from fitting.channels.entries import columns_of, name_of, number_of, unit_of, vector_of
from fitting.channels.pixel import Pixel, projection
from fitting.channels.place import Where
from fitting.channels.position import Depth, Position
from fitting.channels.tension import Tension

KINDS: dict[str, type[Channel]] = {cls.kind: cls for cls in (Angle, Position, Pixel, Tension, Depth)}
COMMON = ("name", "kind", "column", "columns", "unit", "camera", "noise", "noise_unit", "offset", "gain", "delay")
LOCATIONS = ("line", "link", "node", "end", "at", "point")


def read_camera(table: Mapping[str, Any], path: str) -> CameraSpec:
    check_keys(table, ("name", "position", "look_at", "focal", "centre", "projection", "delay", "rate"), path)
    if "projection" in table:
        rows = read_list(table["projection"], f"{path}.projection", 3, "3 rows of 4 numbers")
        matrix = np.array([vector_of({"row": row}, f"{path}.projection.{i}", "row", 4) for i, row in enumerate(rows)])
    else:
        position, look_at = (vector_of(table, path, key, 3) for key in ("position", "look_at"))
        ahead = look_at - position
        if np.hypot(ahead[0], ahead[1]) < 1e-9:
            raise SceneError(f"{path}.look_at: directly above or below the camera. Use another point, or `projection`")
        focal = number_of(table, path, "focal", None, low=0.0, open_low=True)
        if focal is None:
            raise SceneError(f"{path}.focal: missing; needed: focal length [px]")
        matrix = projection(position, look_at, focal, vector_of(table, path, "centre", 2))
    return CameraSpec(
        name_of(table, path),
        tuple(map(tuple, matrix.tolist())),
        number_of(table, path, "delay", 0.0),
        number_of(table, path, "rate", 1.0, low=0.0, open_low=True),
    )


def read_sensor(table: Mapping[str, Any], path: str, scene: SceneData, cameras: tuple[CameraSpec, ...]) -> Sensor:
    if "kind" not in table:
        raise SceneError(f"{path}.kind: missing; needed: {', '.join(KINDS)}")
    cls = KINDS[read_text(table["kind"], f"{path}.kind", KINDS)]
    check_keys(table, (*COMMON, *LOCATIONS, *cls.KEYS), path)
    names = [camera.name for camera in cameras]
    camera = table.get("camera")
    if camera is not None and camera not in names:
        raise SceneError(f"{path}.camera: {camera!r} is not a camera; {nearest(str(camera), names)}")
    columns, unit = columns_of(table, path), unit_of(table, path, "unit", cls.measures)
    if cls not in (Position, Pixel) and len(columns) != 1:
        raise SceneError(f"{path}.columns: {len(columns)} columns; allowed: 1, because this kind is a single number")
    common = {
        "name": name_of(table, path),
        "columns": columns,
        "unit": unit,
        "camera": None if camera is None else names.index(camera),
    }
    where = Where(
        **{key: read_text(table[key], f"{path}.{key}") for key in ("line", "end", "point") if key in table},
        **{key: read_integer(table[key], f"{path}.{key}") for key in ("link", "node") if key in table},
        **({"at": number_of(table, path, "at", None)} if "at" in table else {}),
    )
    channel = cls.make(common, table, where, Context(scene, tuple(c.matrix for c in cameras), path))
    factor = in_si(1.0, unit)[0]
    relative = table.get("noise_unit") == "%"
    size = number_of(table, path, "noise", None, low=0.0, open_low=True)
    if "noise_unit" in table and not relative:
        factor_of_noise = in_si(1.0, unit_of(table, path, "noise_unit", cls.measures))[0]
    else:
        factor_of_noise = 0.01 if relative else factor
    return Sensor(
        channel,
        None if size is None else size * factor_of_noise,
        relative,
        number_of(table, path, "offset", 0.0) * factor,
        number_of(table, path, "gain", 1.0),
        number_of(table, path, "delay", 0.0),
    )
