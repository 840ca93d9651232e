"""The file of a fit to channels: measured quantities, sensors, their positions, data files, runs and cameras.

[[run]]
file = "monday.csv"                  # a column t [s] and those of the channels; or a list of files

[[channel]]
name = "west"
kind = "tension"                     # angle, position, pixel, tension, depth
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

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import check_keys
from dropper_jax.base.toml_text import parsed_toml
from dropper_jax.scene import SceneData
from fitting.channels.data import Data
from fitting.channels.entries import check_once, tables_of
from fitting.channels.runs import read_motion, read_run
from fitting.channels.sensors import read_camera, read_sensor


def read_data(source: str | Path | Mapping[str, Any], scene: SceneData, folder: Path | None = None) -> Data:
    """The data of a file, or of the same as plain values.

    Args:
        source: the TOML file or its table; in a table a run's `file` may also be columns by name, including `t`.
        scene: the measured scene.
        folder: location of the runs' files; default: that of the file.

    Raises:
        SceneError: one line with the path, the value and the allowed range.
    """
    if not isinstance(source, Mapping):
        folder, source = folder or Path(source).parent, parse_file(Path(source))
    check_keys(source, ("run", "channel", "camera", "motion"), "")
    cameras = tuple(read_camera(table, f"camera.{i}") for i, table in enumerate(tables_of(source, "camera")))
    check_once([c.name for c in cameras], "camera")
    sensors = tuple(
        read_sensor(table, f"channel.{i}", scene, cameras) for i, table in enumerate(tables_of(source, "channel"))
    )
    if not sensors:
        raise SceneError("channel: missing; needed: one or more [[channel]] tables")
    check_once([s.channel.name for s in sensors], "channel")
    motions = tuple(read_motion(table, f"motion.{i}", scene) for i, table in enumerate(tables_of(source, "motion")))
    check_once([point for point, _, _ in motions], "motion")
    tables = tables_of(source, "run")
    if not tables:
        raise SceneError("run: missing; needed: one or more [[run]] tables")
    runs = tuple(
        read_run(table, f"run.{i}", folder or Path(), sensors, motions, scene) for i, table in enumerate(tables)
    )
    check_once([run.name for run in runs], "run")
    return Data(sensors, cameras, runs)


def parse_file(path: Path) -> dict[str, Any]:
    try:
        return parsed_toml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path.name}: is not valid TOML: {error}") from None
