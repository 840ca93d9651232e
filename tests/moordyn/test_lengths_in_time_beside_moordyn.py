"""Lengths in time beside MoorDyn, whose unstretched lengths are driven as by a control channel."""

from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj

moordyn = pytest.importorskip("moordyn")
#: Rest before hauling, and whole run [s]; time between changes of MoorDyn's rate [s].
REST, SPAN, CALL = 60.0, 15.0, 0.02
#: A deck without its points, lines and depth.
DECK = Path(__file__).with_name("hauled.txt").read_text()
FIXED = "1 Fixed -80 0 -50 0 0 0 0\n2 Fixed 0 0 -5 0 0 0 0"
#: Points, lines, depth [m]; the line that is hauled, its length [m] and how much of it [m]. Light lines are hauled:
#: MoorDyn takes the mass of hauled rope off the line, here it stays.
MOORINGS = {
    "a taut rope": (FIXED, "1 rope 1 2 90 20 -", 60, 1, 90.0, 1.0),
    "a hanging chain with a wire on the winch": (
        f"{FIXED}\n3 Free -15 0 -20 0 0 0 0",
        "1 chain 1 3 80 16 -\n2 wire 3 2 20 4 -",
        90,
        2,
        20.0,
        3.0,
    ),
    "a chain with a float below the winch": (
        f"{FIXED}\n3 Free -25 0 -20 200 0.6 1.0 1.0",
        "1 chain 1 3 75 25 -\n2 wire 3 2 28 7 -",
        90,
        2,
        28.0,
        3.0,
    ),
}


def length(t, whole, hauled):
    """Length [m] from 2 to 10 s falls smoothly."""
    u = np.clip((t - 2.0) / 8.0, 0.0, 1.0)
    return whole - hauled * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def by_moordyn(file, times, number, lengths):
    """Tensions [N] at both ends of every line after each call (k, lines, 2)."""
    system = moordyn.Create(str(file))
    moordyn.Init(system, [], [])
    moordyn.Step(system, [], [], 0.0, REST)
    lines = [moordyn.GetLine(system, i + 1) for i in range(moordyn.GetNumberLines(system))]
    last = [moordyn.GetLineN(line) for line in lines]
    winch = lines[number - 1]
    found = []
    for i, start in enumerate(times[:-1]):
        moordyn.SetLineUnstretchedLength(winch, float(lengths[i]))
        moordyn.SetLineUnstretchedLengthVel(winch, float((lengths[i + 1] - lengths[i]) / CALL))
        moordyn.Step(system, [], [], REST + start, CALL)
        assert np.isclose(moordyn.GetLineUnstretchedLength(winch), lengths[i + 1], rtol=1e-9)
        row = []
        for line, end in zip(lines, last, strict=True):
            row.append([np.linalg.norm(moordyn.GetLineNodeTen(line, node)) for node in (0, end)])
        found.append(row)
    moordyn.Close(system)
    return np.array(found)


def both(deck, number, whole, hauled, here=None):
    """Tensions [N] at both ends of every line over time (k, lines, 2): of MoorDyn, and of a deck (`here`) here."""
    file = Path("mooring.txt").resolve()
    file.write_text(deck)
    times = CALL * np.arange(round(SPAN / CALL) + 1)
    lengths = length(times, whole, hauled)
    theirs = by_moordyn(file, times, number, lengths)

    file.write_text(here or deck)
    table = dj.load_scene(file).to_dict()
    links = table["line"][number - 1]["links"]
    table["line"][number - 1]["length_in_time"] = [
        {"end": "to", "links": links, "time": times.tolist(), "length": lengths.tolist()}
    ]
    table["run"] = {"dt": CALL, "duration": SPAN}
    run = dj.simulate(table)
    assert run.status == "ok"
    ends = [[line.links.start, line.links.stop - 1] for line in run.lines]
    return theirs, run.tension[1:, ends]


@pytest.mark.check
@pytest.mark.parametrize("name", MOORINGS)
def test_tensions_of_a_hauled_line_are_those_of_moordyn(name, tmp_path, monkeypatch):
    points, lines, depth, number, whole, hauled = MOORINGS[name]
    monkeypatch.chdir(tmp_path)
    theirs, ours = both(DECK.format(points=points, lines=lines, depth=depth), number, whole, hauled)
    difference = np.max(np.abs(ours - theirs), axis=0) / np.max(theirs, axis=0)
    assert np.max(np.abs(theirs[-1] / theirs[0] - 1.0)) > 0.1
    assert np.max(difference) < 0.005


@pytest.mark.check
@pytest.mark.parametrize("depth", [50, 90])
def test_a_chain_with_the_mass_of_what_remains_is_that_of_moordyn_after_hauling(depth, tmp_path, monkeypatch):
    """On the seabed and hanging: the weight of hauled chain is all that differs (1.06 %)."""
    monkeypatch.chdir(tmp_path)
    whole, hauled = 100.0, 1.0
    deck = DECK.format(points=FIXED, lines=f"1 chain 1 2 {whole} 20 -", depth=depth)
    remains = 1.0 - hauled / whole
    light = deck.replace("chain 0.1 30.0", f"chain {0.1 * np.sqrt(remains)} {30.0 * remains}")
    theirs, ours = both(deck, 1, whole, hauled, here=light)
    after = round(10.0 / CALL)
    assert np.max(np.abs(ours - theirs)[after:]) < 1e-3 * np.max(theirs)
