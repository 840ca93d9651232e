"""A rod whose clamp starts moving suddenly, a drum that slides on the seabed, an arm that rotates about its pin."""

from typing import Any

import numpy as np
from energy_cases import ROUNDING
from flow_cases import beside_a_rope
from hard_scenes import G
from rows import exact, row, steps
from scipy.optimize import brentq

from dropper_jax.base.constants import SEA_WATER
from dropper_jax.load.scene import Scene, load_scene

#: The rod: length [m], stiffness [N m^2], mass per length [kg/m], links; speed of its clamp from the start [m/s].
LONG, STIFF, HEAVY, LINKS, SPEED = 2.0, 20.0, 1.0, 32, 0.05


def clamped_rod() -> Scene:
    """A rod whose clamp moves off sideways at full speed at t = 0, weightless."""
    motion = {"point": "wall", "time": [0.0, 100.0], "displacement": [[0.0] * 3, [0.0, 0.0, 100.0 * SPEED]]}
    return load_scene(
        {
            "name": "clamped-rod",
            "run": {"dt": 0.01, "duration": 3.2},
            "line_type": [{"name": "rod", "mass": HEAVY, "diameter": 0.02, "EA": 1e5, "law": "elastic", "EI": STIFF}],
            "point": [
                {"name": "wall", "position": [0.0, 0.0, 0.0]},
                {"name": "tip", "position": [LONG, 0.0, 0.0], "kind": "free"},
            ],
            "line": [{"name": "rod", "from": "wall", "to": "tip", "type": "rod", "length": LONG, "links": LINKS}],
            "effects": {
                "weight": {"gravity": 0.0},
                "bending": {"clamped": ["wall"], "directions": [[1.0, 0.0, 0.0]]},
                "end_motion": motion,
            },
            "start": {"kind": "points"},
        }
    )


def first_shape(s: np.ndarray) -> tuple[np.ndarray, float]:
    """The first shape phi (k,) of a clamped rod at shares s of its length, and its angular frequency [rad/s].

    `cos b cosh b = -1`, `omega = b^2 sqrt(EI/(m L^4))`.
    """
    b = brentq(lambda x: np.cos(x) + 1.0 / np.cosh(x), 1.5, 2.2)
    lean = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    phi = np.cosh(b * s) - np.cos(b * s) - lean * (np.sinh(b * s) - np.sin(b * s))
    return phi, b**2 * np.sqrt(STIFF / (HEAVY * LONG**4))


ENDS_HALF = np.ones(LINKS + 1)
ENDS_HALF[[0, -1]] = 0.5
PHI, OMEGA = first_shape(np.linspace(0.0, 1.0, LINKS + 1))
#: What makes the share of the first shape of the nodes' heights, and that of a uniform motion.
SHAPE = ENDS_HALF * PHI / (ENDS_HALF @ PHI**2)
SHARE = np.sum(SHAPE)


def _share_of_shape(t: np.ndarray) -> np.ndarray:
    """Seen from the clamp all of the rod starts with -V: `a = -V c sin(omega t)/omega`, c = int phi/int phi^2 [m]."""
    return SPEED * SHARE * t - SPEED * SHARE * np.sin(OMEGA * t) / OMEGA


#: A drum on the seabed: mass [kg], friction, speed [m/s], depth [m], stiffness of the seabed [Pa/m].
MASS, FRICTION, SLIDES, DEPTH, BED, RHO = 3000.0, 0.4, 2.0, 20.0, 1e6, SEA_WATER
WEIGHT = G * (MASS - RHO * 0.5 * np.pi)


def sliding_drum() -> Scene:
    """A drum of 1 m by 2 m that slides on the seabed along its axis, without drag and added mass."""
    none = {"cdn": 0.0, "can": 0.0, "ends": "none"}
    body = {
        "name": "drum",
        "position": [0.0, 0.0, -DEPTH + 0.5 - WEIGHT / (BED * 2.0)],
        "mass": MASS,
        "centre_of_mass": [0.0, 0.0, 0.0],
        "inertia": [400.0, 1200.0, 1200.0],
        "cylinders": [{"from": [-1.0, 0.0, 0.0], "to": [1.0, 0.0, 0.0], "diameter": 1.0, "slices": 4, **none}],
        "touches_bed": True,
        "bed_friction": FRICTION,
        "velocity": [SLIDES, 0.0, 0.0],
    }
    bed = {"weight": {"gravity": G}, "seabed": {"stiffness": BED, "damping": 0.1 * BED}}
    return beside_a_rope("sliding-drum", body, sea={"depth": DEPTH, "density": RHO}, effects=bed)


def pinned_arm() -> Scene:
    """An arm with a pin at one end, released almost upright: it rotates continuously."""
    body = {
        "name": "arm",
        "position": [0.0, 0.0, 0.0],
        "attitude": [0.02, 3.1, 0.0],
        "angular_velocity": [0.0, 0.3, 0.0],
        "mass": 5.0,
        "centre_of_mass": [0.0, 0.0, -2.0],
        "inertia": [3.0, 2.0, 1.5],
        "pinned": True,
    }
    return beside_a_rope("pinned-arm", body, effects={"weight": {}})


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    # Way of the drum, `v^2/(2 mu g')` [m].
    way = 0.5 * SLIDES**2 / (FRICTION * WEIGHT / MASS)
    swings = exact(steps(0.01, 3.2), _share_of_shape)

    return [
        row(
            "clamped-rod",
            "the clamp of a rod of 32 links moves off sideways at once, 3.2 s at dt 0.01 s (2 periods): "
            "error of its first shape",
            0.02,
            "of the largest",
            "heights",
            clamped_rod(),
            0.01,
            3.2,
            0.8,
            exact=swings,
            weights=SHAPE.tolist(),
            size=SPEED * SHARE / OMEGA,
        ),
        row(
            "sliding-drum",
            "a drum slides on the bed at 2 m/s, stops and lies, 20 s at dt 0.01 s: error of its way",
            0.01,
            "relative",
            "way of body",
            sliding_drum(),
            0.01,
            20.0,
            3.0,
            size=way,
        ),
        row(
            "pinned-arm",
            "an arm turns over and over about a pin, 60 s at dt 0.01 s: drift of the energy balance",
            ROUNDING,
            "of the scale",
            "balance",
            pinned_arm(),
            0.01,
            60.0,
            4.0,
        ),
    ]
