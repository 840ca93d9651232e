"""Warnings of lines with too few links: random single lines at rest against the same lines with 48 links.

    python benchmarks/coarse_lines.py [--draws 140] [--seed 10]

Each line hangs between two fixed points in calm water or in a current, with 3, 4, 6 or 12 links. Its error is the
larger of those of the forces at its ends. Takes about a minute. Writes results/coarse_lines.json; the limits of the
warning were chosen with the seeds 7 to 9.
"""

import numpy as np
from study import Found, Rows, collect, command, table_of

from dropper_jax import Scene, equilibrium, load_scene
from dropper_jax.plausibility.pose_remarks import pose_remarks
from dropper_jax.quantities.end_forces import end_forces

LINKS = (3, 4, 6, 12)
FINE = 48
#: Classes of errors: a warning is due in the last one, and a false alarm in the first.
CLASSES = {"below 1 %": (0.0, 0.01), "1 to 5 %": (0.01, 0.05), "above 5 %": (0.05, np.inf)}


@table_of("coarse_lines")
def coarse_lines(found: Found) -> Rows:
    """Lines and warnings by error."""
    rows = [("error of end forces", "lines", "warned")]
    for name, (low, high) in CLASSES.items():
        own = [row["warned"] for row in found["rows"] if low <= row["error"] < high]
        rows.append((name, str(len(own)), str(sum(own))))
    return rows


def drawn(rng: np.random.Generator) -> tuple[int, Found]:
    """Number of links and the values of a line."""
    links = int(rng.choice(LINKS))
    diameter = float(rng.choice([0.03, 0.05, 0.15, 0.25]))
    density = float(rng.choice([1080.0, 1300.0, 2000.0, 7000.0]))
    span = 10 ** rng.uniform(0.3, 2)
    slack = float(rng.choice([1.01, 1.05, 1.2, 1.5, 2.0, 3.0]))
    azimuth = rng.uniform(0, np.pi)
    dip = rng.uniform(-1, 1)
    along = span * np.array([np.cos(dip) * np.cos(azimuth), np.cos(dip) * np.sin(azimuth), np.sin(dip)])
    kind = {"mass": density * np.pi / 4 * diameter**2, "diameter": diameter, "EA": 1e6, "cdn": 1.3, "cdt": 0.05}
    current = max(float(rng.choice([0.0, 0.0, 0.2, 0.5, 1.0])), 1e-9)
    return links, {
        "run": {"dt": 0.05, "duration": 1.0},
        "line_type": [{"name": "rope", **kind}],
        "point": [
            {"name": "a", "position": [0.0, 0.0, -50.0]},
            {"name": "b", "position": (along + [0.0, 0.0, -50.0]).tolist()},
        ],
        "line": [{"name": "rope", "from": "a", "to": "b", "type": "rope", "length": span * slack}],
        "sea": {"depth": 200.0, "current": {"kind": "uniform", "speed": current, "direction": 0.0}},
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
    }


def at_rest(scene: Scene) -> tuple[np.ndarray, bool]:
    """Forces [N] at both ends, and whether a warning says that the links are too few."""
    pose = equilibrium(scene)
    if pose.status != "ok":
        raise ArithmeticError(pose.status)
    force = end_forces(scene, pose.positions[None], pose.tension[None])["rope"][0]
    return force, any("too few links" in text for text in pose_remarks(scene, pose.positions, pose.tension))


def compare(links: int, values: Found) -> Found:
    """A line with few links and with many."""
    (force, warned), (fine, _) = (
        at_rest(load_scene({**values, "line": [{**values["line"][0], "links": n}]})) for n in (links, FINE)
    )
    return {"links": links, "warned": warned, "error": float(np.max(np.abs(force / fine - 1.0)))}


@command(draws=140, seed=10)
def main(args) -> None:
    rng = np.random.default_rng(args.seed)
    collect("coarse_lines", {"rows": (compare(*drawn(rng)) for _ in range(args.draws))}, seed=args.seed)
