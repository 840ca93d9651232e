"""Restoring force over offset next to MoorPy's, of its sample systems and of the Edulis longline.

    python -m venv /tmp/moorpy && /tmp/moorpy/bin/pip install moorpy
    /tmp/moorpy/bin/python benchmarks/moorpy_offsets.py --reference     # writes results/moorpy_offsets.json
    python benchmarks/moorpy_offsets.py                                 # prints the difference of ours

The sample systems are those of `moorpy_stiffness.py`, their fairleads displaced together. Of `edulis-longline` the two
eastern anchors are displaced, in still water; its spars float with their waterline. The ground chains between the
anchors of one side lie on the seabed without tension and are left out of MoorPy's system.
"""

import tomllib
from pathlib import Path

import moorpy_stiffness as samples
import numpy as np
from study import Found, command, show, stored

FILE = Path(__file__).parent / "results" / "moorpy_offsets.json"
EDULIS = Path(__file__).parents[1] / "dropper_jax" / "data" / "scenes" / "edulis-longline.toml"
DENSITY, GRAVITY = samples.DENSITY, samples.GRAVITY
#: Directions [deg] and distances [m] of the curves.
DIRECTIONS = (0.0, 60.0, 120.0, 180.0)
DISTANCES = {"spread": np.arange(0.0, 25.1, 5.0), "bridles": np.arange(0.0, 5.1), "edulis": np.arange(0.0, 5.1)}


def edulis() -> Found:
    """Plain values of the Edulis longline in still water."""
    scene = tomllib.loads(EDULIS.read_text())
    scene["sea"] = {"depth": 30.0, "density": DENSITY, "gravity": GRAVITY}
    scene["effects"] = {"weight": {"gravity": GRAVITY}, "buoyancy": {}, "seabed": {}}
    return {**scene, "name": "edulis", "anchor": []}


def scene_of(name: str) -> tuple[Found, list[str]]:
    """Plain values of a scene, and the points that are displaced."""
    if name == "edulis":
        return edulis(), ["east-danforth", "east-gravity"]
    system = samples.SYSTEMS[name]()
    return samples.scene_of(system), system["asked"]


def reference(name: str) -> list[Found]:
    """MoorPy's curves."""
    ms, points = samples.moorpy_system(*scene_of(name))
    start = [p.r.copy() for p in points]
    state = ms.getPositions(DOFtype="free")
    rows = []
    for direction in DIRECTIONS:
        along = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction)), 0.0])
        ms.setPositions(state, DOFtype="free")
        for distance in DISTANCES[name]:
            for point, at in zip(points, start, strict=True):
                point.setPosition(at + distance * along)
            for tolerance in (1e-1, 1e-3, 1e-6):  # its solver often fails with a small one from afar
                ms.solveEquilibrium(DOFtype="free", tol=tolerance, maxIter=500)
            if not rows:
                state = ms.getPositions(DOFtype="free")
            forces = [p.getForces(lines_only=True, xyz=True) for p in points]
            ends = [max(float(line.TA), float(line.TB)) for line in ms.lineList]
            values = {"force_n": np.sum(forces, axis=0).tolist(), "max_tension_n": max(ends)}
            rows.append({"direction_deg": direction, "distance_m": float(distance), **values})
    return rows


def ours(name: str) -> list[Found]:
    """The same by this package."""
    import dropper_jax as dj
    from dropper_jax.study.offsets import offset_curves

    scene, moved = scene_of(name)
    return offset_curves(dj.load_scene(scene), moved, DIRECTIONS, DISTANCES[name])


def differences(found: list[Found], known: list[Found]) -> tuple[float, float]:
    """Maximum difference of horizontal force and of maximum tension, each over MoorPy's maximum of the curve."""
    force, other = (np.array([row["force_n"][:2] for row in rows]) for rows in (found, known))
    tension, theirs = (np.array([row["max_tension_n"] for row in rows]) for rows in (found, known))
    most = np.max(np.linalg.norm(other, axis=1))
    apart = np.linalg.norm(force - other, axis=1)
    return float(np.max(apart) / most), float(np.max(np.abs(tension - theirs)) / np.max(theirs))


@command(reference=False)
def main(args) -> None:
    if args.reference:
        samples.store_reference(FILE, curves={name: reference(name) for name in DISTANCES})
        return
    known = stored(FILE)
    show("system", f"horizontal force against {known['source']}", "maximum tension")
    for name in DISTANCES:
        show(name, *(f"{100 * share:.3f} %" for share in differences(ours(name), known["curves"][name])))
