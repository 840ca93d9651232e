"""Numbers of the start, the sensors and the cameras that may be free, with their start values and bounds.

Paths in addition to those of scenes: `start.velocities.3.1`, `channel.NAME.offset`, `.gain` and `.delay`, `.position`
and `.turn` of an accelerometer, `camera.NAME.delay` and `.rate`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath
from dropper_jax.base.records import by_name, names_of
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model
from fitting.channels.data import ChannelData
from fitting.channels.setup import START_UNITS, given_start
from fitting.parameters.names import full_names
from fitting.parameters.parameter import Parameter, check_once
from fitting.parameters.scene_parameters import find_parameters
from fitting.parameters.targets import Direction, ModelTarget, SetupTarget

#: Maximum change of a free delay from its start value [s], and of a free rate, relative.
DELAY_RANGE = 0.5
RATE_RANGE = 0.02


def find_free(scene: Scene, data: ChannelData, names: Sequence[str], option: str = "free") -> tuple[Parameter, ...]:
    """The parameters of these names, with start values and bounds.

    Raises:
        SceneError: a name that cannot be free, or two of the same number.
    """
    found: list[Parameter] = []
    model = build_model(scene)
    for name in names:
        if ScenePath(name).section in ("start", "channel", "camera"):
            found += _of_setup(scene, data, name, option)
        else:
            found += find_parameters(scene, model, full_names(scene, [name], option), option)
    for p in found:
        if not isinstance(p.where, SetupTarget | ModelTarget | Direction):
            raise SceneError(f"{option}: {p.name!r} is for traces of angles. Use channel.NAME.offset and the like")
    check_once(found, option)
    return tuple(found)


def _of_setup(scene: Scene, data: ChannelData, name: str, option: str) -> list[Parameter]:
    """The numbers of the start, a sensor or a camera at a path."""
    section, *rest = name.split(".")
    found = []
    if section == "start" or len(rest) > 1:
        found = [p for p in _numbers(scene, data) if f"{p.name}.".startswith(f"{name}.")]
    if not found:
        raise SceneError(f"{option}: {name!r}{_why_missing(scene, data, section, rest, name)}")
    return found


def _numbers(scene: Scene, data: ChannelData) -> list[Parameter]:
    """Every number of the start, the sensors and the cameras."""
    found = []
    for key, given in given_start(scene).items():
        for at, value in np.ndenumerate(given):
            path = ".".join(["start", key, *map(str, at)])
            found.append(Parameter(path, SetupTarget("start", 0, key, at), float(value), unit=START_UNITS[key]))
    for i, sensor in enumerate(data.sensors):
        path = f"channel.{sensor.channel.name}"
        several = len(sensor.channel.columns) > 1
        for j in range(len(sensor.channel.columns)):
            name = f"{path}.offset.{j}" if several else f"{path}.offset"
            where = SetupTarget("readings", i, "offset", (j,))
            found.append(Parameter(name, where, sensor.offset, unit=sensor.channel.measures))
        found.append(Parameter(f"{path}.gain", SetupTarget("readings", i, "gain"), sensor.gain, 0.0))
        found.append(_of_time(f"{path}.delay", SetupTarget("readings", i, "delay"), sensor.delay))
        for key, unit in sensor.channel.mounting.items():
            value = float(getattr(sensor.channel, key))
            found.append(Parameter(f"{path}.{key}", SetupTarget("readings", i, key), value, unit=unit))
    for i, camera in enumerate(data.cameras):
        path = f"camera.{camera.name}"
        ends = camera.rate * (1 - RATE_RANGE), camera.rate * (1 + RATE_RANGE)
        found.append(_of_time(f"{path}.delay", SetupTarget("clocks", i, "delay"), camera.delay))
        found.append(Parameter(f"{path}.rate", SetupTarget("clocks", i, "rate"), camera.rate, *ends, unit="s/s"))
    return found


def _why_missing(scene: Scene, data: ChannelData, section: str, rest: Sequence[str], name: str) -> str:
    """Why a name of `section.rest` does not exist, and what is allowed."""
    if section == "start":
        given = {f"start.{key}": np.shape(value) for key, value in given_start(scene).items()}
        shape = given.get(ScenePath(name).stem)
        if shape is None:
            return f" is not given in the scene's start; {nearest(name, given)}"
        return f" has no such entry; allowed: below {', '.join(map(str, shape))}"
    label = rest[0] if len(rest) > 1 else name
    channels = by_name(sensor.channel for sensor in data.sensors)
    names = names_of(data.cameras) if section == "camera" else list(channels)
    if label not in names:
        return f": {label!r} is not a {section}; {nearest(label, names)}"
    fields = ["delay", "rate"]
    if section == "channel":
        if rest[1] == "offset":
            return f" has no such column; allowed: 0 to {len(channels[label].columns) - 1}"
        fields = ["offset", "gain", "delay", *channels[label].mounting]
    return f" does not exist; allowed: {section}.{label} and {', '.join(fields)}"


def _of_time(name: str, where: SetupTarget, delay: float) -> Parameter:
    """A delay [s], free within `DELAY_RANGE`."""
    return Parameter(name, where, delay, delay - DELAY_RANGE, delay + DELAY_RANGE, unit="s")
