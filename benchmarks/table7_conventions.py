"""Conventions that the paper leaves open or that its simulators have otherwise: one change of a case each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dropper_jax import Scene

ALL, WAVES, IRREGULAR = (1, 2, 3, 4, 5), (1, 2, 3, 5), (3, 5)
#: Draught of the buoy at rest in case 4 [m].
DRAUGHT = 3.27


@dataclass(frozen=True)
class Convention:
    """A change of one thing.

    Attributes:
        values: values by path, given the case's scene.
    """

    name: str
    cases: tuple[int, ...]
    values: Callable[[Scene], Mapping[str, Any]]

    def changed(self, scene: Scene) -> Scene:
        return scene.with_values(dict(self.values(scene)))


def _fixed(name: str, cases: tuple[int, ...], **values: Any) -> Convention:
    """The same values for every case; `__` stands for a dot."""
    paths = {path.replace("__", "."): value for path, value in values.items()}
    return Convention(name, cases, lambda scene: paths)


def _friction(scene: Scene) -> dict[str, Any]:
    has = "seabed_friction" in scene.effects
    return {"effects.seabed_friction.kinetic": 0.0 if has else 0.5}


def _phases(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Scene], dict[str, Any]]:
    def values(scene: Scene) -> dict[str, Any]:
        phase = np.asarray(scene.sea.waves.phase if scene.sea.waves.phase is not None else 0.0, float)
        found = change(phase)
        return {"sea.waves.phase": found.tolist()}

    return values


def _slim(scene: Scene) -> float:
    """Draught at rest over the buoy's diameter: its side is taken as wet to there at all times."""
    return DRAUGHT / scene.buoys[0].diameter


def _half(scene: Scene) -> float:
    return 0.5 * scene.buoys[0].height


def _lower(scene: Scene) -> dict[str, Any]:
    x, y, _ = next(point for point in scene.points if point.name == "buoy").position
    return {"point.buoy.position": [float(x), float(y), -2.0 * 4.43]}


CONVENTIONS = (
    _fixed("start at rest, not from Table 6", ALL, start__kind="static"),
    Convention("bed friction 0.5 added; case 2: taken away", ALL, _friction),
    _fixed("damper goes on in slack links (`damped_rope`)", ALL, line_type__chain__law="damped_rope"),
    _fixed("the same, damping ratio 1", ALL, line_type__chain__law="damped_rope", line_type__chain__damping_ratio=1.0),
    Convention("chain at the buoy's half height", ALL, lambda s: {"buoy.0.attachment": _half(s)}),
    Convention("-4.43 m is the buoy's middle, chain at its base", ALL, _lower),
    Convention("buoy: drag along on pi D w", ALL, lambda s: {"buoy.0.cdt": s.buoys[0].cdt * 4 * _slim(s)}),
    Convention("buoy: drag along on D w", ALL, lambda s: {"buoy.0.cdt": s.buoys[0].cdt * 4 * _slim(s) / np.pi}),
    _fixed("buoy: added mass along of the wet volume", ALL, buoy__0__end_added_mass="volume"),
    Convention("wave phases 180 degrees later", WAVES, _phases(lambda p: p + np.pi)),
    Convention("wave phases 90 degrees later", WAVES, _phases(lambda p: p + np.pi / 2)),
    Convention("wave phases of Table A1 with the other sign", IRREGULAR, _phases(lambda p: -p)),
    Convention("chain: axial drag on D, not on pi D", ALL, lambda s: {"line_type.chain.cdt": 0.2 / np.pi}),
    _fixed("24 segments", ALL, line__chain__links=24),
    _fixed("damping ratio 1", ALL, line_type__chain__damping_ratio=1.0),
    _fixed("bed 10 times softer, damper too", ALL, effects__seabed__stiffness=3e5, effects__seabed__damping=3e4),
    _fixed("water above z = 0 moves as at z = 0", WAVES, sea__stretching="constant"),
    _fixed("waves take the current's Doppler shift", (5,), sea__wave_current="doppler"),
)
