"""Lines in contact and torsion: a rope that falls onto another stays above it without energy gain; twist oscillates
undamped."""

from typing import Any

import numpy as np
from hard_scenes import G
from rows import exact, row, steps

from dropper_jax.load.scene import Scene, load_scene

#: Radius of the ropes [m]: a fall of 1 m ends at three radii per step.
RADIUS, STEP = 0.03, 0.02


def falling_rope() -> Scene:
    """A weight in the middle of a slack rope falls 1 m onto a taut rope below, across it."""
    rope = {"name": "rope", "mass": 0.5, "diameter": 2 * RADIUS, "EA": 5000.0}
    ends = {"a": [-1.0, 0.0, 0.0], "b": [1.0, 0.0, 0.0], "c": [0.1, -1.0, 1.0], "d": [0.1, 1.0, 1.0]}
    points: list[dict[str, Any]] = [{"name": name, "position": position} for name, position in ends.items()]
    points.append({"name": "weight", "kind": "free", "position": [0.1, 0.0, 1.0], "mass": 5.0})
    half = {"type": "rope", "length": 1.8, "links": 4}
    return load_scene(
        {
            "name": "rope-on-rope",
            "run": {"dt": STEP, "duration": 2.0},
            "line_type": [rope],
            "point": points,
            "line": [
                {"name": "low", "from": "a", "to": "b", "type": "rope", "length": 2.0, "links": 5},
                {"name": "left", "from": "c", "to": "weight", **half},
                {"name": "right", "from": "weight", "to": "d", **half},
            ],
            "effects": {
                "weight": {"gravity": G},
                "line_contact": {"pairs": [["low", "left"], ["low", "right"]], "stiffness": 2e4},
            },
            "start": {"kind": "points"},
        }
    )


#: The rod: length [m], stiffness [N m^2], inertia per length [kg m], moment [N m].
LONG, STIFF, HEAVY, MOMENT = 2.0, 1.0, 0.01, 0.3


def twisted_rod() -> Scene:
    """A hanging rod with a moment applied suddenly at its lower end."""
    twist = {"GJ": STIFF, "polar_inertia": HEAVY, "torque": MOMENT, "begins": "untwisted"}
    rod = {"length": LONG / 40, "mass": 0.2 / 40, "diameter": 0.02, "axial": {"law": "elastic", "EA": 2000.0}}
    return load_scene(
        {
            "name": "twisted-rod",
            "run": {"dt": 0.002, "duration": 4.0},
            "point": [
                {"name": "a", "position": [0.0, 0.0, 0.0]},
                {"name": "b", "position": [0.0, 0.0, -LONG], "kind": "free"},
            ],
            "line": [{"name": "rod", "from": "a", "to": "b", "links": 40, **rod}],
            "effects": {"weight": {}, "torsion": twist},
        }
    )


#: The first shape `sin(pi s/(2 L))` at the nodes, and the twist that the moment holds of it, `8 T L/(GJ pi^2)` [rad].
ENDS_HALF = np.ones(41)
ENDS_HALF[[0, -1]] = 0.5
SHAPE = ENDS_HALF * np.sin(0.5 * np.pi * np.arange(41) / 40) / 20
HOLDS = 8.0 * MOMENT * LONG / (STIFF * np.pi**2)


def _share_of_shape(t: np.ndarray) -> np.ndarray:
    """What the rod has of its first shape, `a (1 - cos(omega t))` [rad]."""
    omega = 0.5 * np.pi * np.sqrt(STIFF / HEAVY) / LONG
    return HOLDS * (1.0 - np.cos(omega * t))


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    twists = exact(steps(0.002, 4.0), _share_of_shape)

    return [
        row(
            "rope-on-rope",
            "5 kg in a slack rope fall 1 m onto a rope across, by three radii per step of 0.02 s: passes "
            "it (1) or not (0)",
            0.0,
            "-",
            "passes",
            falling_rope(),
            STEP,
            4.0,
            0.8,
        ),
        row(
            "rope-on-rope-energy",
            "the same, undamped: energy gained in any step beyond what weights do",
            1e-9,
            "of the scale",
            "gain",
            falling_rope(),
            STEP,
            4.0,
            0.8,
        ),
        row(
            "twisted-rod",
            "a moment put on the end of a rod at once, 5 periods of twist at dt 0.002 s: error of the first shape",
            0.01,
            "of the largest",
            "twist",
            twisted_rod(),
            0.002,
            4.0,
            0.8,
            exact=twists,
            weights=SHAPE.tolist(),
            size=2.0 * HOLDS,
        ),
    ]
