"""What grows over a run, as `sensitivity` reports it, on eleven scenes whose motion is known beforehand.

    python benchmarks/growth.py --out benchmarks/results/growth.json

A chaotic motion makes changes of engineering size grow (0.3 % of a parameter, 1 % for rigid lines); a tangent that
grows alone makes only small ones grow (1e-6, or exact derivatives of rigid lines). Both are powers of e. `expected`
follows from what the scene is, not from a run: double pendulums and slowly whirling chains thrown from the horizontal
are chaotic; moored ropes in waves are not, but derivatives grow while links are slack, and not before the waves rose.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from slopes import random_scene

from dropper_jax.base.json_values import jsonable
from dropper_jax.load.scene import Scene, load_scene
from fitting.sensitivity import local_derivatives, study

#: Packaged scenes: duration [s], equal steps [s] in place of an accuracy, quantity, parameter, what grows.
PACKAGED: list[tuple[str, float, float | None, str, str, str]] = [
    ("double-pendulum-chaotic", 15.0, None, "angle.2.mean", "line.0.mass.1", "motion"),
    ("double-pendulum-periodic", 10.0, None, "angle.2.mean", "line.0.mass.1", "nothing"),
    ("dropper-release-a", 1.0, None, "tension.mean", "line.0.mass.3", "nothing"),
    ("edulis-longline", 15.0, None, "tension.west-leg.mean", "sea.current.speed", "nothing"),
    ("edulis-longline", 35.0, 0.03, "tension.west-leg.mean", "sea.current.speed", "tangent"),
    ("paper-case-1", 20.0, None, "tension.chain.mean", "buoy.spar.mass", "tangent"),
    ("paper-case-1", 20.0, 0.02, "tension.chain.mean", "buoy.spar.mass", "tangent"),
]
#: Seed of a storm of slack ropes.
STORM = 5013


def thrown(links: int, length: float, mass: list[float], polar: float, rate: float, duration: float) -> Scene:
    """A chain of ropes that hangs from a point, without water, thrown: all links with a polar angle [rad] from the
    vertical, and a rate [rad/s] around it."""
    rope = {"law": "rope", "EA": 2e5, "damping": 200.0}
    line = {"name": "l", "from": "top", "to": "end", "links": links, "length": length, "mass": mass, "axial": rope}
    table = {
        "run": {"accuracy": 0.01, "save_interval": 0.02, "duration": duration},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "end", "kind": "free", "position": [links * length, 0.0, 0.0]},
        ],
        "line": [line],
        "effects": {"weight": {}},
        "start": {
            "kind": "angles",
            "zero": "down",
            "polar": [polar] * links,
            "azimuth_rate": [rate] * links,
        },
    }
    return load_scene(table)


def cases() -> Iterator[tuple[str, Scene, str, str, str]]:
    """Name, scene, quantity, parameter and what is expected to grow."""
    for name, duration, dt, of, to, expected in PACKAGED:
        values: dict[str, Any] = {"run.duration": duration}
        label = name
        if dt is not None:
            values["run.dt"] = dt
            label = f"{name}, equal steps of {dt:g} s"
        yield label, load_scene(name).with_values(values), of, to, expected
    double = thrown(2, 1.0, [1.0, 0.2], 1.5707963267948966, 0.5, 20.0)
    yield "double pendulum of ropes", double, "tension.1.mean", "line.0.mass.1", "motion"
    for rate, expected in ((0.5, "motion"), (2.0, "nothing")):  # the fast one stays taut and straight
        whirling = thrown(8, 0.5, [0.5] * 8, 1.5707963267948966, rate, 30.0)
        yield f"chain of ropes, whirling at {rate:g} rad/s", whirling, "tension.1.mean", "line.0.mass.3", expected
    yield "storm of slack ropes", random_scene(STORM)[0], "tension.l0.mean", "parameters.mass", "tangent"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of cases, from 0")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    rows = []
    for i, (name, scene, of, to, expected) in enumerate(cases()):
        if args.only is not None and i not in args.only:
            continue
        started = time.perf_counter()
        found = local_derivatives(study(scene, of, [to]))
        row = {"scene": name, "duration": found.duration, "of": of, "to": to, "method": found.method}
        row |= {"tangent": found.growth, "motion": found.motion_growth, "grows": found.grows, "expected": expected}
        row |= {"slope": found.scaled[0], "status": found.slope_status[0], "seconds": time.perf_counter() - started}
        rows.append(jsonable(row))
        print(json.dumps(rows[-1]), flush=True)
        if args.out is not None:
            args.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
