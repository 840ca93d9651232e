"""Links that break, compared with closed forms and SciPy."""

from typing import Any

import numpy as np
from hard_scenes import G, weight_on_rope
from rows import exact, path, steps
from scipy.integrate import solve_ivp

from dropper_jax.load.scene import Scene

MASS, LENGTH, STIFFNESS = 100.0, 10.0, 4e3
OMEGA = np.sqrt(STIFFNESS / MASS)
REST = MASS * G / STIFFNESS
CUT = 0.5


def cut_off() -> Scene:
    """A weight at rest whose rope is cut."""
    failure = {"line": "rope", "link": 1, "time": CUT}
    return weight_on_rope("cut-off", MASS, STIFFNESS, LENGTH, LENGTH + REST, failure=[failure])


def _falling(t: np.ndarray) -> np.ndarray:
    """The weight falls by `g (t - cut)^2/2`."""
    return -0.5 * G * np.maximum(t - CUT, 0.0) ** 2


#: Tension at which the link parts, over the weight.
LOAD = 1.5


def overloaded_rope() -> Scene:
    """A weight released unstretched from a rope that parts."""
    load = {"line": "rope", "link": 1, "load": LOAD * MASS * G}
    return weight_on_rope("overloaded", MASS, STIFFNESS, LENGTH, LENGTH, failure=[load])


def _flies_on(t: np.ndarray) -> np.ndarray:
    """`T = m g (1 - cos w t)` until the load, then the weight flies on."""
    parts = np.arccos(1.0 - LOAD) / OMEGA
    on_rope = np.minimum(t, parts)
    since = np.maximum(t - parts, 0.0)
    speed = G / OMEGA * np.sin(OMEGA * parts)
    return -REST * (1.0 - np.cos(OMEGA * on_rope)) - speed * since - 0.5 * G * since**2


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


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    # To rounding, as the claim is.
    fall = exact(steps(0.002, 1.6), _falling, digits=17)
    flight = exact(steps(0.002, 1.6), _flies_on)
    flown = float(np.max(np.abs(flight["values"])))
    swing = exact(steps(0.005, 3.0), _on_the_other)

    return [
        path(
            "cut-off",
            "a weight at rest is cut off: distance from free fall after 1.1 s",
            1e-9,
            "m",
            "distance",
            cut_off(),
            0.002,
            1.6,
            exact=fall,
            from_start=True,
        ),
        path(
            "parts-at-load",
            "a weight parts its rope at 1.5 times its weight and flies on, dt 0.002 s: distance from "
            "the closed form over its way",
            0.01,
            "relative",
            "distance",
            overloaded_rope(),
            0.002,
            1.6,
            exact=flight,
            from_start=True,
            size=flown,
        ),
        path(
            "one-of-two-parts",
            "one of two ropes parts, the weight swings on the other for 2.5 s at dt 0.005 s: "
            "distance from SciPy over the half distance of the ropes",
            0.01,
            "relative",
            "distance",
            between_two(),
            0.005,
            3.0,
            exact=swing,
            size=ASIDE,
        ),
    ]
