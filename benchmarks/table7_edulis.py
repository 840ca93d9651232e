"""The Edulis longline in MoorDyn v2, on the file written of its scene, and here: tensions and motions with errors.

Both codes get the scene turned by 90 degrees: waves then travel in +x and MoorDyn can take its wave grid, in which
buoys feel the dynamic pressure. Both start from the static pose found here.
"""

from collections.abc import Callable

import numpy as np
from moordyn_runs import looks_at
from study import Found

import dropper_jax as dj
from dropper_jax.scene.data import point_nodes
from dropper_jax.study.load_errors import load_errors

SPAN, SKIP, BATCHES = 150.0, 30.0, 8
#: MoorDyn's steps [s]; the second tells the first one's error.
STEPS = (0.0005, 0.00025)
LOOK = 0.03
#: Lines whose ends are compared, whether it is the last end, and points that are followed.
ENDS = (
    ("west leg at the Danforth anchor", "west-leg", False),
    ("west leg at the buoy", "west-leg", True),
    ("backbone at the west buoy", "backbone-1", False),
    ("backbone in the middle", "backbone-5", True),
    ("first sock at the buoy", "sock-1", False),
    ("middle sock at the backbone", "sock-5", False),
)
POINTS = (("west buoy", "west-buoy"), ("middle of the backbone", "v5"))
AXES = ("along the waves", "across the waves", "up")
#: Runs of `load_errors` in their order.
RUNS = ("1", "2", "4", "perturbed", "links", "twice_damping", "twice_bed")


def turned() -> dj.Scene:
    """`edulis-longline`, turned by 90 degrees (x' = -y, y' = x), from its static pose."""
    scene = dj.load_scene("edulis-longline")
    table = scene.to_dict()
    table["sea"]["waves"]["direction"] = 0.0
    table["sea"]["current"]["direction"] = 0.0
    for point in table["point"]:
        x, y, z = point["position"]
        point["position"] = [-y, x, z]
    scene = dj.Scene.from_dict(table)
    pose = dj.equilibrium(scene)
    nodes = point_nodes(scene)
    for point in table["point"]:
        if point["kind"] == "free":
            point["position"] = np.asarray(pose.positions)[nodes[point["name"]]].tolist()
    return dj.Scene.from_dict({**table, "start": {"kind": "points"}, "run": {**table["run"], "duration": SPAN}})


def series_here(run: dj.Solution) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times [s] and values over time by name: tensions of end links [N], places of points [m]."""
    links = {line.name: line.links for line in run.lines}
    nodes = point_nodes(run.scene)
    found = {name: run.tension[:, links[line].stop - 1 if last else links[line].start] for name, line, last in ENDS}
    for name, point in POINTS:
        found.update({f"{name}, {axis}": run.positions[:, nodes[point], i] for i, axis in enumerate(AXES)})
    return run.t, found


def series_there(scene: dj.Scene, dt: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The same in MoorDyn."""
    number = {line.name: i + 1 for i, line in enumerate(scene.lines)}
    ends = [(number[line], last) for _, line, last in ENDS]
    points = [(next(number[line.name] for line in scene.lines if line.end == point), True) for _, point in POINTS]
    seen = looks_at(scene, dt, SPAN, LOOK, ends, points, across=(-60, 120), waveKin_rampT=0.0)
    if seen.status != "ok":
        raise ArithmeticError(f"MoorDyn at {dt:g} s: {seen.status}")
    found = {name: np.abs(seen.tension[:, i]) for i, (name, *_) in enumerate(ENDS)}
    for j, (name, _) in enumerate(POINTS):
        found.update({f"{name}, {axis}": seen.position[:, j, i] for i, axis in enumerate(AXES)})
    return seen.t, found


def batch_error(values: np.ndarray, of: Callable[[np.ndarray], float]) -> float:
    """Standard error of a statistic of a series, by batches."""
    return float(np.std([of(part) for part in np.array_split(values, BATCHES)], ddof=1) / np.sqrt(BATCHES))


def statistics(t: np.ndarray, found: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Mean, deviation and largest after `SKIP`, and standard errors of the first two."""
    settled = {name: values[t > SKIP] for name, values in found.items()}
    return {
        name: {
            "mean": float(kept.mean()),
            "deviation": float(kept.std()),
            "max": float(kept.max()),
            "mean_chance": batch_error(kept, np.mean),
            "deviation_chance": batch_error(kept, np.std),
        }
        for name, kept in settled.items()
    }


def edulis() -> Found:
    """Statistics of both codes, ours with errors by step and links, MoorDyn's by its step."""
    scene = turned()
    there = [statistics(*series_there(scene, dt)) for dt in STEPS]
    made = {}
    order = iter(RUNS)

    def run(variant: dj.Scene) -> dj.Solution:
        solution = dj.simulate(variant)
        made[next(order)] = statistics(*series_here(solution))
        return solution

    load_errors(scene, run, SKIP)
    rows = [_row(name, made, there) for name in made["1"]]
    return {"span_s": SPAN, "skip_s": SKIP, "dt_s": scene.run.dt, "moordyn_dt_s": list(STEPS), "rows": rows}


def _row(name: str, made: Found, there: list[Found]) -> Found:
    row = {"name": name}
    for what in ("mean", "deviation", "max"):
        steps = [made[key][name][what] for key in ("1", "2", "4")]
        first, second = (found[name][what] for found in there)
        row[what] = {
            "here": steps[0],
            "step": max(steps) - min(steps),
            "links": 4.0 / 3.0 * abs(made["links"][name][what] - steps[0]),  # second order
            "chance": made["1"][name].get(f"{what}_chance"),
            "moordyn": first,
            "moordyn_step": abs(first - second),
        }
    return row
