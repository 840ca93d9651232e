"""Runs with an accuracy on random or packaged scenes against runs with one far smaller, and how far stated errors hold.

    python benchmarks/random_scenes.py --seeds 0:20 --out benchmarks/results/random_scenes.json
    python benchmarks/random_scenes.py --packaged --out benchmarks/results/packaged_scenes.json

A random scene has 1 to 4 lines, rigid or elastic, half of the ropes without internal damping; a float or a load where
they meet, seabed, current, waves, a released end, an end that moves. Its draw follows from the seed alone.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import dropper_jax as dj
from dropper_jax.base.errors import SceneError
from dropper_jax.run.stated_errors import MISSED
from dropper_jax.scene import whole_lines

Scene = dict[str, Any]
#: Distance of two runs as a fraction of the travel from which they are different motions.
PARTED = 0.1
#: Tension [N] below which a scene has none.
SMALLEST = 1e-6
#: Error of a tension over the largest one that is rounding.
ROUNDING = 1e-6
#: Windows of a run whose maxima are compared.
WINDOWS = 4


def draw_scene(seed: int) -> Scene:
    """The scene of a seed."""
    rng = np.random.default_rng(570_000 + seed)
    count = int(rng.integers(1, 5))
    depth = float(rng.uniform(8.0, 40.0))
    effects: Scene = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.4, "cdt": 0.05}}
    sea: Scene = {"depth": depth}
    points, lines = _single(rng) if count == 1 else _system(rng, count, depth)
    if count > 1 and rng.random() < 0.6:
        effects["seabed"] = {}
    if rng.random() < 0.5:
        sea["current"] = {"kind": "power", "speed": float(rng.uniform(0.05, 0.8)), "direction": _angle(rng)}
    if rng.random() < 0.6:
        sea["packaged"] = "regular-case-1"
    if rng.random() < 0.3:
        amplitude = [float(rng.uniform(0.02, 0.3)), 0.0, float(rng.uniform(0.02, 0.3))]
        effects["end_motion"] = {"point": "a0", "amplitude": amplitude, "period": float(rng.uniform(2.0, 8.0))}
    run = {"accuracy": 0.01, "save_interval": 0.02, "duration": 6.0}
    return {"run": run, "point": points, "line": lines, "effects": effects, "sea": sea}


def _angle(rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, 2.0 * np.pi))


def _line(rng: np.random.Generator, name: str, ends: tuple[str, str], distance: float, rope: bool) -> Scene:
    links = int(rng.integers(3, 14))
    length = distance * float(rng.uniform(1.005, 1.4)) / links
    per_metre = float(np.exp(rng.uniform(np.log(0.2), np.log(20.0))))
    diameter = 0.02 + 0.02 * float(np.sqrt(per_metre))
    line = {"name": name, "from": ends[0], "to": ends[1], "links": links, "length": length}
    line |= {"mass": per_metre * length, "diameter": diameter}
    if rope:
        stiffness = float(np.exp(rng.uniform(np.log(1e4), np.log(1e7))))
        damping = stiffness * float(rng.choice([0.0, 0.0, 1e-3, 1e-2]))
        line["axial"] = {"law": "rope", "EA": stiffness, "damping": damping}
    return line


def _single(rng: np.random.Generator) -> tuple[list[Scene], list[Scene]]:
    """One line between two points, or with a free end that is released."""
    far = float(rng.uniform(1.0, 4.0))
    other: Scene = {"name": "b", "position": [far, 0.0, -1.0]}
    if rng.random() < 0.4:
        other["kind"] = "free"
    points = [{"name": "a0", "position": [0.0, 0.0, -1.0]}, other]
    return points, [_line(rng, "l0", ("a0", "b"), far, bool(rng.random() < 0.5))]


def _system(rng: np.random.Generator, count: int, depth: float) -> tuple[list[Scene], list[Scene]]:
    """Lines from anchors to a hub, which starts away from its rest."""
    hub: Scene = {"name": "hub", "kind": "free", "position": [0.0, 0.0, -depth * float(rng.uniform(0.2, 0.6))]}
    if rng.random() < 0.7:
        hub |= {"mass": float(rng.uniform(5.0, 200.0)), "volume": float(rng.uniform(0.01, 0.4))}
    points = [hub]
    lines = []
    for i in range(count):
        turn = 2.0 * np.pi * i / count + float(rng.uniform(-0.3, 0.3))
        far = depth * float(rng.uniform(0.6, 2.0))
        position = [far * float(np.cos(turn)), far * float(np.sin(turn)), -depth]
        points.append({"name": f"a{i}", "position": position})
        distance = float(np.linalg.norm(np.subtract(hub["position"], position)))
        lines.append(_line(rng, f"l{i}", (f"a{i}", "hub"), distance, rope=bool(rng.random() < 0.9) or i == 0))
    return points, lines


def compare(run: dj.Solution, exact: dj.Solution, chaotic_from: float | None) -> dict[str, Any]:
    """Errors of a run: positions over the travel, means, deviations and window maxima over those of the line.

    Positions are compared until both runs are different motions, or until the time [s] from which the run is chaotic.
    """
    travel = max(float(np.linalg.norm(np.ptp(exact.positions, axis=0), axis=1).max()), 1e-3)
    apart = np.linalg.norm(run.positions - exact.positions, axis=2).max(axis=1) / travel
    if np.any(apart > PARTED):
        parted = int(np.argmax(apart > PARTED))
    else:
        parted = len(apart)
    if chaotic_from is not None:
        parted = min(parted, int(np.searchsorted(run.t, chaotic_from)))
    found: dict[str, Any] = {
        "positions": float(np.sqrt(np.mean(apart[:parted] ** 2))),
        "parted_s": None if parted == len(apart) else float(run.t[parted]),
    }
    mean = []
    deviation = []
    maximum = []
    largest = max(float(exact.tension_max.max()), SMALLEST)
    for line in whole_lines(run.scene):
        links = line.links
        link = links.start + int(np.argmax(exact.tension_max[:, links].max(axis=0)))
        both = [_statistics(one, link) for one in (run, exact)]
        scale = max(abs(both[1][0]) + both[1][1], 0.1 * largest)
        mean.append(abs(both[0][0] - both[1][0]) / scale)
        deviation.append(abs(both[0][1] - both[1][1]) / scale)
        tops = [
            np.array([part.max() for part in np.array_split(one.tension_max[1:, link], WINDOWS)])
            for one in (run, exact)
        ]
        maximum.append(float(np.max(np.abs(tops[0] - tops[1]) / np.maximum(tops[1], 0.1 * largest))))
    return found | {"mean": max(mean), "deviation": max(deviation), "maximum": max(maximum)}


def covered(row: dict[str, Any], exact: dj.Solution) -> Iterator[tuple[str, float]]:
    """Kind of each stated error, and the true error over it; below the accuracy's rounding they count as equal."""
    if row.get("stated_positions"):
        yield "positions", row["positions"] / row["stated_positions"]
    largest = max(float(exact.tension_max.max()), SMALLEST)
    for line, stated in zip(whole_lines(exact.scene), row.get("stated_lines", []), strict=False):
        link = line.links.start + stated["link"] - 1
        mean, deviation = _statistics(exact, link)
        top = float(exact.tension_max[:, link].max())
        for kind, value in (("mean", mean), ("deviation", deviation), ("maximum", top)):
            error = abs(stated[f"{kind}_n"] - value)
            yield kind, error / max(stated[f"{kind}_error_n"], ROUNDING * largest)


