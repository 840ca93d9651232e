"""Mooring stiffness and restoring force over offset next to MoorPy's, of its sample systems and the Edulis longline.

    python -m venv /tmp/moorpy && /tmp/moorpy/bin/pip install moorpy
    /tmp/moorpy/bin/python tests/statics/against_moorpy.py   # writes moorpy_stiffness.json and moorpy_offsets.json

The tests compare these with the values here.

The systems are those of MoorPy's `examples/sample.txt` (three chains to a platform in 600 m), `tests/case8.dat` (a spar
on three polyester bridles) and `tests/test_system.py::test_basicU` (two floats, with a chain between them that sags to
the bed), written again as plain numbers. Fairleads and floats are the points whose stiffness is asked for. MoorPy's is
the analytic one (`getCoupledStiffnessA`) of exact catenaries on a rigid bed without friction; of the floats it is that
of differences over 1 cm (`getCoupledStiffness`): the analytic one is the same but for the signs of two entries of the
line that sags to the bed, which break the mirror symmetry of the floats.

Curves displace the fairleads together. Of `edulis-longline` the two eastern anchors are displaced, in still water; its
spars float with their waterline. The ground chains between the anchors of one side lie on the seabed without tension
and are left out of MoorPy's system.
"""

import json
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
EDULIS = HERE.parents[1] / "dropper_jax" / "data" / "scenes" / "edulis-longline.toml"
DENSITY, GRAVITY = 1025.0, 9.81
#: Displacement of MoorPy's differences [m].
MOVE = 0.01
#: Sag of lines with attached points in MoorPy's first guess [m]: from a straight one its solver finds no equilibrium.
SAG = 10.0
CHAIN = {"diameter": 0.216, "mass": 286.56, "EA": 1.23e9}
FREE = {"kind": "free", "mass": 0.0, "volume": 0.0}
#: Directions [deg] and distances [m] of the curves.
DIRECTIONS = (0.0, 60.0, 120.0, 180.0)
DISTANCES = {"spread": np.arange(0.0, 25.1, 5.0), "bridles": np.arange(0.0, 5.1), "edulis": np.arange(0.0, 5.1)}


def spread() -> dict[str, Any]:
    """Three chains to fairleads that are held."""
    anchors = [[800.0, 1385.64, -600.0], [-1600.0, 0.0, -600.0], [800.0, -1385.64, -600.0]]
    fairleads = [[10.0, 17.32, -21.0], [-20.0, 0.0, -21.0], [10.0, -17.32, -21.0]]
    return {
        "depth": 600.0,
        "type": CHAIN,
        "points": {
            **{f"anchor{i}": {"position": x} for i, x in enumerate(anchors)},
            **{f"fairlead{i}": {"position": x} for i, x in enumerate(fairleads)},
        },
        "lines": [(f"anchor{i}", f"fairlead{i}", 1800.0, 240) for i in range(3)],
        "asked": [f"fairlead{i}" for i in range(3)],
    }


def bridles() -> dict[str, Any]:
    """Three polyester lines that each part in two, to six fairleads that are held."""
    anchors = [[172.7, -100.0, -100.0], [0.0, 200.0, -100.0], [-172.7, -100.0, -100.0]]
    joints = [[34.64, -20.0, -50.0], [0.0, 40.0, -50.0], [-34.64, -20.0, -50.0]]
    right, left, back = [6.82, 3.9375, -21.0], [-6.82, 3.9375, -21.0], [0.0, -7.875, -21.0]
    fairleads = {"0a": right, "0b": back, "1a": left, "1b": right, "2a": back, "2b": left}
    return {
        "depth": 100.0,
        "type": {"diameter": 0.15, "mass": 25.0, "EA": 30e6},
        "points": {
            **{f"anchor{i}": {"position": x} for i, x in enumerate(anchors)},
            **{f"joint{i}": {"position": x, **FREE} for i, x in enumerate(joints)},
            **{f"fairlead{side}": {"position": x} for side, x in fairleads.items()},
        },
        "lines": [
            *((f"anchor{i}", f"joint{i}", 160.0, 40) for i in range(3)),
            *((f"joint{side[0]}", f"fairlead{side}", 45.36, 16) for side in fairleads),
        ],
        "asked": [f"fairlead{side}" for side in fairleads],
    }


