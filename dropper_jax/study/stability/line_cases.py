"""Lines in contact and torsion: a rope that falls onto another stays above it without energy gain; twist oscillates
undamped."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from dropper_jax.load.scene import Scene, load_scene
from dropper_jax.run.simulate import Solution, simulate
from dropper_jax.study.stability.case import Case, Outcome
from dropper_jax.study.stability.scenes import G

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


@cache
def _fallen(short: bool) -> Solution:
    return simulate(falling_rope(), duration=0.8 if short else 4.0)


def _crossing_outcome(short: bool) -> Outcome:
    """1 where the ropes are above each other in two rows of the run and have changed sides in between.

    The weight bounces off sideways, round the end of the lower rope: if it is below this rope later, it has not passed
    through it.
    """
    ran = _fallen(short)
    low, *high = (ran.positions[:, line.nodes] for line in ran.lines)
    above = [_above(np.concatenate([a, b[1:]]), c) for a, b, c in zip(*high, low, strict=True)]
    sides = [(np.min(one), np.max(one)) for one in above if one.size]
    rows = zip(sides, sides[1:], np.diff(np.flatnonzero([one.size for one in above])) == 1, strict=False)
    passed = any(next_to and (a[0] > 0.0 > b[1] or b[0] > 0.0 > a[1]) for a, b, next_to in rows)
    return Outcome(float(passed), ran.status)


def _above(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """How far a rope (nodes, 3) is above another where they cross as seen from above [m]."""
    (a, d), (c, e) = ((rope[:-1, None], np.diff(rope, axis=0)[:, None]) for rope in (high, low))
    c, e = np.swapaxes(c, 0, 1), np.swapaxes(e, 0, 1)
    turn = lambda p, q: p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]  # noqa: E731
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = turn(c - a, e) / turn(d, e), turn(c - a, d) / turn(d, e)
    height = (a[..., 2] + s * d[..., 2]) - (c[..., 2] + t * e[..., 2])
    return height[(s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)]


def _energy_gain(short: bool) -> Outcome:
    ran = _fallen(short)
    return Outcome(max(float(np.max(np.diff(ran.balance))), 0.0) / ran.energy_scale, ran.status)


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


def _twist(short: bool) -> Outcome:
    """Error of what the rod has of `sin(pi s/(2 L))`, `a (1 - cos(omega t))`, a = 8 T L/(GJ pi^2), of its largest."""
    ran = simulate(twisted_rod(), duration=0.8 if short else 4.0)
    weight = np.ones(41)
    weight[[0, -1]] = 0.5
    share = ran.twist @ (weight * np.sin(0.5 * np.pi * np.arange(41) / 40)) / 20
    holds, omega = 8.0 * MOMENT * LONG / (STIFF * np.pi**2), 0.5 * np.pi * np.sqrt(STIFF / HEAVY) / LONG
    error = np.max(np.abs(share - holds * (1.0 - np.cos(omega * ran.t))))
    return Outcome(float(error) / (2.0 * holds), ran.status)


CASES = [
    Case("rope-on-rope", "5 kg in a slack rope fall 1 m onto a rope across, by three radii per step of 0.02 s: passes "
         "it (1) or not (0)", 0.0, "-", _crossing_outcome),
    Case("rope-on-rope-energy", "the same, undamped: energy gained in any step beyond what "
         "weights do", 1e-9, "of the scale", _energy_gain),
    Case("twisted-rod", "a moment put on the end of a rod at once, 5 periods of twist at dt 0.002 s: error of the "
         "first shape", 0.01, "of the largest", _twist),
]  # fmt: skip
