"""Scenes of `channels.py`, and their motion by programs that are not this project's."""

from collections.abc import Callable

import numpy as np
from closed_chain import rigid_line, still
from study import Found

#: Longlines: lengths over the straight ways of legs and backbone, EA of the rope [N], step [s] and scheme of the fit,
#: the same of the truth, and how far off EA starts.
LONGLINES = {
    "taut": ((0.92, 0.92), 1.5e5, (0.025, "energy_momentum"), (0.00125, "rk4"), 2.0),
    "slack": ((1.08, 1.02), 4e5, (0.0125, "energy_momentum"), (0.00125, "rk4"), 0.5),
    "stiff": ((1.08, 1.02), 5e7, (0.025, "generalized_alpha"), (0.0025, "energy_momentum"), 2.0),
}


def longline(kind: str) -> Found:
    """Two legs, two floats, a backbone and two droppers in a sea of 20 waves and a current across."""
    (leg, backbone), stiffness, (step, scheme), *_ = LONGLINES[kind]
    leg, backbone = leg * float(np.hypot(24.0, 12.0)), 30.0 * backbone
    both = {"damping_ratio": 0.1, "cdn": 1.2, "cdt": 0.02, "can": 1.0, "cat": 0.0}
    rope = {"name": "rope", "mass": 0.45, "diameter": 0.028, "EA": stiffness, **both}
    sock = {"name": "sock", "mass": 21.8, "diameter": 0.146, "EA": 4e5, **both}
    float_ = {"kind": "free", "mass": 30.0, "volume": 0.25, "drag_area": 0.5, "added_mass": 0.5}
    return {
        "run": {"dt": step, "duration": 605.0, "save_every": round(0.05 / step), "integrator": scheme},
        "line_type": [rope, sock],
        "point": [
            {"name": "west", "position": [-39.0, 0.0, -20.0]},
            {"name": "east", "position": [39.0, 0.0, -20.0]},
            {"name": "w", "position": [-15.0, 0.0, -8.0], **float_},
            {"name": "e", "position": [15.0, 0.0, -8.0], **float_},
        ],
        "line": [
            {"name": "west-leg", "from": "west", "to": "w", "type": "rope", "length": leg, "links": 6},
            {
                "name": "backbone", "from": "w", "to": "e", "type": "rope", "length": backbone, "links": 8,
                "attach": [{"point": "m", "at": backbone / 2}],
            },
            {"name": "east-leg", "from": "e", "to": "east", "type": "rope", "length": leg, "links": 6},
            {"name": "dropper-1", "from": "w", "to": "m", "type": "sock", "length": 20.0, "links": 6},
            {"name": "dropper-2", "from": "m", "to": "e", "type": "sock", "length": 20.0, "links": 6},
        ],
        "sea": {
            "depth": 22.0,
            "ramp": 20.0,
            "waves": {"kind": "spectrum", "hs": 1.2, "tp": 6.5, "count": 20, "seed": 3, "direction": 1.0},
            "current": {"kind": "uniform", "speed": 0.4, "direction": 1.5707963267948966},
        },
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
    }  # fmt: skip


#: The chain: links and node masses; its damping.
CHAIN = {"lengths": np.full(3, 0.3), "masses": np.array([0.1, 0.1, 0.15]), "b_l": 0.01, "b_q": 0.03}


def chain_scene(polar: np.ndarray, kick: float = 0.0) -> Found:
    """The hanging chain with links at these angles from straight down (3,) [rad], its tip kicked across [m/s]."""
    steps = CHAIN["lengths"][:, None] * np.stack([np.sin(polar), 0 * polar, -np.cos(polar)], axis=1)
    nodes = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    velocities = np.zeros((4, 3))
    velocities[3, 1] = kick
    return {
        "run": {"dt": 0.005, "duration": 10.0, "integrator": "rattle_4"},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "tip", "kind": "free", "position": nodes[-1].tolist()},
        ],
        "line": [
            {
                "name": "chain", "from": "top", "to": "tip", "links": 3, "length": CHAIN["lengths"].tolist(),
                "mass": CHAIN["masses"].tolist(),
            }
        ],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.02}, "quadratic_damping": {"b_q": 0.06}},
        "start": {"kind": "positions", "positions": nodes.tolist(), "velocities": velocities.tolist()},
    }  # fmt: skip