def floats() -> dict[str, Any]:
    """Two floats of 50 m3 on chains, and a chain of 250 m between them that lies on the bed in its middle."""
    return {
        "depth": 100.0,
        "type": CHAIN,
        "points": {
            "west": {"position": [-200.0, 0.0, -100.0]},
            "a": {"position": [-100.0, 0.0, -50.0], **FREE, "volume": 50.0},
            "b": {"position": [100.0, 0.0, -40.0], **FREE, "volume": 50.0},
            "east": {"position": [200.0, 0.0, -100.0]},
        },
        "lines": [("west", "a", 120.0, 180), ("a", "b", 250.0, 380), ("b", "east", 120.0, 180)],
        "asked": ["a", "b"],
    }


SYSTEMS = {"spread": spread, "bridles": bridles, "floats": floats}


def scene_of(name: str) -> tuple[dict[str, Any], list[str]]:
    """Plain values of a scene, and the points that are asked for."""
    environment = {
        "sea": {"density": DENSITY, "gravity": GRAVITY},
        "effects": {"weight": {"gravity": GRAVITY}, "buoyancy": {}, "seabed": {}},
    }
    if name == "edulis":
        environment["sea"]["depth"] = 30.0
        return tomllib.loads(EDULIS.read_text()) | environment | {"anchor": []}, ["east-danforth", "east-gravity"]
    system = SYSTEMS[name]()
    environment["sea"]["depth"] = system["depth"]
    scene = {
        "name": "sample",
        "run": {"dt": 0.01, "duration": 0.01},
        "line_type": [{"name": "main", **system["type"]}],
        "point": [{"name": name, **point} for name, point in system["points"].items()],
        "line": [
            {"name": f"line{i}", "from": a, "to": b, "type": "main", "length": length, "links": links}
            for i, (a, b, length, links) in enumerate(system["lines"])
        ],
    }
    return scene | environment, system["asked"]


def moorpy_system(scene: dict[str, Any], moved: list[str]):
    """MoorPy's system of the same plain values, in which attached points divide their line, and its moved points."""
    import moorpy

    ms = moorpy.System(depth=scene["sea"]["depth"], rho=DENSITY, g=GRAVITY)
    for kind in scene["line_type"]:
        across, mass = kind["diameter"], kind["mass"]
        wet = (mass - DENSITY * np.pi / 4.0 * across**2) * GRAVITY
        own = {"name": kind["name"], "d_vol": across, "w": wet, "m": mass, "EA": kind["EA"]}
        ms.setLineType(lineType=own | {"material": "chain", "d_nom": across}, name=kind["name"])
    number = {}

    def add_point(name: str, position, kind: int, mass: float = 0.0, volume: float = 0.0, span=(-1.0, 1.0)) -> None:
        number[name] = len(ms.pointList) + 1
        ms.addPoint(kind, np.array(position, float), m=mass, v=volume)
        ms.pointList[-1].zSpan = list(span)

    spars = {spar["point"]: spar for spar in scene.get("buoy", [])}
    for name, spar in spars.items():
        volume = np.pi / 4.0 * spar["diameter"] ** 2 * spar["height"]
        spars[name] = {"mass": spar["mass"], "volume": volume, "span": (0.0, spar["height"])}
    for point in scene["point"]:
        kind = 0 if point.get("kind") == "free" else -1 if point["name"] in moved else 1
        own = {key: point[key] for key in ("mass", "volume") if key in point}
        add_point(point["name"], point["position"], kind, **spars.get(point["name"], own))
    ends = {point["name"]: np.array(point["position"]) for point in scene["point"]}
    for line in scene["line"]:
        if "ground" in line["name"]:
            continue
        stops = line.get("attach", [])
        for stop in stops:
            share = stop["at"] / line["length"]
            straight = (1.0 - share) * ends[line["from"]] + share * ends[line["to"]]
            add_point(stop["point"], straight - [0.0, 0.0, 4.0 * SAG * share * (1.0 - share)], 0)
        names = [line["from"], *(stop["point"] for stop in stops), line["to"]]
        lengths = np.diff([0.0, *(stop["at"] for stop in stops), line["length"]])
        for start, end, length in zip(names[:-1], names[1:], lengths, strict=True):
            ms.addLine(length, line["type"], pointA=number[start], pointB=number[end])
    ms.initialize()
    return ms, [ms.pointList[number[name] - 1] for name in moved]


