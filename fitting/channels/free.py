"""Free parameters of a fit to channels: numbers of the scene or its model, of the start, of sensors and of cameras.

Paths in addition to those of scenes: `start.velocities.3.1`, `channel.NAME.offset`, `.gain` and `.delay`,
`camera.NAME.delay` and `.rate`. `measured(t) = offset + gain * true(rate t - delay of the camera - delay of the
channel)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import ScenePath
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build_model
from fitting.channels.channel import Data
from fitting.channels.motion import Clock, Reading, Setup
from fitting.parameters.of_scene import find_parameters, full_names, scene_parameter
from fitting.parameters.parameter import Parameter, check_once

#: Numeric fields of a start, and their units.
STARTS = {
    "polar": "rad",
    "azimuth": "rad",
    "polar_rate": "rad/s",
    "azimuth_rate": "rad/s",
    "positions": "m",
    "velocities": "m/s",
    "release_force": "N",
}
#: Maximum change of a free delay from its start value [s], and of a free rate, relative.
DELAY_RANGE, RATE_RANGE = 0.5, 0.02


@dataclass(frozen=True)
class SetupPlace:
    """A number of the start, a sensor or a camera: section, number or key in it, field, entry of the field."""

    section: str
    index: int | str
    field: str
    entry: tuple[int, ...] = ()


def find_free(scene: Scene, data: Data, names: Sequence[str], option: str = "free") -> tuple[Parameter, ...]:
    """The parameters of these names, with start values and bounds.

    Raises:
        SceneError: a name that cannot be free, or a duplicate one.
    """
    found: list[Parameter] = []
    model = build_model(scene)
    for name in names:
        section = ScenePath(name).section.strip()
        if section == "start":
            found += _of_start(scene, name, option)
        elif section == "channel":
            found += _of_channel(data, name, option)
        elif section == "camera":
            found.append(_of_camera(data, name, option))
        else:
            found += find_parameters(scene, model, full_names(scene, [name], option), option)
    for p in found:
        if not (isinstance(p.where, SetupPlace) or p.in_model or p.moves_model):
            raise SceneError(f"{option}: {p.name!r} is for traces of angles. Use channel.NAME.offset and the like")
    check_once([p.name for p in found], option)
    return tuple(found)


def _of_start(scene: Scene, name: str, option: str) -> list[Parameter]:
    given = {f"start.{key}": key for key in STARTS if getattr(scene.start, key) is not None}
    found = ScenePath(name).entry_of(given)
    if found is None:
        raise SceneError(f"{option}: {name!r} is not given in the scene's start; {nearest(name, given)}")
    key, index = given[found[0]], found[1]
    array = np.asarray(getattr(scene.start, key), float)
    if len(index) > array.ndim or any(i >= size for i, size in zip(index, array.shape, strict=False)):
        raise SceneError(f"{option}: {name!r} has no such entry; allowed: below {', '.join(map(str, array.shape))}")
    return [
        Parameter(
            ".".join(["start", key, *map(str, (*index, *more))]),
            SetupPlace("start", key, key, (*index, *more)),
            float(array[(*index, *more)]),
            unit=STARTS[key],
        )
        for more in np.ndindex(array.shape[len(index) :])
    ]


def _find(
    name: str, kind: str, names: Sequence[str], fields: Sequence[str], option: str
) -> tuple[int, str, tuple[int, ...]]:
    """Number of the channel or camera, field, and entries of a name such as `channel.tension.offset.0`."""
    known = {f"{kind}.{label}.{field}": (i, field) for i, label in enumerate(names) for field in fields}
    found = ScenePath(name).entry_of(known)
    label = name.split(".")[1] if name.count(".") > 1 else name
    if found is None and label not in names:
        raise SceneError(f"{option}: {name!r}: {label!r} is not a {kind}; {nearest(label, names)}")
    if found is None or (found[1] and not found[0].endswith(".offset")):
        raise SceneError(f"{option}: {name!r} does not exist; allowed: {kind}.{label} and {', '.join(fields)}")
    return *known[found[0]], found[1]


def _of_channel(data: Data, name: str, option: str) -> list[Parameter]:
    names = [s.channel.name for s in data.sensors]
    index, field, entries = _find(name, "channel", names, ("offset", "gain", "delay"), option)
    sensor = data.sensors[index]
    if field == "gain":
        return [Parameter(name, SetupPlace("readings", index, field), sensor.gain, 0.0)]
    if field == "delay":
        return [_of_time(name, SetupPlace("readings", index, field), sensor.delay)]
    columns = len(sensor.channel.columns)
    if len(entries) > 1 or any(i >= columns for i in entries):
        raise SceneError(f"{option}: {name!r} has no such column; allowed: 0 to {columns - 1}")
    stem, unit = ScenePath(name).stem, sensor.channel.measures
    return [
        Parameter(
            stem if columns == 1 else f"{stem}.{i}",
            SetupPlace("readings", index, field, (i,)),
            sensor.offset,
            unit=unit,
        )
        for i in entries or range(columns)
    ]


def _of_camera(data: Data, name: str, option: str) -> Parameter:
    index, field, _ = _find(name, "camera", [c.name for c in data.cameras], ("delay", "rate"), option)
    camera = data.cameras[index]
    if field == "delay":
        return _of_time(name, SetupPlace("clocks", index, field), camera.delay)
    ends = camera.rate * (1 - RATE_RANGE), camera.rate * (1 + RATE_RANGE)
    return Parameter(name, SetupPlace("clocks", index, field), camera.rate, *ends, unit="s/s")


def _of_time(name: str, where: SetupPlace, delay: float) -> Parameter:
    return Parameter(name, where, delay, delay - DELAY_RANGE, delay + DELAY_RANGE, unit="s")


class Placed(NamedTuple):
    """A run's numbers at given values of its parameters, and the direction of each parameter."""

    setup: Setup
    tangents: Setup