def chain_truth(t: np.ndarray, scene: Found, b_l: float, b_q: float) -> np.ndarray:
    """Nodes (times, 4, 3) [m] of that scene's chain with this damping."""
    r0, v0 = (np.array(scene["start"][key]) for key in ("positions", "velocities"))
    start = still(np.zeros(3))
    return rigid_line(t, r0, v0, CHAIN["lengths"], CHAIN["masses"], b_l=b_l, b_q=b_q, ends=(start,))


#: The cable: links, length [m], span [m], mass per node [kg], damping [kg/s].
CABLE = {"links": 16, "length": 1.0, "span": 0.8, "mass": 0.00625, "b_l": 2e-3}


def shaken(place: np.ndarray, number: int) -> Callable[[float], np.ndarray]:
    """An end that swings in three directions, from rest: places, velocities and accelerations (9,)."""
    size = np.array([0.02, 0.015, 0.02])
    omega = 2 * np.pi * (np.array([0.9, 1.3, 1.7]) + 0.23 * number)

    def at(t: float) -> np.ndarray:
        u = min(t, 1.0)
        ramp = np.array([u**3 * (10 - 15 * u + 6 * u * u), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)])
        wave = np.array([np.sin(omega * t), omega * np.cos(omega * t), -(omega**2) * np.sin(omega * t)])
        rate = ramp[0] * wave[1] + ramp[1] * wave[0]
        bend = ramp[0] * wave[2] + 2 * ramp[1] * wave[1] + ramp[2] * wave[0]
        return np.concatenate([place + size * ramp[0] * wave[0], size * rate, size * bend])

    return at


def cable_truth(t: np.ndarray, stiffness: float) -> np.ndarray:
    """Nodes (times, n + 1, 3) [m] of the cable between two ends that swing, from rest."""
    n, span = CABLE["links"], CABLE["span"]
    lengths, masses = np.full(n, CABLE["length"] / n), np.full(n - 1, CABLE["mass"])
    low, high = np.zeros(3), np.array([span, 0.0, 0.1])
    # a zigzag of the right lengths settles into the pose at rest
    away = (high - low) / n
    side = np.sqrt((CABLE["length"] / n) ** 2 - float(away @ away))
    down = np.array([0.0, 0.0, -1.0]) + away[2] / float(away @ away) * away
    nodes = np.array([low + j * away + side * (j % 2) * down / np.linalg.norm(down) for j in range(n + 1)])
    rest = rigid_line(
        np.array([0.0, 30.0]), nodes, np.zeros_like(nodes), lengths, masses, b_l=0.05, stiffness=stiffness,
        ends=(still(low), still(high)),
    )[-1]  # fmt: skip
    ends = (shaken(low, 0), shaken(high, 1))
    return rigid_line(t, rest, np.zeros_like(rest), lengths, masses, b_l=CABLE["b_l"], stiffness=stiffness, ends=ends)


def cable_scene(stiffness: float) -> Found:
    """The cable, stiffness and damping two times off."""
    n = CABLE["links"]
    return {
        "run": {"dt": 0.005, "duration": 6.0},
        "point": [
            {"name": "low", "position": [0.0, 0.0, 0.0]},
            {"name": "high", "position": [CABLE["span"], 0.0, 0.1]},
        ],
        "line": [
            {
                "name": "cable", "from": "low", "to": "high", "links": n, "length": CABLE["length"] / n,
                "mass": CABLE["mass"],
            }
        ],
        "effects": {
            "weight": {},
            "bending": {"EI": 2 * stiffness},
            "linear_damping": {"b_l": 2 * CABLE["b_l"]},
        },
    }  # fmt: skip
