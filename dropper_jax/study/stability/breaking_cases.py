"""Links that break, compared with closed forms and SciPy."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from dropper_jax.load.scene import Scene
from dropper_jax.study.stability.case import Watched, distance_from, watch
from dropper_jax.study.stability.scenes import G, weight_on_rope

MASS, LENGTH, STIFFNESS = 100.0, 10.0, 4e3
OMEGA = np.sqrt(STIFFNESS / MASS)
REST = MASS * G / STIFFNESS
CUT = 0.5


def _cut_off(short: bool) -> Watched:
    """A weight at rest falls by `g (t - cut)^2/2`."""
    failure = {"line": "rope", "link": 1, "time": CUT}
    scene = weight_on_rope("cut-off", MASS, STIFFNESS, LENGTH, LENGTH + REST, failure=[failure])

    def exact(t: np.ndarray) -> np.ndarray:
        return -0.5 * G * np.maximum(t - CUT, 0.0) ** 2

    return Watched(scene, 0.002, 1.6, "weight", distance_from(exact, 1.0, from_start=True))


#: Tension at which the link parts, over the weight.
LOAD = 1.5


def _overloaded_rope(short: bool) -> Watched:
    """A weight released unstretched: `T = m g (1 - cos w t)` until the load, then it flies on."""
    load = {"line": "rope", "link": 1, "load": LOAD * MASS * G}
    scene = weight_on_rope("overloaded", MASS, STIFFNESS, LENGTH, LENGTH, failure=[load])
    parts = np.arccos(1.0 - LOAD) / OMEGA

    def measure(t: np.ndarray, positions: np.ndarray) -> float:
        held = np.minimum(t, parts)
        since = np.maximum(t - parts, 0.0)
        speed = G / OMEGA * np.sin(OMEGA * parts)
        exact = -REST * (1.0 - np.cos(OMEGA * held)) - speed * since - 0.5 * G * since**2
        return float(np.max(np.abs(positions[:, 2] - positions[0, 2] - exact))) / float(np.max(np.abs(exact)))

    return Watched(scene, 0.002, 1.6, "weight", measure)


#: The weight between two ropes: their points stand this far to its sides and above it [m].
ASIDE = 6.0
POSITION = np.array([0.0, 0.0, -8.0])


def _taut_length() -> float:
    """Unstretched length [m] of either rope with which the weight rests where it is put."""
    size = float(np.hypot(ASIDE, POSITION[2]))
    return size - 0.5 * MASS * G * size / abs(POSITION[2]) / STIFFNESS


def between_two() -> Scene:
    """A weight at rest on two ropes of which one is cut."""
    length = _taut_length()
    failure = {"line": "rope", "link": 1, "time": CUT}
    table = weight_on_rope("one-of-two", MASS, STIFFNESS, length, -POSITION[2], failure=[failure]).to_dict()
    table["point"][0]["position"] = [-ASIDE, 0.0, 0.0]
    table["point"].append({"name": "right", "kind": "fixed", "position": [ASIDE, 0.0, 0.0]})
    table["line"].append(table["line"][0] | {"name": "other", "from": "right"})
    return Scene.from_dict(table)


def _on_the_other(t: np.ndarray) -> np.ndarray:
    """Positions (k, 2) of the weight: at rest, then a pendulum on a spring without compression."""
    length = _taut_length()

    def swing(_: float, y: np.ndarray) -> np.ndarray:
        d = y[:2] - [ASIDE, 0.0]
        size = np.hypot(*d)
        force = STIFFNESS / MASS * max(size - length, 0.0) * d / size
        return np.concatenate([y[2:], [-force[0], -force[1] - G]])

    start = np.array([0.0, POSITION[2], 0.0, 0.0])
    late = t > CUT
    found = solve_ivp(swing, (CUT, t[-1]), start, t_eval=t[late], rtol=1e-10, atol=1e-11)
    return np.concatenate([np.tile(start[:2], (np.sum(~late), 1)), found.y[:2].T])


def _one_of_two(short: bool) -> Watched:
    return Watched(between_two(), 0.005, 3.0, "weight", distance_from(_on_the_other, ASIDE))


CASES = [
    watch("cut-off", "a weight at rest is cut off: distance from free fall after 1.1 s", 1e-9, "m", _cut_off),
    watch("parts-at-load", "a weight parts its rope at 1.5 times its weight and flies on, dt 0.002 s: distance from "
          "the closed form over its way", 0.01, "relative", _overloaded_rope),
    watch("one-of-two-parts", "one of two ropes parts, the weight swings on the other for 2.5 s at dt 0.005 s: "
          "distance from SciPy over the half distance of the ropes", 0.01, "relative", _one_of_two),
]  # fmt: skip
