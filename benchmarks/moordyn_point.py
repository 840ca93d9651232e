"""A point of a system of lines in MoorDyn v2, at equal steps."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import moordyn_process
import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.writing.writer import write_moordyn

#: MoorDyn's time integrators that are compared, by label; the last is what a file gets that names neither scheme nor
#: step: the step then follows from the natural frequencies of the lines.
SCHEMES = {"moordyn rk2": "rk2", "moordyn default": None}

Drive = Callable[[float], np.ndarray]


class Path3(NamedTuple):
    """Positions (k, 3) [m] of a point at times t (k,) [s], including the start, and whether the run completed."""

    t: np.ndarray
    positions: np.ndarray
    ok: bool


def run_point(scene: Scene, point: str, dt: float, duration: float, scheme: str | None, drive: Drive | None) -> Path3:
    """Motion of a point.

    Args:
        scene: a system of lines of equal links each.
        point: its name.
        dt: time between rows [s], and MoorDyn's step where a scheme is named.
        duration: simulated time [s].
        scheme: MoorDyn's `tScheme`; None leaves scheme and step to MoorDyn.
        drive: displacement (3,) [m] over time of the points that `end_motion` moves.
    """
    steps = round(duration / dt)
    motion = scene.effects.get("end_motion")
    moved = [] if motion is None else [scene.point(name).position for name in (motion["point"], *motion["also"])]

    def moved_positions(t: float) -> np.ndarray:
        return np.concatenate([position + drive(t) for position in moved]) if moved else np.zeros(0)

    options: dict[str, Any] = {"disableOutput": 1, "disableOutTime": 1, "dtOut": duration}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / moordyn_process.DECK
        write_moordyn(scene, file, dt=dt, options=options if scheme is None else {**options, "tScheme": scheme})
        if scheme is None:
            lines = file.read_text().splitlines()
            file.write_text("\n".join(line for line in lines if not line.endswith(" dtM")) + "\n")
        np.savez(
            Path(folder) / moordyn_process.DRIVE,
            dt=dt,
            positions=np.stack([moved_positions(k * dt) for k in range(steps + 1)]),
            speed=(moved_positions(1e-6) - moved_positions(0.0)) / 1e-6,
            source=_position_source(scene, point),
        )
        # MoorDyn writes to both standard streams, which belong to all threads of a process: it gets its own process
        call = [sys.executable, moordyn_process.__file__, folder]
        nowhere = subprocess.DEVNULL
        subprocess.run(call, cwd=folder, stdin=nowhere, stdout=nowhere, stderr=nowhere, check=False)
        result = Path(folder) / moordyn_process.RESULT
        found = np.load(result) if result.exists() else np.zeros((0, 3))
    ok = len(found) == steps + 1 and bool(np.all(np.abs(found[-1]) < moordyn_process.FARTHEST))
    return Path3(dt * np.arange(len(found)), found, ok)


def _position_source(scene: Scene, point: str) -> tuple[int, int, int]:
    """What has the position of a point: number of MoorDyn's point; or 0, the number of a line, and 1 for its last node.

    The end of a line is on the base of its buoy.
    """
    buoys = {buoy.point for buoy in scene.buoys}
    if point not in buoys:
        return [p.name for p in scene.points if p.name not in buoys].index(point) + 1, 0, 0
    i, line = next((i, line) for i, line in enumerate(scene.lines) if point in (line.start, line.end))
    return 0, i + 1, int(line.start != point)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress the output of a library on the standard streams."""
    sys.stdout.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    with open(os.devnull, "w") as nothing:
        for stream in (1, 2):
            os.dup2(nothing.fileno(), stream)
        try:
            yield
        finally:
            for stream, saved in zip((1, 2), kept, strict=True):
                os.dup2(saved, stream)
                os.close(saved)
