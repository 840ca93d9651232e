"""A rod whose clamp starts moving suddenly, a drum that slides on the seabed, an arm that rotates about its pin."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from dropper_jax.base.constants import SEA_WATER
from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.simulate import simulate
from dropper_jax.study.stability.case import Case, Outcome, relative_drift
from dropper_jax.study.stability.energy_cases import ROUNDING
from dropper_jax.study.stability.flow_cases import beside_a_rope
from dropper_jax.study.stability.scenes import G

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


def _rod(short: bool) -> Outcome:
    """Error of what the rod has of its first shape, of the largest.

    Seen from the clamp all of the rod starts with -V: `a = -V c sin(omega t)/omega`, c = int phi/int phi^2.
    """
    ran = simulate(clamped_rod(), duration=0.8 if short else 3.2)
    s = np.linspace(0.0, 1.0, LINKS + 1)
    weight = np.ones(LINKS + 1)
    weight[[0, -1]] = 0.5
    phi, omega = first_shape(s)
    across = ran.positions[:, :, 2] - SPEED * ran.t[:, None]
    found = across @ (weight * phi) / (weight @ phi**2)
    share = (weight @ phi) / (weight @ phi**2)
    exact = -SPEED * share * np.sin(omega * ran.t) / omega
    return Outcome(float(np.max(np.abs(found - exact)) * omega / (SPEED * share)), ran.status)


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


def _drum(short: bool) -> Outcome:
    """Error of the way `v^2/(2 mu g')`, with what it creeps afterwards."""
    ran = simulate(sliding_drum(), dt=0.01, duration=3.0 if short else 20.0)
    way = 0.5 * SLIDES**2 / (FRICTION * WEIGHT / MASS)
    return Outcome(abs(float(ran.body_position[-1, 0, 0]) / way - 1.0), ran.status)


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


def _arm(short: bool) -> Outcome:
    return relative_drift(simulate(pinned_arm(), dt=0.01, duration=4.0 if short else 60.0))


CASES = [
    Case("clamped-rod", "the clamp of a rod of 32 links moves off sideways at once, 3.2 s at dt 0.01 s (2 periods): "
         "error of its first shape", 0.02, "of the largest", _rod),
    Case("sliding-drum", "a drum slides on the bed at 2 m/s, stops and lies, 20 s at dt 0.01 s: error of its way",
         0.01, "relative", _drum),
    Case("pinned-arm", "an arm turns over and over about a pin, 60 s at dt 0.01 s: drift of the energy balance",
         ROUNDING, "of the scale", _arm),
]  # fmt: skip
