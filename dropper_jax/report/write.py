"""The report on disk: report.md, report.json and pictures."""

from __future__ import annotations

import json
from pathlib import Path

from dropper_jax.base.files import atomic_write, prepare_folder
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import record
from dropper_jax.evaluation.settings import DEFAULTS, Settings
from dropper_jax.report.pictures import draw_extremes, draw_run
from dropper_jax.report.text import report_markdown
from dropper_jax.run.simulate import Solution

#: Name of the file that is written last.
REPORT = "report.md"


def write_report(
    found: Table, solutions: dict[str, Solution], folder: str | Path, settings: Settings = DEFAULTS
) -> Path:
    """Write report.md, report.json and the pictures, those of several runs to `run-1`, `run-2`, ...

    Args:
        found: the result of `report_runs` for the solutions.

    Returns:
        path of report.md.
    """
    folder = prepare_folder(folder, REPORT)
    pictures = []
    for number, (solution, values) in enumerate(zip(solutions.values(), found["runs"], strict=True), start=1):
        target = folder
        if len(solutions) != 1:
            target = folder / f"run-{number}"
        target.mkdir(exist_ok=True)
        files = draw_run(record(solution, settings.skip), values, target)
        pictures.append({name: file.relative_to(folder).as_posix() for name, file in files.items()})
    if any(isinstance(one, dict) and "gumbel_mode" in one for one in found["extremes"].values()):
        pictures[-1]["extremes"] = draw_extremes(found["extremes"], folder).name
    atomic_write(folder / "report.json", json.dumps(jsonable(found), allow_nan=False, indent=1) + "\n")
    return atomic_write(folder / REPORT, report_markdown(found, pictures))
