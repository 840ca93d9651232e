"""Impact on the seabed, slopes, and stick-slip friction, compared with closed forms."""

from typing import Any

import numpy as np
from hard_scenes import BED, THICK, THREAD, G, weight_on_rope, weight_on_thread
from rows import exact, path

from dropper_jax.load.scene import Scene

MASS = 50.0
#: Impact [m/s] and the height it takes [m].
SPEED = 8.9
FALL = SPEED**2 / (2 * G)
#: Contact time of a weight with the seabed of the impact [s], and the seabed stiffness under a weight [N/m].
TOUCH = 0.04
HARD = MASS * (np.pi / TOUCH) ** 2
AREA = 0.5 * THREAD * THICK

#: The slope falls by 1 in 2 along +x.
SLOPE = 0.5
DOWN = np.array([1.0, 0.0, -SLOPE]) / np.hypot(1.0, SLOPE)
STEEP = float(np.arctan(SLOPE))
#: Stiffness of the sliding seabeds under a weight [N/m], and their damping [N s/m].
FIRM, DULL = 1e6, 1e4


def dropped_weight() -> Scene:
    """A weight that falls onto a seabed without damping."""
    bed = {"seabed": {"depth": BED, "stiffness": HARD / AREA, "damping": 0.0}}
    return weight_on_thread("bed-impact", {"mass": MASS}, [0.0, 0.0, FALL - BED], bed)


def _deepest() -> float:
    """Greatest depth in the seabed `p = m g/k + sqrt((m g/k)^2 + m v^2/k)` [m]."""
    rest = MASS * G / HARD
    return rest + np.sqrt(rest**2 + MASS * SPEED**2 / HARD)


def sloping(friction: float | None) -> Scene:
    """A weight released on a slope."""
    position = (2.0 * DOWN + np.array([0.0, 0.0, -BED])).tolist()
    bed: dict[str, Any] = {
        "seabed": {
            **{"stiffness": FIRM / AREA, "damping": DULL / AREA, "bed_x": [0.0, 100.0], "bed_y": [-5.0, 5.0]},
            "bed_depth": [BED, BED, BED + 100.0 * SLOPE, BED + 100.0 * SLOPE],
        }
    }
    if friction is not None:
        bed["seabed_friction"] = {"kinetic": friction}
    return weight_on_thread("slope", {"mass": MASS}, position, bed)


def _slid(friction: float | None, duration: float) -> dict[str, list]:
    """Distance after the run, `g (sin - mu cos) t^2/2` [m]."""
    force = G * (np.sin(STEEP) - (friction or 0.0) * np.cos(STEEP))
    return exact(np.array([duration]), lambda t: 0.5 * force * t**2, digits=17)


#: The sledge: stiffness of its spring [N/m], speed of the spring end [m/s], static and kinetic friction.
SPRING, PULLED, STATIC, KINETIC = 5000.0, 0.05, 0.5, 0.3
STRETCH = STATIC * MASS * G / SPRING
#: Half of the slip distance in the limit of slow motion [m].
HALF = (STATIC - KINETIC) * MASS * G / SPRING


def sledge() -> Scene:
    """A weight on the seabed, pulled by a spring whose other end moves at constant speed."""
    length = 5.0
    bed = {
        "seabed": {"depth": BED, "stiffness": FIRM / (0.5 * length * 0.01), "damping": DULL / (0.5 * length * 0.01)},
        "seabed_friction": {"kinetic": KINETIC, "static": STATIC},
        "end_motion": {"point": "top", "time": [0.0, 100.0], "displacement": [[0.0] * 3, [100.0 * PULLED, 0.0, 0.0]]},
    }
    table = weight_on_rope("stick-slip", MASS, SPRING, length, length, effects=bed).to_dict()
    table["point"][0]["position"], table["point"][1]["position"] = [0.0, 0.0, -BED], [-length, 0.0, -BED]
    return Scene.from_dict(table)


def _sledge_path(t: np.ndarray) -> np.ndarray:
    """Where the sledge is [m] after the start: it waits while the spring stretches, then

    stretch = kinetic part + HALF cos w s + V/w sin w s,    until its speed V (1 - cos w s) + HALF w sin w s is zero.
    """
    w = np.sqrt(SPRING / MASS)
    slip = 2 * (np.pi - np.arctan(HALF * w / PULLED)) / w
    found, position, begin = np.zeros_like(t), 0.0, STRETCH / PULLED
    while begin < t[-1]:
        s = np.clip(t - begin, 0.0, slip)
        way = PULLED * (s - np.sin(w * s) / w) + HALF * (1.0 - np.cos(w * s))
        found = np.where(t > begin, position + way, found)
        position += PULLED * slip + 2 * HALF
        begin += slip + 2 * HALF / PULLED
    return found


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    # The sledge waits at these times, after four slips and after eight [s].
    waits = np.array([4.8, 9.6])
    slid = exact(waits, np.array([_sledge_path(np.array([t]))[-1] for t in waits]))
    slopes = {"point": "weight", "weights": DOWN.tolist()}
    along = [1.0, 0.0, 0.0]

    return [
        path(
            "bed-impact-depth",
            f"{MASS:g} kg hit the bed at {SPEED:g} m/s, no damping, 20 steps in contact: error of the greatest depth",
            0.01,
            "relative",
            "lowest",
            dropped_weight(),
            0.002,
            2.0,
            level=-BED,
            size=_deepest(),
        ),
        path(
            "bed-impact-rebound",
            "the same: error of the height it comes back to",
            0.01,
            "relative",
            "return",
            dropped_weight(),
            0.002,
            2.0,
            size=FALL,
        ),
        path(
            "bed-impact-coarse",
            "the same, bouncing for 50 s at steps longer than it touches the seabed: maximum "
            "height above its release height",
            1e-9,
            "m",
            "rise",
            dropped_weight(),
            0.05,
            50.0,
        ),
        path(
            "slope-smooth",
            "a weight slides down a slope of 1 in 2 without friction, 3 s at dt 0.01 s: error of the distance",
            0.01,
            "relative",
            "way",
            sloping(None),
            0.01,
            3.0,
            exact=_slid(None, 3.0),
            **slopes,
        ),
        path(
            "slope-rough",
            "the same with friction 0.2",
            0.01,
            "relative",
            "way",
            sloping(0.2),
            0.01,
            3.0,
            exact=_slid(0.2, 3.0),
            **slopes,
        ),
        path(
            "slope-lets-go",
            "the same with 0.99 of the friction that would hold it, 6 s at dt 0.01 s",
            0.01,
            "relative",
            "way",
            sloping(0.99 * SLOPE),
            0.01,
            6.0,
            exact=_slid(0.99 * SLOPE, 6.0),
            **slopes,
        ),
        path(
            "slope-holds",
            "the same with 1.01 of the friction that holds it, 15 s at dt 0.05 s: movement after the first second",
            1e-9,
            "m",
            "late motion",
            sloping(1.01 * SLOPE),
            0.05,
            15.0,
        ),
        path(
            "stick-slip",
            "a weight on the bed pulled by a spring sticks and slips eight times in 9.6 s, dt 0.002 s: "
            "error of the way",
            0.01,
            "relative",
            "way",
            sledge(),
            0.002,
            9.6,
            4.8,
            exact=slid,
            weights=along,
        ),
    ]
