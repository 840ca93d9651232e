"""Setup of a run: all numbers that a parameter may change, the free ones among them, and the motion that they give.

    measured(t) = offset + gain * true(rate t - delay of the camera - delay of the channel)

All numbers are in one pytree (`Setup`). The host specifies how each parameter changes it (`tangents`, with one more
axis in front), so that one compiled program serves every choice of free parameters:

    y(e) = channels(run(setup + sum_i e_i tangents_i)),      values y(0), derivatives dy/de at 0 by forward mode
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.modelling.build import build_model
from fitting.channels.data import ChannelData
from fitting.parameters.parameter import Parameter
from fitting.parameters.scene_parameters import scene_parameter
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


def given_start(scene: Scene) -> dict[str, np.ndarray]:
    """Numeric fields that the scene's start gives, by name."""
    given = {}
    for key in START_UNITS:
        value = getattr(scene.start, key)
        if value is not None:
            given[key] = np.asarray(value, float)
    return given


class SetupDirections(NamedTuple):
    """A run's numbers at given values of its parameters, and the direction of each parameter."""

    setup: Setup
    tangents: Setup


def setup_with_directions(
    scene: Scene, data: ChannelData, parameters: Sequence[Parameter], values: np.ndarray
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
            directions.append(jax.jvp(partial(set_parameter, first, p), (1.0,), (1.0,))[1])
            setup = set_parameter(setup, p, v)
    return SetupDirections(setup, jax.tree.map(lambda *parts: jnp.stack(parts), *directions))


def first_setup(scene: Scene, data: ChannelData) -> Setup:
    """The setup with the values of the scene and the data's file."""
    readings = []
    for s in data.sensors:
        mounted = {key: getattr(s.channel, key) for key in s.channel.mounting}
        readings.append(Reading(np.full(len(s.channel.columns), s.offset), s.gain, s.delay, **mounted))
    clocks = tuple(Clock(c.delay, c.rate) for c in data.cameras)
    setup = Setup(build_model(scene), given_start(scene), tuple(readings), clocks)
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
    changed: dict[str, AnyArray] = {where.section: tuple(items)}
    return setup._replace(**changed)
