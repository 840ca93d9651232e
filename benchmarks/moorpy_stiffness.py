"""Mooring stiffness beside MoorPy's, of its own sample systems.

    python -m venv /tmp/moorpy && /tmp/moorpy/bin/pip install moorpy
    /tmp/moorpy/bin/python benchmarks/moorpy_stiffness.py --reference     # writes results/moorpy_stiffness.json
    python benchmarks/moorpy_stiffness.py                                 # prints the difference of ours

The systems are those of MoorPy's `examples/sample.txt` (three chains to a platform in 600 m), `tests/case8.dat` (a spar
on three polyester bridles) and `tests/test_system.py::test_basicU` (two floats, with a chain between them that sags to
the bed), written anew as plain numbers. Fairleads and floats are the points whose stiffness is asked for. MoorPy's is
the analytic one (`getCoupledStiffnessA`) of exact catenaries on a rigid bed without friction; of the floats it is that
of differences over 1 cm (`getCoupledStiffness`): the analytic one is the same but for the signs of two entries of the
line that sags to the bed, which break the mirror symmetry of the floats.
"""

import json
from importlib import metadata
from pathlib import Path

import numpy as np
from study import Found, command, show, stored

FILE = Path(__file__).parent / "results" / "moorpy_stiffness.json"
DENSITY, GRAVITY = 1025.0, 9.81
#: Displacement of MoorPy's differences [m].
MOVE = 0.01
#: Sag of lines with attached points in MoorPy's first guess [m]: from a straight one its solver finds no equilibrium.
SAG = 10.0


def spread() -> Found:
    """Three chains to fairleads that are held."""
    anchors = [[800.0, 1385.64, -600.0], [-1600.0, 0.0, -600.0], [800.0, -1385.64, -600.0]]
    fairleads = [[10.0, 17.32, -21.0], [-20.0, 0.0, -21.0], [10.0, -17.32, -21.0]]
    return {
        "depth": 600.0,
        "type": {"diameter": 0.216, "mass": 286.56, "EA": 1.23e9},
        "points": {
            **{f"anchor{i}": {"position": x} for i, x in enumerate(anchors)},
            **{f"fairlead{i}": {"position": x} for i, x in enumerate(fairleads)},
        },
        "lines": [(f"anchor{i}", f"fairlead{i}", 1800.0, 240) for i in range(3)],
        "asked": [f"fairlead{i}" for i in range(3)],
    }


def bridles() -> Found:
    """Three polyester lines that each part in two, to six fairleads that are held."""
    points = {}
    lines, asked = [], []
    anchors = [[172.7, -100.0, -100.0], [0.0, 200.0, -100.0], [-172.7, -100.0, -100.0]]
    joints = [[34.64, -20.0, -50.0], [0.0, 40.0, -50.0], [-34.64, -20.0, -50.0]]
    right, left, back = [6.82, 3.9375, -21.0], [-6.82, 3.9375, -21.0], [0.0, -7.875, -21.0]
    for i, pair in enumerate([(right, back), (left, right), (back, left)]):
        points[f"anchor{i}"] = {"position": anchors[i]}
        points[f"joint{i}"] = {"position": joints[i], "free": True}
        lines.append((f"anchor{i}", f"joint{i}", 160.0, 40))
        for side, place in zip("ab", pair, strict=True):
            points[f"fairlead{i}{side}"] = {"position": place}
            lines.append((f"joint{i}", f"fairlead{i}{side}", 45.36, 16))
            asked.append(f"fairlead{i}{side}")
    kind = {"diameter": 0.15, "mass": 25.0, "EA": 30e6}
    return {"depth": 100.0, "type": kind, "points": points, "lines": lines, "asked": asked}


def floats() -> Found:
    """Two floats of 50 m3 on chains, and a chain of 250 m between them that lies on the bed in its middle."""
    return {
        "depth": 100.0,
        "type": {"diameter": 0.216, "mass": 286.56, "EA": 1.23e9},
        "points": {
            "west": {"position": [-200.0, 0.0, -100.0]},
            "a": {"position": [-100.0, 0.0, -50.0], "free": True, "volume": 50.0},
            "b": {"position": [100.0, 0.0, -40.0], "free": True, "volume": 50.0},
            "east": {"position": [200.0, 0.0, -100.0]},
        },
        "lines": [("west", "a", 120.0, 180), ("a", "b", 250.0, 380), ("b", "east", 120.0, 180)],
        "asked": ["a", "b"],
        "differences": True,
    }


SYSTEMS = {"spread": spread, "bridles": bridles, "floats": floats}