def moorpy_stiffness(name: str) -> dict[str, Any]:
    """MoorPy's matrix of the points that are asked for [N/m], and where they are [m]."""
    ms, asked = moorpy_system(*scene_of(name))
    ms.solveEquilibrium(DOFtype="free", tol=1e-7)
    for point in asked:
        point.type = -1
    if name == "floats":
        matrix = ms.getCoupledStiffness(dx=MOVE, lines_only=True)
    else:
        matrix = ms.getCoupledStiffnessA(lines_only=True)
    order = np.argsort(np.argsort([p.number for p in asked]))  # MoorPy's is in the order of its points
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    return {"stiffness": matrix[np.ix_(rows, rows)].tolist(), "positions": [p.r.tolist() for p in asked]}


def moorpy_curves(name: str) -> list[dict[str, Any]]:
    """MoorPy's forces and largest tension, over direction and distance."""
    ms, points = moorpy_system(*scene_of(name))
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


def stiffness(name: str, moorpys: dict[str, Any]) -> tuple[float, float]:
    """Maximum difference of an entry of our matrix over the largest entry, and of a diagonal entry over its own."""
    import dropper_jax as dj
    from dropper_jax.statics.stiffness import mooring_stiffness

    scene, asked = scene_of(name)
    model = dj.build(scene)[0]
    pose = dj.equilibrium(model)
    if pose.status != "ok":
        raise RuntimeError(pose.message)
    ours, theirs = mooring_stiffness(model, pose.state, asked).matrix, np.array(moorpys["stiffness"])
    largest = np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs))
    return float(largest), float(np.max(np.abs(np.diag(ours) / np.diag(theirs) - 1.0)))


def offsets(name: str, moorpys: list[dict[str, Any]]) -> tuple[float, float]:
    """Maximum difference of horizontal force and of maximum tension, each over MoorPy's maximum of the curve."""
    import dropper_jax as dj
    from dropper_jax.study.offsets import offset_curves

    scene, moved = scene_of(name)
    found = offset_curves(dj.load_scene(scene), moved, DIRECTIONS, DISTANCES[name])
    force, other = (np.array([row["force_n"][:2] for row in rows]) for rows in (found, moorpys))
    tension, theirs = (np.array([row["max_tension_n"] for row in rows]) for rows in (found, moorpys))
    apart = np.linalg.norm(force - other, axis=1) / np.max(np.linalg.norm(other, axis=1))
    return float(np.max(apart)), float(np.max(np.abs(tension - theirs)) / np.max(theirs))


def known(study: str) -> dict[str, Any]:
    """MoorPy's values, by system: of `stiffness` or `offsets`."""
    return json.loads((HERE / f"moorpy_{study}.json").read_text(encoding="utf-8"))["systems"]


if __name__ == "__main__":
    # MoorPy's environment lacks this package
    for study, theirs, systems in (("stiffness", moorpy_stiffness, SYSTEMS), ("offsets", moorpy_curves, DISTANCES)):
        made = {"source": f"MoorPy {metadata.version('moorpy')}", "systems": {name: theirs(name) for name in systems}}
        (HERE / f"moorpy_{study}.json").write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
