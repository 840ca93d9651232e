"""The problem of a fit to channels: free parameters of each run, priors and bounds, from data and a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.run.build import build_model
from fitting.channels.data import Data
from fitting.channels.free import find_free
from fitting.channels.problem import Problem, first_near
from fitting.channels.reading import read_data
from fitting.parameters.naming import default_free, full_names
from fitting.parameters.parameter import Bounds, Priors, StartValues, adjust_parameters, with_effects
from fitting.parameters.priors import rig_priors

#: Sections of paths that do not belong to the scene's model.
OF_DATA = ("start", "channel", "camera")


def pose(
    source: str | Path | Mapping[str, Any] | Data,
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
    names = [name.strip() for name in (default_free(scene) if free is None else free)]
    mine = [name.strip() for name in own]
    known = [n for n in [*names, *mine] if n.split(".")[0] not in OF_DATA]
    scene = with_effects(scene, full_names(scene, known)) if known else scene
    data = source if isinstance(source, Data) else read_data(source, scene)
    if mine and len(data.runs) < 2:
        raise SceneError(f"own: {mine[0]!r}: there is only one run. Use it with 2 runs or more")
    scenes = []
    for run in data.runs:
        try:
            scenes.append(scene.with_values(run.own) if run.own else scene)
        except SceneError as error:
            raise SceneError(f"run {run.name!r}: {error}") from None
    if len({(s.run.dt, s.run.integrator, s.run.save_every) for s in scenes}) > 1:
        raise SceneError("run.scene: runs with other steps or schemes cannot be fitted together. Use one [run]")
    _check_program(scenes, data)
    shared = find_free(scenes[0], data, [n for n in names if n not in mine])
    split = find_free(scenes[0], data, mine, "own")
    for p in split:
        if p.name in [q.name for q in shared]:
            raise SceneError(f"own: {p.name!r} is also shared; allowed: one of the two")
    if not shared and not split:
        raise SceneError("free: nothing is free; allowed: paths of parameters")
    parameters, known_together = rig_priors(scenes[0], build_model(scenes[0]), shared)
    given = (("start", start), ("bounds", bounds), ("prior", priors))
    by_path = [{_path(scenes[0], name, which): v for name, v in one.items()} for which, one in given]
    every = adjust_parameters([*parameters, *split], *by_path, wider=True)
    parameters, split = list(every[: len(shared)]), every[len(shared) :]
    plain, of_run = [], []
    for run in data.runs:
        first = len(parameters)
        parameters += [replace(p, name=f"{p.name}@{run.name}") for p in split]
        plain.append((*shared, *split))
        of_run.append((*range(len(shared)), *range(first, first + len(split))))
    if split:  # joint priors apply only to shared parameters
        wide = lambda a: np.concatenate([a, np.zeros(len(parameters) - len(a))])  # noqa: E731
        together = tuple(replace(c, share=wide(c.share)) for c in known_together.common)
        massive = None if known_together.massive is None else wide(known_together.massive)
        known_together = replace(known_together, common=together, massive=massive)
    near = tuple(first_near(s) for s in scenes)
    return Problem(
        data=data,
        scenes=tuple(scenes),
        parameters=tuple(parameters),
        of_run=tuple(of_run),
        plain=tuple(plain),
        near=near,
        known=known_together,
    )


def _path(scene: Scene, name: str, option: str) -> str:
    """The full path of a name that may be short."""
    return name if name.split(".")[0] in OF_DATA else full_names(scene, [name], option)[0]


def _check_program(scenes: Sequence[Scene], data: Data) -> None:
    """Reject runs that end before the first samples."""
    spacing = scenes[0].run.dt * scenes[0].run.save_every
    for run in data.runs:
        last = max(float(t[-1]) for t in run.t)
        if last <= 2 * spacing:
            raise SceneError(f"run {run.name!r}: ends at {last:g} s; allowed: more than 2 saved steps of {spacing:g} s")
