"""A MoorDyn run in a process of its own: `python moordyn_process.py FOLDER`, the folder with deck and drive.

The positions (k, 3) [m] of the point are stored in the folder, those until a failed step if one fails.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

DECK, DRIVE, RESULT = "mooring.txt", "drive.npz", "positions.npy"
#: Positions beyond this distance [m] are not possible in the compared scenes.
FARTHEST = 1e4


def run_deck(folder: Path) -> None:
    """Run the deck and store the positions."""
    import moordyn

    drive = np.load(folder / DRIVE)
    system = moordyn.Create(str(folder / DECK))
    try:
        found = march(moordyn, system, drive["positions"], drive["speed"], float(drive["dt"]), drive["source"])
    finally:
        moordyn.Close(system)
    np.save(folder / RESULT, np.array(found, float).reshape(-1, 3))


def march(
    moordyn: Any, system: Any, driven: np.ndarray, speed: np.ndarray, dt: float, source: np.ndarray
) -> list[list[float]]:
    """Positions of the point at equal steps.

    Args:
        driven: positions of the driven points (steps + 1, 3 m) [m].
        speed: their velocities at the start (3 m,) [m/s].
        dt: step [s].
        source: see `position_of`.
    """
    found: list[list[float]] = []
    with contextlib.suppress(RuntimeError):
        moordyn.Init(system, driven[0].tolist(), speed.tolist())
        found.append(position_of(moordyn, system, source))
        for k, (now, after) in enumerate(zip(driven[:-1], driven[1:], strict=True)):
            if not np.all(np.abs(found[-1]) < FARTHEST):
                break
            moordyn.Step(system, now.tolist(), ((after - now) / dt).tolist(), k * dt, dt)
            found.append(position_of(moordyn, system, source))
    return found


def position_of(moordyn: Any, system: Any, source: np.ndarray) -> list[float]:
    """Position of a point by its number, or of the first or last node of a line."""
    point, line, last = (int(number) for number in source)
    if point:
        return list(moordyn.GetPointPos(moordyn.GetPoint(system, point)))
    found = moordyn.GetLine(system, line)
    return list(moordyn.GetLineNodePos(found, moordyn.GetLineN(found) if last else 0))


if __name__ == "__main__":
    run_deck(Path(sys.argv[1]))
