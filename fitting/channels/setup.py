"""Setup of a run: all numbers that a parameter may change, the free ones among them, and the motion that they give.

Paths of parameters in addition to those of scenes: `start.velocities.3.1`, `channel.NAME.offset`, `.gain` and `.delay`,
`.position` and `.turn` of an accelerometer, `camera.NAME.delay` and `.rate`.

    measured(t) = offset + gain * true(rate t - delay of the camera - delay of the channel)

All numbers are in one pytree (`Setup`). The host specifies how each parameter changes it (`tangents`, with one more
axis in front), so that one compiled program serves every choice of free parameters:

    y(e) = channels(run(setup + sum_i e_i tangents_i)),      values y(0), derivatives dy/de at 0 by forward mode
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.build import build_model
from fitting.channels.data import Data
from fitting.parameters.names import full_names
from fitting.parameters.parameter import Parameter, check_once
from fitting.parameters.scene_parameters import find_parameters, scene_parameter
from fitting.parameters.targets import Direction, ModelTarget, SetupTarget

#: A number or array, of JAX in a program.
AnyArray = Any


class Reading(NamedTuple):
    """Sensor of one channel: offset (m,) [SI], gain () [-], delay () [s], and how it is mounted on its link: position
    () [m], turn () [rad]."""

    offset: AnyArray
    gain: AnyArray
    delay: AnyArray
    position: AnyArray = 0.0
    turn: AnyArray = 0.0


class Clock(NamedTuple):
    """Clock of one camera: a stamp t is taken at `rate t - delay` of the scene's time."""

    delay: AnyArray
    rate: AnyArray


class Setup(NamedTuple):
    """All numbers of a run.

    Attributes:
        model: the model with its parameters.
        start: fields of the scene's start, by name.
        readings: one per channel.
        clocks: one per camera.
    """

    model: Model
    start: dict[str, AnyArray]
    readings: tuple[Reading, ...]
    clocks: tuple[Clock, ...]


#: Numeric fields of a start, and their units.
START_UNITS = {
    "polar": "rad",
    "azimuth": "rad",
    "polar_rate": "rad/s",
    "azimuth_rate": "rad/s",
    "positions": "m",
    "velocities": "m/s",
    "release_force": "N",
}
#: Maximum change of a free delay from its start value [s], and of a free rate, relative.
DELAY_RANGE = 0.5
RATE_RANGE = 0.02


def find_free(scene: Scene, data: Data, names: Sequence[str], option: str = "free") -> tuple[Parameter, ...]:
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


def _of_setup(scene: Scene, data: Data, name: str, option: str) -> list[Parameter]:
    """The numbers of the start, a sensor or a camera at a path."""
    section, *rest = name.split(".")
    found = []
    if section == "start" or len(rest) > 1:
        found = [p for p in _numbers(scene, data) if f"{p.name}.".startswith(f"{name}.")]
    if not found:
        raise SceneError(f"{option}: {name!r}{_why_missing(scene, data, section, rest, name)}")
    return found


def _given_start(scene: Scene) -> dict[str, np.ndarray]:
    """Numeric fields that the scene's start gives, by name."""
    given = {}
    for key in START_UNITS:
        value = getattr(scene.start, key)
        if value is not None:
            given[key] = np.asarray(value, float)
    return given


def _numbers(scene: Scene, data: Data) -> list[Parameter]:
    """Every number of the start, the sensors and the cameras."""
    found = []
    for key, given in _given_start(scene).items():
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


def _why_missing(scene: Scene, data: Data, section: str, rest: Sequence[str], name: str) -> str:
    """Why a name of `section.rest` does not exist, and what is allowed."""
    if section == "start":
        given = {f"start.{key}": np.shape(value) for key, value in _given_start(scene).items()}
        shape = given.get(ScenePath(name).stem)
        if shape is None:
            return f" is not given in the scene's start; {nearest(name, given)}"
        return f" has no such entry; allowed: below {', '.join(map(str, shape))}"
    label = rest[0] if len(rest) > 1 else name
    channels = {sensor.channel.name: sensor.channel for sensor in data.sensors}
    names = list(channels)
    if section == "camera":
        names = [camera.name for camera in data.cameras]
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


class SetupDirections(NamedTuple):
    """A run's numbers at given values of its parameters, and the direction of each parameter."""

    setup: Setup
    tangents: Setup


def setup_with_directions(
    scene: Scene, data: Data, parameters: Sequence[Parameter], values: np.ndarray
) -> SetupDirections:
    """The setup of a run at these values (k,), and its directions (k, ...) there.

    Numbers that do not affect the model linearly (EA with a damping ratio, lengths) are set in the scene, which is
    then built again, and their directions are taken there.
    """
    written = {p.name: float(v) for p, v in zip(parameters, values, strict=True) if p.moves_model}
    if written:
        scene = scene.with_values(written)
    first = first_setup(scene, data)
    setup = first
    directions: list[Setup] = []
    for p, v in zip(parameters, values, strict=True):
        if p.moves_model:
            still = jax.tree.map(jnp.zeros_like, first)
            leaves, tree = jax.tree.flatten(still.model)
            for leaf, slope in scene_parameter(scene, first.model, p.name).where.slopes.items():
                leaves[leaf] = jnp.asarray(slope, leaves[leaf].dtype)
            directions.append(still._replace(model=jax.tree.unflatten(tree, leaves)))
        else:
            directions.append(jax.jvp(lambda v, p=p: set_parameter(first, p, v), (1.0,), (1.0,))[1])
            setup = set_parameter(setup, p, v)
    return SetupDirections(setup, jax.tree.map(lambda *parts: jnp.stack(parts), *directions))


def first_setup(scene: Scene, data: Data) -> Setup:
    """The setup with the values of the scene and the data's file."""
    readings = []
    for s in data.sensors:
        mounted = {key: getattr(s.channel, key) for key in s.channel.mounting}
        readings.append(Reading(np.full(len(s.channel.columns), s.offset), s.gain, s.delay, **mounted))
    clocks = tuple(Clock(c.delay, c.rate) for c in data.cameras)
    setup = Setup(build_model(scene), _given_start(scene), tuple(readings), clocks)
    return jax.tree.map(lambda x: jnp.asarray(x, scene.run.dtype), setup)


def set_parameter(setup: Setup, p: Parameter, value: AnyArray) -> Setup:
    """The setup with a parameter's value set; differentiable."""
    where = p.where
    if isinstance(where, ModelTarget | Direction):
        return setup._replace(model=where.set_in(setup.model, value))
    if not isinstance(where, SetupTarget):
        raise TypeError(f"{p.name}: does not belong to a setup")
    if where.section == "start":
        new = setup.start[where.field].at[where.entry].set(value)
        return setup._replace(start={**setup.start, where.field: new})
    items = list(getattr(setup, where.section))  # sensors or cameras
    item = items[where.index]
    new = jnp.asarray(getattr(item, where.field)).at[where.entry].set(value)
    items[where.index] = item._replace(**{where.field: new})
    if where.section == "clocks":
        return setup._replace(clocks=tuple(items))
    return setup._replace(readings=tuple(items))