def scene_of(system: Found) -> Found:
    """Plain values of a scene."""
    points = []
    for name, point in system["points"].items():
        free = {"kind": "free", "mass": 0.0, "volume": point.get("volume", 0.0)} if point.get("free") else {}
        points.append({"name": name, "position": point["position"], **free})
    return {
        "name": "sample",
        "run": {"dt": 0.01, "duration": 0.01},
        "line_type": [{"name": "main", **system["type"]}],
        "point": points,
        "line": [
            {"name": f"line{i}", "from": a, "to": b, "type": "main", "length": length, "links": links}
            for i, (a, b, length, links) in enumerate(system["lines"])
        ],
        "sea": {"depth": system["depth"], "density": DENSITY, "gravity": GRAVITY},
        "effects": {"weight": {"gravity": GRAVITY}, "buoyancy": {}, "seabed": {}},
    }


def moorpy_system(scene: Found, moved: list[str]):
    """MoorPy's system of the same plain values, in which attached points divide their line, and its moved points."""
    import moorpy

    ms = moorpy.System(depth=scene["sea"]["depth"], rho=DENSITY, g=GRAVITY)
    for kind in scene["line_type"]:
        across, mass = kind["diameter"], kind["mass"]
        wet = (mass - DENSITY * np.pi / 4.0 * across**2) * GRAVITY
        own = {"name": kind["name"], "d_vol": across, "w": wet, "m": mass, "EA": kind["EA"]}
        ms.setLineType(lineType=own | {"material": "chain", "d_nom": across}, name=kind["name"])
    spars = {buoy["point"]: buoy for buoy in scene.get("buoy", [])}
    number = {}

    def add_point(name: str, position, kind: int, mass: float = 0.0, volume: float = 0.0, span=(-1.0, 1.0)) -> None:
        number[name] = len(ms.pointList) + 1
        ms.addPoint(kind, np.array(position, float), m=mass, v=volume)
        ms.pointList[-1].zSpan = list(span)

    for point in scene["point"]:
        name, position = point["name"], point["position"]
        kind = 0 if point.get("kind") == "free" else -1 if name in moved else 1
        if name in spars:
            spar = spars[name]
            volume = np.pi / 4.0 * spar["diameter"] ** 2 * spar["height"]
            add_point(name, position, kind, spar["mass"], volume, (0.0, spar["height"]))
        else:
            add_point(name, position, kind, point.get("mass", 0.0), point.get("volume", 0.0))
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
        cuts = [0.0, *(stop["at"] for stop in stops), line["length"]]
        for i, length in enumerate(np.diff(cuts)):
            ms.addLine(length, line["type"], pointA=number[names[i]], pointB=number[names[i + 1]])
    ms.initialize()
    return ms, [ms.pointList[number[name] - 1] for name in moved]


def reference(system: Found) -> Found:
    """MoorPy's matrix of the points that are asked for [N/m], and where they are [m]."""
    ms, asked = moorpy_system(scene_of(system), system["asked"])
    ms.solveEquilibrium(DOFtype="free", tol=1e-7)
    for point in asked:
        point.type = -1
    if system.get("differences"):
        matrix = ms.getCoupledStiffness(dx=MOVE, lines_only=True)
    else:
        matrix = ms.getCoupledStiffnessA(lines_only=True)
    order = np.argsort(np.argsort([p.number for p in asked]))  # MoorPy's is in the order of its points
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    return {"stiffness": matrix[np.ix_(rows, rows)].tolist(), "positions": [p.r.tolist() for p in asked]}


def store_reference(file: Path, **found) -> None:
    """Store MoorPy's values with its version. Its environment lacks this package, hence not by `study.store`."""
    found = {"source": f"MoorPy {metadata.version('moorpy')}", **found}
    file.write_text(json.dumps(found, indent=1) + "\n")


def ours(system: Found) -> np.ndarray:
    """The same by this package."""
    import dropper_jax as dj
    from dropper_jax.statics.stiffness import mooring_stiffness

    model = dj.build(scene_of(system))[0]
    pose = dj.equilibrium(model)
    if pose.status != "ok":
        raise RuntimeError(pose.message)
    return mooring_stiffness(model, pose.state, system["asked"]).matrix


def difference(found: np.ndarray, known: np.ndarray) -> float:
    """Largest difference of an entry, over the largest entry."""
    return float(np.max(np.abs(found - known)) / np.max(np.abs(known)))


@command({"systems": list(SYSTEMS)}, reference=False)
def main(args) -> None:
    if args.reference:
        store_reference(FILE, systems={name: reference(make()) for name, make in SYSTEMS.items()})
        return
    known = stored(FILE)
    show("system", f"against {known['source']}", "of the diagonal")
    for name in args.systems:
        found, theirs = ours(SYSTEMS[name]()), np.array(known["systems"][name]["stiffness"])
        diagonal = np.max(np.abs(np.diag(found) / np.diag(theirs) - 1.0))
        show(name, f"{100 * difference(found, theirs):.3f} %", f"{100 * diagonal:.3f} %")
