"""What MoorDyn and MoorPy say of the decks at rest: `python tests/moordyn/others.py` writes `decks/rest.json` again.

The wheel of MoorDyn reads version 2 only, neither tabs nor some names that other readers know, and falls over an END
among its outputs: `for_the_wheel` writes the same mooring in its words. Its explicit scheme is stable at 0.1 ms.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

DECKS = Path(__file__).parent / "decks"
#: Time [s] in which MoorDyn's lines come to rest, after its own search for a start.
REST = 60.0
#: A nearly weightless rope in a current and a cable in a lazy wave take longer.
LONGER = {"current.txt": 300.0, "lazy_wave_cable.txt": 600.0}
#: Depth [m] of the deck that has none.
DEPTH = 30.0
BESIDE = ("rope_table.dat", "sloped_bed.bath", "current_profile.txt")
#: Decks that MoorDyn is asked about; its bed pushes straight up, so that the one with a slope goes to MoorPy.
WHEEL = sorted(f.name for f in DECKS.iterdir() if f.suffix in (".txt", ".dat") and f.name not in BESIDE)
WHEEL.remove("sloped_bed.txt")
MOORPY = ["moorpy_bridle.yaml", "moorpy_catenary.yaml", "raft_semi.yaml", "sloped_bed.txt"]
HELD = ("coupled", "vessel", "cpld", "ves")


def for_the_wheel(name: str) -> str:
    """A deck in the words of the wheel, for points, lines and types the same numbers."""
    text = (DECKS / name).read_bytes().decode().replace("\r\n", "\n").replace("\t", " ")
    text = re.split(r"\n *-+ *OUTPUTS?\b", text)[0] + "\n"
    text = re.sub(r"(?m)^\S+(\s+dtM)", r"0.0001\1", text)
    text = re.sub(r"(?m)^(\S+\s+)(DEPTH|WATERDEPTH)\b", r"\1WtrDpth", text)
    text = re.sub(r"(?m)^.*\b(fileIC|mu_k[TA])\b.*\n", "", text)
    if name == "no_depth.txt":
        text += f"{DEPTH} WtrDpth\n"
    if name == "openfast_v1.dat":
        text = re.sub(r"(?m)^(FALSE|\d+ +N\w+) .*\n", "", text)
        text = re.sub(r"(?m)^((?:main|unused)(?: +\S+){4})(?: +(\S+)) +(\S+) +(\S+) +(\S+)", r"\1 0 \4 \2 \5 \3", text)
        text = re.sub(r"(?m)^(\d (?: *\S+){6})(?: +\S+){3}( +\S+ +\S+)$", r"\1\2", text)
        text = re.sub(r"(?m)^(1 +main)( +\S+ +\S+)( +\S+ +\S+)( +-)$", r"\1\3\2\4", text)
    return text + "--- OUTPUTS ---\n--- need this line ---\n"


def places(text: str) -> list[float]:
    """Where what the caller moves stands: six numbers for bodies and rods, three for points."""
    found: list[float] = []
    section = ""
    for line in text.splitlines():
        words = line.split()
        if line.strip().startswith("---"):
            section = line
        elif len(words) < 5 or not words[0].isdigit():
            continue
        elif "BOD" in section and words[1].lower() in HELD:
            found += map(float, words[2:8])
        elif " RODS" in section and words[2].lower() in HELD:
            a, b = (np.array([float(x) for x in words[i : i + 3]]) for i in (3, 6))
            found += [*a, *((b - a) / np.linalg.norm(b - a))]
        elif words[1].lower() in HELD:
            found += map(float, words[2:5])
    return found


def at_rest(path: Path, rest: float = REST) -> list[list[float]]:
    """Tensions [N] at the nodes of each line of a file, when MoorDyn's dynamics have come to rest.

    Its search for an initial state knows no current, and its newer one leaves free points where they are.
    """
    import moordyn

    held = places(path.read_text())
    still = [0.0] * len(held)
    folder = Path.cwd()
    os.chdir(path.parent)
    try:
        system = moordyn.Create(str(path))
        moordyn.SetVerbosity(system, moordyn.LEVEL_NONE)
        assert moordyn.NCoupledDOF(system) == len(held)
        moordyn.Init(system, held, still)
        moordyn.Step(system, held, still, 0.0, rest)
        lines = [moordyn.GetLine(system, i + 1) for i in range(moordyn.GetNumberLines(system))]
        tension = lambda line, j: float(np.linalg.norm(moordyn.GetLineNodeTen(line, j)))  # noqa: E731
        found = [[tension(line, j) for j in range(moordyn.GetLineN(line) + 1)] for line in lines]
        moordyn.Close(system)
    finally:
        os.chdir(folder)
    return found


def of_moordyn(name: str) -> list[list[float]]:
    """The same of a deck."""
    with tempfile.TemporaryDirectory() as folder:
        for file in BESIDE:  # its tables may not end with an empty line
            (Path(folder) / file).write_text((DECKS / file).read_text().rstrip("\n"))
        path = Path(folder) / "deck.txt"
        path.write_text(for_the_wheel(name))
        return at_rest(path, LONGER.get(name, REST))


def of_moorpy(name: str) -> list[list[float]]:
    """Tensions [N] at both ends of each line of a deck at rest."""
    import moorpy
    import yaml

    if name == "sloped_bed.txt":
        return [sloped(moorpy)]
    # what is held is held, whoever moves it
    table = yaml.safe_load(re.sub("type: (vessel|fairlead)", "type: fixed", (DECKS / name).read_text()))
    mooring = table.get("mooring", table)
    for kind in mooring["line_types"]:
        kind.update({key: float(value) for key, value in kind.items() if key != "name"})
    system = moorpy.System(depth=mooring["water_depth"], rho=mooring.get("rho", 1025.0))
    system.parseYAML(mooring)
    system.initialize()
    system.solveEquilibrium(tol=0.001)
    return [[float(line.TA), float(line.TB)] for line in system.lineList]


def sloped(moorpy: object) -> list[float]:
    """The deck with a slope, written in MoorPy's calls."""
    with tempfile.TemporaryDirectory() as folder:
        bed = Path(folder) / "bed.txt"
        rows = "      -400 0 400\n-200 10 50 90\n200 10 50 90\n"
        bed.write_text(f"--- MoorPy Bathymetry Input File ---\nnGridX 3\nnGridY 2\n{rows}")
        system = moorpy.System(depth=50, bathymetry=str(bed), rho=1025.0)
    diameter, mass = 0.09, 70.0
    kind = {"name": "chain", "material": "chain", "d_vol": diameter, "m": mass, "EA": 3e8, "input_type": "x"}
    kind |= {"w": (mass - np.pi / 4 * diameter**2 * 1025.0) * 9.81, "input_d": diameter, "d_nom": diameter}
    kind |= dict.fromkeys(("MBL", "cost", "EAd", "EAd_Lm", "MBL_0", "Cd", "Ca", "CdAx", "CaAx"), 0.0)
    system.lineTypes["chain"] = kind
    system.addPoint(1, [-200.0, 0.0, -30.0])
    system.addPoint(1, [0.0, 0.0, -5.0])
    system.addLine(218.0, "chain", pointA=1, pointB=2)
    system.initialize()
    line = system.lineList[0]
    return [float(line.TA), float(line.TB)]


def by_itself(name: str) -> list[list[float]]:
    """The same in a process of its own: the wheel may bring one down, and keeps what it read."""
    done = subprocess.run([sys.executable, __file__, name], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{name}: ended by {done.returncode}: {(done.stdout + done.stderr)[-800:]}"
    return json.loads(done.stdout.splitlines()[-1])


def main(names: list[str]) -> None:
    """Numbers of one deck to standard output, or of all that can be asked here to the file."""
    if names:
        print("\n" + json.dumps(of_moordyn(names[0]) if names[0] in WHEEL else of_moorpy(names[0])))
        return
    path = DECKS / "rest.json"
    found = json.loads(path.read_text()) if path.exists() else {}
    for module, asked in (("moordyn", WHEEL), ("moorpy", MOORPY)):
        try:
            __import__(module)
        except ImportError:
            continue
        for name in asked:
            found[name] = [[float(f"{x:.5g}") for x in line] for line in by_itself(name)]
    path.write_text(
        json.dumps(dict(sorted(found.items())), indent=0).replace(",\n", ", ").replace("], ", "],\n") + "\n"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
