"""Ropes that go slack, tauten and snap, and links of very unequal stiffness, against closed forms and SciPy."""

from itertools import pairwise
from typing import Any

import numpy as np
from hard_scenes import G, weight_on_rope
from rows import exact, path, row, steps
from scipy.integrate import solve_ivp

from dropper_jax.load.scene import Scene, load_scene

MASS, LENGTH = 100.0, 2.0
#: A fall [m] to 6 m/s into a rope with this period [s]: it is taut for 4 ms.
SNAP_FALL, SNAP = 1.9, 0.008


def falling(fall: float, period: float) -> Scene:
    """A weight that falls before its rope tautens, on which it would swing with a period [s]."""
    return weight_on_rope("slack-to-taut", MASS, MASS * (2 * np.pi / period) ** 2, LENGTH, LENGTH - fall)


def _stretch(fall: float, period: float) -> float:
    """Greatest stretch `m g/k + sqrt((m g/k)^2 + 2 m g fall/k)` [m]."""
    rest = G / (2 * np.pi / period) ** 2
    return rest + np.sqrt(rest**2 + 2 * rest * fall)


def _snap_tension() -> float:
    """Largest tension `m g + sqrt((m g)^2 + k m v^2)` [N]."""
    return MASS * (2 * np.pi / SNAP) ** 2 * _stretch(SNAP_FALL, SNAP)


#: A rope of several links: the masses of its nodes [kg] and of the weight, stiffness of a link [N/m].
LINKS, NODE, SPRING = 4, 1.0, 4e5


def slack_rope() -> Scene:
    """A weight on links with masses between that all are slack at first; all fall and snap taut in turn."""
    names = ["top", *(f"node-{i}" for i in range(1, LINKS)), "weight"]
    each = LENGTH / LINKS
    points = [
        {"name": name, "kind": "free", "position": [0.0, 0.0, -0.9 * each * i], "mass": NODE}
        for i, name in enumerate(names)
    ]
    points[0] = {"name": "top", "position": [0.0, 0.0, 0.0]}
    points[-1]["mass"] = MASS
    return load_scene(
        {
            "name": "snapping-rope",
            "run": {"dt": 0.002, "duration": 0.3},
            "line_type": [{"name": "rope", "mass": 1e-6, "diameter": 0.01, "EA": SPRING * each}],
            "point": points,
            "line": [
                {"name": f"link-{i}", "from": start, "to": end, "type": "rope", "length": each, "links": 1}
                for i, (start, end) in enumerate(pairwise(names))
            ],
            "effects": {"weight": {"gravity": G}},
            "start": {"kind": "points"},
        }
    )