def setup_with_directions(scene: Scene, data: Data, parameters: Sequence[Parameter], values: np.ndarray) -> Placed:
    """The setup of a run at these values (k,), and its directions (k, ...) there.

    Numbers that do not affect the model linearly (EA with a damping ratio, lengths) are set in the scene, which is
    then built again, and their directions are taken there.
    """
    written = {p.name: float(v) for p, v in zip(parameters, values, strict=True) if p.moves_model}
    scene = scene.with_values(written) if written else scene
    setup = first_setup(scene, data)
    directions: list[Setup] = []
    for p in parameters:
        if p.moves_model:
            still = jax.tree.map(jnp.zeros_like, setup)
            leaves, tree = jax.tree.flatten(still.model)
            for leaf, slope in scene_parameter(scene, setup.model, p.name).where.slopes.items():
                leaves[leaf] = jnp.asarray(slope, leaves[leaf].dtype)
            directions.append(still._replace(model=jax.tree.unflatten(tree, leaves)))
        else:
            directions.append(jax.jvp(lambda v, p=p: set_parameter(setup, p, v), (1.0,), (1.0,))[1])
    for p, v in zip(parameters, values, strict=True):
        if not p.moves_model:
            setup = set_parameter(setup, p, v)
    return Placed(setup, jax.tree.map(lambda *parts: jnp.stack(parts), *directions))


def first_setup(scene: Scene, data: Data) -> Setup:
    """The setup with the values of the scene and the data's file."""
    dtype = jnp.dtype(scene.run.dtype)
    array = lambda x: jnp.asarray(x, dtype)  # noqa: E731
    start = {key: array(getattr(scene.start, key)) for key in STARTS if getattr(scene.start, key) is not None}
    return Setup(
        model=jax.tree.map(array, build_model(scene)),
        start=start,
        readings=tuple(
            Reading(array(np.full(len(s.channel.columns), s.offset)), array(s.gain), array(s.delay))
            for s in data.sensors
        ),
        clocks=tuple(Clock(array(c.delay), array(c.rate)) for c in data.cameras),
    )


def set_parameter(setup: Setup, p: Parameter, value: Any) -> Setup:
    """The setup with a parameter's value set; differentiable."""
    where = p.where
    if not isinstance(where, SetupPlace):
        return setup._replace(model=where.set_in(setup.model, value))
    if where.section == "start":
        start = dict(setup.start)
        start[where.index] = start[where.index].at[where.entry].set(value)
        return setup._replace(start=start)
    items = list(getattr(setup, where.section))
    new = jnp.asarray(getattr(items[where.index], where.field)).at[where.entry].set(value)
    items[where.index] = items[where.index]._replace(**{where.field: new})
    return setup._replace(**{where.section: tuple(items)})
