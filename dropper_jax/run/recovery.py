"""What killed runs left, made into saved runs: all states that were whole; the last piece is lost, and that is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import leftovers, remove
from dropper_jax.load.scene import Scene
from dropper_jax.run.rows import ABOUT, whole_rows
from dropper_jax.run.simulate import solution_of_rows
from dropper_jax.run.solution import Solution


def recover(path: Path) -> list[str]:
    """Save what killed runs left of the file `path`: there, or beside it where a run is there; the rest is removed.

    Returns:
        a line for each, with what was kept and what is lost.
    """
    lines = []
    for folder in [item for item in leftovers(path) if item.is_dir()]:
        if not whole_rows(folder):
            remove(folder)
            continue
        try:
            solution = left_in(folder)
            lost = f"the piece after t = {solution.t[-1]:.6g} s is lost"
            told = replace(solution, warnings=(*solution.warnings, f"killed: {lost}"))
            kept = told.save(_free_name(path))
        except (SceneError, OSError, ValueError, KeyError, TypeError) as error:
            lines.append(f"{folder}: what a killed run left cannot be used: {' '.join(str(error).split())}")
            continue
        lines.append(f"{kept}: from a run that was killed; {lost}")
        remove(folder)
    return lines


def left_in(folder: Path) -> Solution:
    """The run of a folder of rows, with status `interrupted`.

    Raises:
        SceneError: rows of a run that went on from another one, or whose steps were held by their error.
    """
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    if about.get("went_on"):
        raise SceneError("it went on from another run; allowed: --continue from that one again")
    scene = Scene.from_dict(about["scene"])
    solution = solution_of_rows(scene, folder, about["settings"])
    in_memory = {key: np.array(value) for key, value in vars(solution).items() if isinstance(value, np.ndarray)}
    return replace(solution, status="interrupted", **in_memory)


def _free_name(path: Path) -> Path:
    """The path, or a name beside it that is free."""
    found, number = path, 1
    while found.exists():
        found = path.with_name(f"{path.stem}-killed{'' if number == 1 else f'-{number}'}{path.suffix}")
        number += 1
    return found
