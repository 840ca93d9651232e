"""A point of a system of lines in MoorDyn v2, at equal steps."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dropper_jax.backend.compile_cache import discard_output
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.writing.writer import write_moordyn

#: MoorDyn's time integrators that are compared, by label; the last is what a file gets that names neither scheme nor
#: step: the step then follows from the natural frequencies of the lines.
SCHEMES = {"moordyn rk2": "rk2", "moordyn default": None}

Drive = Callable[[float], np.ndarray]
#: Suppress the output of a library on the standard streams.
quiet = partial(discard_output, 1, 2)


class Path3(NamedTuple):
    """Positions (k, 3) [m] of a point at times t (k,) [s], including the start, and whether the run completed."""

    t: np.ndarray
    positions: np.ndarray
    ok: bool


def moordyn_there() -> bool:
    """Whether the package `moordyn` is installed (extra `peers`)."""
    return find_spec("moordyn") is not None


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
    import moordyn

    options: dict[str, Any] = {"disableOutput": 1, "disableOutTime": 1, "dtOut": duration}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), quiet():
        file = Path(folder) / "mooring.txt"
        write_moordyn(scene, file, dt=dt, options=options if scheme is None else {**options, "tScheme": scheme})
        if scheme is None:
            lines = file.read_text().splitlines()
            file.write_text("\n".join(line for line in lines if not line.endswith(" dtM")) + "\n")
        system = moordyn.Create(str(file))
        try:
            return _march(moordyn, system, scene, point, dt, round(duration / dt), drive)
        finally:
            moordyn.Close(system)


def _march(moordyn: Any, system: Any, scene: Scene, point: str, dt: float, steps: int, drive: Drive | None) -> Path3:
    motion = scene.effects.get("end_motion")
    moved = [] if motion is None else [scene.point(name).position for name in (motion["point"], *motion["also"])]

    def moved_positions(t: float) -> np.ndarray:
        return np.concatenate([position + drive(t) for position in moved]) if moved else np.zeros(0)

    def speeds(t: float, span: float) -> list[float]:
        return ((moved_positions(t + span) - moved_positions(t)) / span).tolist()

    where, positions = _position_getter(moordyn, system, scene, point), []
    with contextlib.suppress(RuntimeError):
        moordyn.Init(system, moved_positions(0.0).tolist(), speeds(0.0, 1e-6))
        positions.append(where())
        # positions beyond this distance [m] are not possible in these scenes
        while len(positions) <= steps and np.all(np.abs(positions[-1]) < 1e4):
            t = (len(positions) - 1) * dt
            moordyn.Step(system, moved_positions(t).tolist(), speeds(t, dt), t, dt)
            positions.append(where())
    found = np.array(positions, float).reshape(-1, 3)
    return Path3(dt * np.arange(len(found)), found, len(found) == steps + 1 and bool(np.all(np.abs(found[-1]) < 1e4)))


def _position_getter(moordyn: Any, system: Any, scene: Scene, point: str) -> Callable[[], Any]:
    """Source of the position of a point: the point itself, or the end of a line on the base of its buoy."""
    buoys = {buoy.point for buoy in scene.buoys}
    if point not in buoys:
        own = moordyn.GetPoint(system, [p.name for p in scene.points if p.name not in buoys].index(point) + 1)
        return lambda: moordyn.GetPointPos(own)
    i, line = next((i, line) for i, line in enumerate(scene.lines) if point in (line.start, line.end))
    found = moordyn.GetLine(system, i + 1)
    node = 0 if line.start == point else moordyn.GetLineN(found)
    return lambda: moordyn.GetLineNodePos(found, node)