def _rope_by_scipy(t: np.ndarray) -> np.ndarray:
    """Height of the weight: point masses on springs that do not push, all on one vertical line."""
    mass = np.array([NODE] * (LINKS - 1) + [MASS])
    each = LENGTH / LINKS

    def fall(_: float, y: np.ndarray) -> np.ndarray:
        z, v = y[:LINKS], y[LINKS:]
        d = np.diff(np.concatenate([[0.0], z]))
        force = SPRING * np.maximum(np.abs(d) - each, 0.0) * np.sign(d)
        return np.concatenate([v, -G - (force - np.append(force[1:], 0.0)) / mass])

    start = np.concatenate([-0.9 * each * np.arange(1, LINKS + 1), np.zeros(LINKS)])
    return solve_ivp(fall, (0.0, t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-10, max_step=2e-4).y[LINKS - 1]


#: Soft link above a stiff one: stiffness [N/m], masses [kg].
SOFT, STIFF, ABOVE, BELOW, EACH = 2000.0, 2e7, 10.0, 50.0, 5.0
SWING = 0.2


def stiffness_ratio() -> Scene:
    """Two weights, the lower one on a link 1e4 times as stiff as that of the upper one, released below their
    equilibrium."""
    top = EACH + (ABOVE + BELOW) * G / SOFT + SWING
    low = top + EACH + BELOW * G / STIFF
    kind = {"mass": 1e-6, "diameter": 0.01}
    ends = [("soft", "top", "between"), ("stiff", "between", "weight")]
    return load_scene(
        {
            "name": "stiffness-ratio",
            "run": {"dt": 0.005, "duration": 5.0},
            "line_type": [{"name": "soft", "EA": SOFT * EACH, **kind}, {"name": "stiff", "EA": STIFF * EACH, **kind}],
            "point": [
                {"name": "top", "position": [0.0, 0.0, 0.0]},
                {"name": "between", "kind": "free", "position": [0.0, 0.0, -top], "mass": ABOVE},
                {"name": "weight", "kind": "free", "position": [0.0, 0.0, -low], "mass": BELOW},
            ],
            "line": [
                {"name": name, "from": start, "to": end, "type": name, "length": EACH, "links": 1}
                for name, start, end in ends
            ],
            "effects": {"weight": {"gravity": G}},
            "start": {"kind": "points"},
        }
    )


def _modes(t: np.ndarray) -> np.ndarray:
    """Height of the lower weight above its start, from the two normal modes."""
    stiffness = np.array([[SOFT + STIFF, -STIFF], [-STIFF, STIFF]])
    root = np.sqrt([ABOVE, BELOW])
    squares, shapes = np.linalg.eigh(stiffness / np.outer(root, root))
    start = shapes.T @ (root * np.array([-SWING, -SWING]))
    return (shapes @ (start[:, None] * np.cos(np.sqrt(squares)[:, None] * t)) / root[:, None])[1] + SWING


def cases() -> list[dict[str, Any]]:
    """Rows of the list."""
    falls = falling(0.2, 0.2)
    snaps = falling(SNAP_FALL, SNAP)
    # Saved every 20 ms; steps follow the snap within.
    followed = {"settings": {"accuracy": 0.01}}
    in_turn = exact(steps(0.002, 0.3), _rope_by_scipy)
    modes = exact(steps(0.005, 5.0), _modes)

    return [
        path(
            "slack-taut-stretch",
            "a weight falls 0.2 m into its rope, 10 steps in tension: error of the greatest stretch",
            0.02,
            "relative",
            "lowest",
            falls,
            0.01,
            12.0,
            level=-LENGTH,
            size=_stretch(0.2, 0.2),
        ),
        path(
            "slack-taut-return",
            "the same: what is missing of the height it comes back to",
            0.02,
            "of the fall",
            "return",
            falls,
            0.01,
            12.0,
            size=0.2,
        ),
        path(
            "slack-taut-coarse",
            "the same for 60 s at steps of half the time in tension, which the status reports: maximum height above "
            "its release height",
            1e-9,
            "m",
            "rise",
            falls,
            0.05,
            60.0,
            expected="step_too_long",
        ),
        row(
            "snap-peak",
            "a weight of 100 kg snaps a rope taut within 4 ms at 6 m/s, steps follow within 20 ms: error of "
            "the largest tension",
            0.01,
            "relative",
            "peak",
            snaps,
            0.02,
            1.3,
            size=_snap_tension(),
            **followed,
        ),
        path(
            "snap-return",
            "the same: what is missing of the height it comes back to",
            0.02,
            "of the fall",
            "return",
            snaps,
            0.02,
            1.3,
            size=SNAP_FALL,
            **followed,
        ),
        path(
            "snapping-rope",
            "a weight on four links with masses between, snapped taut one after another, dt 0.002 s: "
            "distance of the weight from SciPy over its fall",
            0.02,
            "relative",
            "distance",
            slack_rope(),
            0.002,
            0.3,
            exact=in_turn,
            size=0.1 * LENGTH,
        ),
        path(
            "stiffness-ratio",
            "a link 1e4 times as stiff as its neighbour, its swing 8 radians in a step: distance from "
            "the normal modes over the swing",
            0.01,
            "relative",
            "distance",
            stiffness_ratio(),
            0.005,
            5.0,
            exact=modes,
            from_start=True,
            size=SWING,
        ),
    ]
