"""The fixed points of a scene as an FMI 3.0 unit for other simulators, made by pythonfmu3 (extra `fmi`)."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError, SimulationError
from dropper_jax.base.files import atomic_write
from dropper_jax.coupling.coupled import Coupled
from dropper_jax.load.scene import load_scene
from dropper_jax.modelling.build import SceneLike
from dropper_jax.run.storage import extra

AXES = ("x", "y", "z")
#: Script of a unit: the scene, its points and its step as text, and the class that pythonfmu3 looks for.
SCRIPT = '''"""Lines of {name!r}: a unit made by dropper-jax."""

from pythonfmu3 import Fmi3Slave

from dropper_jax.coupling.fmu import Unit


class Mooring(Unit, Fmi3Slave):
    GIVEN = {given!r}
'''


def write_fmu(
    scene: SceneLike, path: str | Path, points: Sequence[str] | None = None, *, dt: float | None = None
) -> Path:
    """Write a co-simulation unit of `Coupled(scene, points, dt)`.

    For every point P the inputs are `P_x`, `P_y`, `P_z` [m] and `P_vx`, `P_vy`, `P_vz` [m/s] at the end of a step. The
    outputs are `P_fx`, `P_fy`, `P_fz` [N]. Characters other than letters, digits and `_` in a name become `_`. The
    simulator that loads the unit needs a Python with this package.

    Args:
        path: `NAME.fmu`.
        points, dt: as of `Coupled`.

    Raises:
        SceneError: pythonfmu3 is missing, points that cannot be coupled, names that become equal.
    """
    package = extra("pythonfmu3", "fmi")
    path = Path(path)
    if path.suffix.lower() != ".fmu":
        raise SceneError(f"path: {str(path)!r} has another suffix; allowed: .fmu")
    loaded = load_scene(scene)
    coupled = Coupled(loaded, points, dt=dt)
    given = json.dumps({"scene": loaded.as_written(), "points": list(coupled.points), "dt": dt})
    plain_names(coupled.points)
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "mooring.py"
        script.write_text(SCRIPT.format(name=loaded.name, given=given), encoding="utf-8")
        return atomic_write(path, Path(package.FmuBuilder.build_FMU(script, dest=folder)).read_bytes())


def plain_names(points: Sequence[str]) -> list[str]:
    """Names of points as parts of variables' names."""
    found = [re.sub(r"\W", "_", name, flags=re.ASCII) for name in points]
    for i, name in enumerate(found):
        if name in found[:i]:
            same = f"{points[found.index(name)]!r} and {points[i]!r}"
            raise SceneError(f"points: {same} both become {name!r}; allowed: names whose letters and digits differ")
    return found


class Unit:
    """Behaviour of a unit in a simulator; `SCRIPT` makes it a class of pythonfmu3.

    Attributes:
        GIVEN: scene, points and step as JSON.
    """

    GIVEN = "{}"
    register_variable: Callable[[object], None]

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        given = json.loads(self.GIVEN)
        self.author = "dropper-jax"
        self.description = "lines of a scene on points that move"
        self.lines = Coupled(given["scene"], given["points"], dt=given["dt"])
        home = [self.lines.scene.point(name).position for name in self.lines.points]
        self.motion = np.stack([np.array(home, float), np.zeros((len(home), 3))])
        self.forces = np.zeros((len(home), 3))
        self.time = 0.0
        self._register()

    def _register(self) -> None:
        """Declare time, and the inputs and outputs of every point."""
        kinds = extra("pythonfmu3", "fmi")
        causality = kinds.Fmi3Causality
        varies = {"variability": kinds.Fmi3Variability.continuous}
        self.register_variable(kinds.Float64("time", causality=causality.independent, **varies))
        for i, name in enumerate(plain_names(self.lines.points)):
            for level, letter, unit in ((0, "", "m"), (1, "v", "m/s")):
                for axis, word in enumerate(AXES):
                    index = (level, i, axis)
                    variable = kinds.Float64(
                        f"{name}_{letter}{word}",
                        start=float(self.motion[index]),
                        description=f"[{unit}]",
                        causality=causality.input,
                        getter=lambda index=index: float(self.motion[index]),
                        setter=partial(self._set_motion, index),
                        **varies,
                    )
                    self.register_variable(variable)
            for axis, word in enumerate(AXES):
                variable = kinds.Float64(
                    f"{name}_f{word}",
                    description="[N]",
                    causality=causality.output,
                    getter=lambda i=i, axis=axis: float(self.forces[i, axis]),
                    **varies,
                )
                self.register_variable(variable)

    def _set_motion(self, index: tuple[int, int, int], value: float) -> None:
        """Set an input: a component of a position or of a velocity."""
        self.motion[index] = value

    def exit_initialization_mode(self) -> None:
        """Initialise at rest with the points at the given positions."""
        self.forces = self.lines.init(self.motion[0], self.motion[1])

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance to the given positions and velocities; False if the step fails."""
        try:
            self.forces = self.lines.step(self.motion[0], self.motion[1], step_size)
        except (SimulationError, SceneError):
            return False
        self.time = current_time + step_size
        return True
