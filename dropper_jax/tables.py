"""Tables of a run as CSV: angle traces in the form that fitting reads, and tensions.

Numbers are written so that reading them back gives the same ones.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.analysis.angles import angle_rates, link_angles
from dropper_jax.io import atomic_write

if TYPE_CHECKING:
    from dropper_jax.solution import Solution


def write_angles(solution: Solution, path: str | Path, zero: str = "horizontal", rates: bool = True) -> Path:
    """Polar angles and their rates: columns `t [s], theta_1..n [rad], omega_1..n [rad/s]`.

    Args:
        solution: the run.
        path: CSV file.
        zero: "horizontal" (positive downwards) or "down", see `link_angles`.
        rates: whether to write the columns omega.
    """
    theta = link_angles(solution.positions, zero)[0]
    columns = {"theta": theta}
    if rates:
        columns["omega"] = angle_rates(solution.positions, solution.velocities, zero)[0]
    return _write(solution, path, f"zero={zero}, sign=1, unit=rad", solution.t, columns)


def write_tensions(solution: Solution, path: str | Path) -> Path:
    """Tensions: columns `t [s], tension_1..n [N]`; t is the time to which the tension belongs."""
    return _write(solution, path, "unit=N", solution.t_tension, {"tension": solution.tension})


def _write(solution: Solution, path: str | Path, comment: str, t: np.ndarray, columns: dict[str, np.ndarray]) -> Path:
    text = io.StringIO()
    used = solution.settings
    text.write(f"# {comment}\n# {solution.scene.name}: {used.get('integrator')} with steps of {used.get('dt')} s\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["t", *(f"{stem}_{j + 1}" for stem, table in columns.items() for j in range(table.shape[1]))])
    for row in np.concatenate([t[:, None], *columns.values()], axis=1).tolist():
        writer.writerow(["" if x != x else repr(x) for x in row])
    return atomic_write(path, text.getvalue())
