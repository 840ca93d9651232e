"""Recover saved runs from the files of killed runs: all complete states; the last chunk is lost, and this is
reported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import leftovers, remove
from dropper_jax.load.scene import Scene
from dropper_jax.run.assembly import build_solution, with_adaptive_steps
from dropper_jax.run.build import build_model, stepper_of
from dropper_jax.run.resolution import with_quality_checks
from dropper_jax.run.row_store import ABOUT, OnDisk, count_rows
from dropper_jax.run.simulate import Solution, initial_carry
from dropper_jax.run.start import initial_state
from dropper_jax.stepping.adaptive import Within
from dropper_jax.stepping.integrate import Trajectory, begin


def recover(path: Path) -> list[str]:
    """Recover killed runs of the file `path`: to this file, or to one next to it if it exists; the rest is removed.

    Returns:
        a line for each run, with the recovered and the lost part.
    """
    lines = []
    for folder in [item for item in leftovers(path) if item.is_dir()]:
        if not count_rows(folder):
            remove(folder)
            continue
        try:
            solution = left_in(folder)
            lost = f"the part after t = {solution.t[-1]:.6g} s is lost"
            reported = replace(solution, warnings=(*solution.warnings, f"killed: {lost}"))
            kept = reported.save(_free_name(path))
        except (SceneError, OSError, ValueError, KeyError, TypeError) as error:
            lines.append(f"{folder}: the files of a killed run cannot be used: {' '.join(str(error).split())}")
            continue
        lines.append(f"{kept}: from a run that was killed; {lost}")
        remove(folder)
    return lines


def left_in(folder: Path) -> Solution:
    """The run of a folder of rows, with status `interrupted`.

    Raises:
        SceneError: rows of a continued run or of an error-controlled run.
    """
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    if about.get("went_on"):
        raise SceneError("it continued another run. Use --continue from that run again")
    scene = Scene.from_dict(about["scene"])
    solution = solution_of_rows(scene, folder, about["settings"])
    in_memory = {key: np.array(value) for key, value in vars(solution).items() if isinstance(value, np.ndarray)}
    return replace(solution, status="interrupted", **in_memory)


def _free_name(path: Path) -> Path:
    """The path, or an unused name next to it."""
    found, number = path, 1
    while found.exists():
        found = path.with_name(f"{path.stem}-killed{'' if number == 1 else f'-{number}'}{path.suffix}")
        number += 1
    return found


def solution_of_rows(scene: Scene, folder: Path, settings: dict[str, Any]) -> Solution:
    """The run in the scratch folder of a killed process, up to its last complete state.

    Raises:
        SceneError: an error-controlled run, which needs more than the states.
    """
    model = build_model(scene)
    renamed = {"tolerance" if key == "residual_tolerance" else key: value for key, value in settings.items()}
    stepper = stepper_of(model, scene.run, **renamed)
    if stepper.integrator.controls_error:
        raise SceneError(f"integrator: {stepper.integrator.name} controls its own error. Use a scheme of equal steps")
    first, since = initial_carry(stepper, model, scene, None)
    s = begin(stepper, model, initial_state(model, scene.start)).state
    beside = None if scene.run.step_tolerance is None else Within(*(0.0,) * len(Within._fields))
    rows = OnDisk.reopen(folder, (Trajectory(*(0.0,) * 8, s.parted, s.own), beside))
    run, within = rows.concatenate(scene.run.saves)
    solution = build_solution(Solution, scene, stepper, model, first, since, run, dict(settings), rows)
    return with_quality_checks(solution if within is None else with_adaptive_steps(solution, within, 0))
