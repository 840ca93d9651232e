"""From measured data and a scene to the problem of a fit: the scene of each run, and its free parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import ScenePath, Values
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model, initial_state
from fitting.channels.data import ChannelData
from fitting.channels.free_numbers import find_free
from fitting.channels.problem import Problem
from fitting.channels.reading import read_data
from fitting.parameters.names import by_full_path, default_free, full_names
from fitting.parameters.parameter import Bounds, Parameter, Priors, StartValues, adjust_parameters, with_zero_damping
from fitting.parameters.rig_priors import JointPrior, rig_priors

#: Sections of paths that do not belong to the scene's model.
DATA_SECTIONS = ("start", "channel", "camera")


def make_problem(
    source: str | Path | Values | ChannelData,
    scene: Scene,
    free: Sequence[str] | None,
    own: Sequence[str],
    start: StartValues,
    bounds: Bounds,
    priors: Priors,
) -> Problem:
    """The problem of these data and this scene.

    Raises:
        SceneError: names, channels, positions or numbers that do not fit together.
    """
    if free is None:
        free = default_free(scene)
    names = [name.strip() for name in free]
    mine = [name.strip() for name in own]
    of_scene = [name for name in (*names, *mine) if ScenePath(name).section not in DATA_SECTIONS]
    if of_scene:
        scene = with_zero_damping(scene, full_names(scene, of_scene))
    data = source if isinstance(source, ChannelData) else read_data(source, scene)
    if mine and len(data.runs) < 2:
        raise SceneError(f"own: {mine[0]!r}: there is only one run. Use it with 2 runs or more")
    scenes = _scenes_of_runs(scene, data)
    _check_spacing(scenes[0], data)
    shared, split = _find_parameters(scenes[0], data, [name for name in names if name not in mine], mine)
    with_priors, known = rig_priors(scenes[0], build_model(scenes[0]), shared)
    given = by_full_path(scenes[0], start, bounds, priors, DATA_SECTIONS)
    every = adjust_parameters([*with_priors, *split], *given, wider=True)
    parameters = list(every[: len(shared)])
    split = every[len(shared) :]
    of_run = []
    for run in data.runs:
        first = len(parameters)
        parameters += [replace(p, name=f"{p.name}@{run.name}") for p in split]
        of_run.append((*range(len(shared)), *range(first, len(parameters))))
    return Problem(
        data=data,
        scenes=scenes,
        parameters=tuple(parameters),
        of_run=tuple(of_run),
        plain=(*shared, *split),
        near=tuple(initial_state(build_model(s), s.start) for s in scenes),
        known=_pad_prior(known, len(parameters)),
    )


def _find_parameters(
    scene: Scene, data: ChannelData, names: Sequence[str], own: Sequence[str]
) -> tuple[tuple[Parameter, ...], tuple[Parameter, ...]]:
    """The free parameters that all runs share, and those that each run has separately.

    Raises:
        SceneError: a name that cannot be free, one in both lists, or none at all.
    """
    shared = find_free(scene, data, names)
    split = find_free(scene, data, own, "own")
    for p in split:
        if p.name in names_of(shared):
            raise SceneError(f"own: {p.name!r} is also shared; allowed: one of the two")
    if not shared and not split:
        raise SceneError("free: nothing is free; allowed: paths of parameters")
    return shared, split


def _scenes_of_runs(scene: Scene, data: ChannelData) -> tuple[Scene, ...]:
    """The scene with the own values of each run.

    Raises:
        SceneError: values that the scene does not have, or that change the step or the scheme.
    """
    scenes = []
    for run in data.runs:
        try:
            scenes.append(scene.with_values(run.own) if run.own else scene)
        except SceneError as error:
            raise SceneError(f"run {run.name!r}: {error}") from None
    if len({(s.run.step, s.run.integrator, s.run.save_every) for s in scenes}) > 1:
        raise SceneError("run.scene: runs with other steps or schemes cannot be fitted together. Use one [run]")
    return tuple(scenes)


def _pad_prior(known: JointPrior, count: int) -> JointPrior:
    """The joint prior of the shared parameters, for all `count` of them, of which the last it does not concern."""
    common = []
    for one in known.common:
        common.append(replace(one, share=np.pad(one.share, (0, count - len(one.share)))))
    massive = known.massive
    if massive is not None:
        massive = np.pad(massive, (0, count - len(massive)))
    return replace(known, common=tuple(common), massive=massive)


def _check_spacing(scene: Scene, data: ChannelData) -> None:
    """Reject saved states that are too far apart for a run, or for the differences of an inertial sensor.

    The samples of such a sensor are assumed to follow the motion: states at their interval give its derivatives to 1 %
    at six samples per period and to 0.02 % at fifteen.
    """
    spacing = scene.run.step * scene.run.save_every
    for run in data.runs:
        last = max(t[-1] for t in run.t)
        if last <= 2 * spacing:
            raise SceneError(f"run {run.name!r}: ends at {last:g} s; allowed: more than 2 saved steps of {spacing:g} s")
    for c, sensor in enumerate(data.sensors):
        interval = min(np.median(np.diff(run.t[c])) for run in data.runs)
        if sensor.channel.margin and spacing > interval * (1 + 1e-6):
            most = max(1, int(interval / scene.run.step))
            raise SceneError(
                f"run.save_every: {spacing:g} s between saved states, but channel {sensor.channel.name!r} has a sample "
                f"every {interval:g} s; allowed: save_every up to {most} with steps of at most {interval:g} s"
            )
