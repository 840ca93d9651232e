"""`dropper equilibrium SCENE --tide`: equilibria through a cycle of current and level."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import first_failure
from dropper_jax.base.markdown import cells
from dropper_jax.base.read import Table
from dropper_jax.base.records import column
from dropper_jax.cli.outputs import deliver, picture
from dropper_jax.cli.printing import done_object, table

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene


#: Number of equilibria in the cycle unless given: one about every hour of a semidiurnal tide.
CYCLE_TIMES = 13


def run_tide(scene: Scene, args: Namespace) -> int:
    """The cycle as a table, or one object."""
    from dropper_jax.study.tide import draw_tide, tidal_cycle

    found = tidal_cycle(scene, args.times or CYCLE_TIMES)
    failed = first_failure([found["slack_status"], *column(found["rows"], "status")])
    if args.plot and not failed:
        draw_tide(scene.name, found["rows"], picture(args.plot, "tide"))
    failure = (failed, f"{failed}: no equilibrium found for one instant of the cycle") if failed else None
    return deliver(args, done_object(scene=scene.name, **found), _text(found), failure)


def _text(found: Table) -> str:
    rows = list(map(_row, found["rows"]))
    lines = [list(rows[0]), *(cells(row.values(), ".4g") for row in rows)]
    note = "moved: maximum horizontal displacement of a node from the equilibrium without current at the mean level"
    return f"{table(lines)}\n{note}"


def _row(row: Table) -> dict[str, float]:
    """Numbers of an instant by their headings."""
    numbers = {
        "time [h]": row["t_s"] / 3600.0,
        "level [m]": row["level_m"],
        "current [m/s]": row["speed_m_per_s"],
        "moved [m]": row["displacement_m"],
    }
    for name, load in row["held_load_n"].items():
        numbers[f"{name} [N]"] = float(np.linalg.norm(load))
    for name, share in row["anchor_utilisation"].items():
        numbers[f"{name} used [%]"] = 100.0 * share
    return numbers