def _statistics(run: dj.Solution, link: int) -> tuple[float, float]:
    mean = float(np.mean(run.tension[1:, link]))
    return mean, float(np.sqrt(max(np.mean(run.tension_square[1:, link]) - mean**2, 0.0)))


def judge(name: int | str, scene: Scene | str, reference: float) -> dict[str, Any]:
    """One row: a scene that follows an accuracy of 0.01, named by its seed or its packaged name."""
    started = time.perf_counter()
    row: dict[str, Any] = {"scene": name, "lines": len(dj.load_scene(scene).lines)}
    try:
        run = dj.simulate(scene, companion="coarser")
        exact = dj.simulate(scene, accuracy=reference)
    except SceneError as error:
        return row | {"status": "refused", "reason": str(error)}
    row |= {"status": run.status, "reason": run.failure, "warnings": list(run.warnings), "exact": exact.status}
    row |= {"steps": run.settings["steps"], "refused": run.settings["refused_steps"]}
    row["ringing"] = run.axial_ringing_share
    if "stated_errors" in run.settings:
        stated = run.settings["stated_errors"]
        row["stated_positions"] = stated["positions"]
        row["stated_lines"] = stated["lines"]
        row["chaotic_from_s"] = stated["chaotic_from_s"]
    if run.status == "ok" and exact.status == "ok":
        row |= compare(run, exact, row.get("chaotic_from_s"))
        row["covered"] = list(covered(row, exact))
    return row | {"seconds": time.perf_counter() - started}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:20", help="FIRST:LAST")
    parser.add_argument("--packaged", action="store_true", help="packaged scenes in place of random ones")
    parser.add_argument("--only", nargs="*", help="packaged scenes of these names")
    parser.add_argument("--reference", type=float, default=1e-4, help="accuracy of the run compared with")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.packaged:
        names = args.only or dj.scene_names()
        scenes = {name: name for name in names}
    else:
        first, last = map(int, args.seeds.split(":"))
        scenes = {seed: draw_scene(seed) for seed in range(first, last)}
    rows = []
    for name, scene in scenes.items():
        rows.append(judge(name, scene, args.reference))
        print(json.dumps(rows[-1]), flush=True)
    good = [row for row in rows if "positions" in row and row["parted_s"] is None]
    limit = MISSED * 0.01
    off = [row["scene"] for row in good if max(row["positions"], row["mean"]) > limit]
    peaks = [row["scene"] for row in good if row["maximum"] > limit]
    print(f"{len(rows)} scenes, {len(good)} compared; positions or means off: {off}; window maxima off: {peaks}")
    if args.out is not None:
        args.out.write_text(json.dumps({"reference": args.reference, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
