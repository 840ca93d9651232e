"""Recover saved runs from the files of killed runs.

All complete states are recovered. The last chunk is lost, which is reported.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import leftovers, remove
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model, stepper_of
from dropper_jax.run.build_solution import PreparedRun, TimeOrigin, build_solution
from dropper_jax.run.chunks import RunOutcome
from dropper_jax.run.row_store import OnDisk, read_mark
from dropper_jax.run.simulate import Solution
from dropper_jax.run.start_of_run import initial_carry, restore_end, stepper_fields
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.stepping.integrate import empty_trajectory
from dropper_jax.stepping.progress import TensionMeans


def recover(path: Path) -> list[str]:
    """Recover killed runs of the file `path`: to this file, or to one next to it if it exists; the rest is removed.

    Returns:
        a line for each run, with the recovered and the lost part.
    """
    lines = []
    for folder in [item for item in leftovers(path) if item.is_dir()]:
        if not read_mark(folder)[0]:
            remove(folder)
            continue
        try:
            solution = killed_run(folder)
            lost = f"the part after t = {solution.t[-1]:.6g} s is lost"
            solution = replace(solution, warnings=(*solution.warnings, f"killed: {lost}"))
            saved = solution.save(_free_name(path))
        except (SceneError, OSError, ValueError, KeyError, TypeError) as error:
            lines.append(f"{folder}: the files of a killed run cannot be used: {' '.join(str(error).split())}")
            continue
        lines.append(f"{saved}: from a run that was killed; {lost}")
        remove(folder)
    return lines


def killed_run(folder: Path) -> Solution:
    """The run in the scratch folder of a killed process, up to its last complete state, with status `interrupted`.

    Raises:
        SceneError: rows by an earlier version, or of a run that continued another one.
    """
    rows = OnDisk.resume(folder)
    scene = Scene.from_dict(rows.about["scene"])
    settings = rows.about["settings"]
    model = build_model(scene)
    stepper = stepper_of(model, scene.run, **stepper_fields(settings))
    if rows.last:
        first = restore_end(stepper, model, scene.run, rows.first)
        origin = TimeOrigin(*rows.about["since"])
        carry = restore_end(stepper, model, scene.run, rows.last).carry
    elif rows.about.get("went_on"):
        raise SceneError("it continued another run. Use --continue from that run again")
    else:
        first, origin = initial_carry(stepper, model, scene, None)
        carry = first.carry
    # the structure of the rows; its values do not matter
    structure = empty_trajectory(first.carry, 0)
    if scene.run.accuracy is not None:
        structure = structure._replace(within=TensionMeans(first.carry.t, first.carry.t, first.carry.t))
    # rows by an earlier version have no extremes
    if len(rows.about["kinds"]) > len(jax.tree.leaves(structure)):
        structure = structure._replace(extremes=Extremes(0.0, 0.0, 0.0, 0.0))
    rows.with_structure(structure)
    outcome = RunOutcome(rows.read(scene.run.rows), carry, 0.0, interrupted=True)
    solution = build_solution(Solution, PreparedRun(scene, stepper, model, first, origin, rows, settings), outcome)
    return solution if rows.last else replace(solution, last={})


def _free_name(path: Path) -> Path:
    """The path, or an unused name next to it."""
    found = path
    number = 1
    while found.exists():
        ending = "" if number == 1 else f"-{number}"
        found = path.with_name(f"{path.stem}-killed{ending}{path.suffix}")
        number += 1
    return found
