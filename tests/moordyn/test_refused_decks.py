"""Decks that cannot be what they say: each is refused in one line with the file, its line and what is allowed."""

import re
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError, equilibrium, load_scene

DECKS = Path(__file__).parent / "decks"
NO_FILE = "cannot be read: No such file"
#: Decks, and what is refused of each: what is replaced in it, by what, and the words of the refusal.
REFUSED = {
    "no_depth.txt": {"no water depth": ("", "", r"no_depth.txt:\d+: WtrDpth: missing; needed: > 0 m, in the file or")},
    "catenary.txt": {
        "no lines": ("1     chain76 ", "! chain76 ", "section 'LINES' is empty"),
        "a point given twice": ("2     Coupled ", "1     Coupled ", "catenary.txt:10: point 1 is given"),
        "a line without end": (
            "1     chain76      1        2 ",
            "1     chain76      1  ",
            "'320.0' is not a point of the file; known: 1, 2",
        ),
        "a point without height": ("-12.0      0       0       0      0", "", "point: has 4 values"),
        "a type that is short": ("1.6    1.0    0.05    0.0", "1.6", "line type: has 7 values; allowed: 9"),
        "letters for numbers": ("4.9e8 ", "4.9e8N", "EA: '4.9e8N' is neither a number nor a readable file"),
        "commas for points": ("320.0      20", "320,0      20", "UnstrLen: '320,0' is not a number"),
        "no number": ("320.0      20", "nan        20", "UnstrLen: 'nan' is not a number"),
        "more than there is": ("320.0      20", "320.0 9000000", "9000000 is out of range; allowed: a whole number"),
        "a length of nothing": ("320.0      20", "0.0        20", "UnstrLen: 0.0 is out of range"),
        "a turbine's point": ("2     Coupled ", "2     Turbine2", "on 'Turbine2': is not in the file"),
        "an anchor under the bed": ("-120.0  ", "-125.0  ", "z = -125 m is below the seabed; allowed: >= -120"),
        "a line to where it starts": ("chain76      1        2 ", "chain76      1        1 ", "starts and ends at 1"),
        "an infinite interval": ("100           TmaxIC", "inf dtOut", "dtOut: 'inf' is not a number"),
        "a step that is no number": ("100           TmaxIC", "nan dtM", "dtM: 'nan' is not a number"),
        "friction below zero": (
            "100           TmaxIC",
            "-1 FrictionCoefficient",
            "-1.0 is out of range; allowed: a number >= 0",
        ),
    },
    "bridle.txt": {
        "a type given twice": ("legs       0.06", "chain      0.06", "line type 'chain' is given twice"),
        "a line given twice": ("3     legs ", "2     legs ", "line 2 is given twice"),
        "an output of no line": ("FairTen2", "FairTen9", "output 'FairTen9': there is no such line"),
    },
    "clump_and_buoy.txt": {"a mass below zero": ("6000.0    0.8", "-60.0    0.8", "Mass: -60.0 is out of range")},
    "coupled_body.txt": {
        "a body that is not there": ("4     Body1", "4     Body7", "point 4 on 'Body7': is not in"),
        "a body that is turned": ("-2.0     0     0 ", "-2.0     0     5 ", "body 1 is rotated by"),
    },
    "coupled_rod.txt": {
        "a rod that is not there": ("1       R1A ", "1       R7A ", "'R7A' is not a point of the file"),
        "a rod on nothing": ("1    post     Coupled", "1    post     Body3 ", "rod 1, 'Body3': is not"),
    },
    "current.txt": {"a current that is not there": ("", "", "current_profile.txt: cannot be read: No such file")},
    "sloped_bed.txt": {"a bed that is not there": ("", "", "sloped_bed.bath: cannot be read: No such file")},
    "rope_table.txt": {
        "a table that is not there": ("", "", "EA: 'rope_table.dat' is neither a number nor a readable file")
    },
    "viscoelastic.txt": {"working curves": ("2.0e7|6.0e7 ", "SYROPE:a|b ", r"working curves \(SYROPE\) are not")},
    "openfast_v2.dat": {
        "a slope of nothing": ("200         WtrDpth", "flat.txt    WtrDpth", "flat.txt: cannot be read: No such file")
    },
}


@pytest.mark.parametrize(("name", "what"), [(name, what) for name, cases in REFUSED.items() for what in cases])
def test_a_deck_that_cannot_be_is_refused_in_one_line(name, what, tmp_path):
    old, new, words = REFUSED[name][what]
    text = (DECKS / name).read_text()
    assert not old or text.count(old) >= 1, old
    (tmp_path / name).write_text(text.replace(old, new, 1) if old else text)
    with pytest.raises(SceneError, match=words) as caught:
        load_scene(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert re.match(rf"{re.escape(str(tmp_path / name))}:\d+: ", str(caught.value)) or words.endswith(NO_FILE)


@pytest.mark.parametrize("value", ["-3", "nan", "-inf"])
@pytest.mark.parametrize("option", ["g", "rho", "kBot", "cBot", "WtrDpth"])
def test_an_option_out_of_range_is_refused_with_its_line(option, value, deck):
    text = (DECKS / "catenary.txt").read_text()
    line = next(i for i, row in enumerate(text.splitlines(), 1) if row.split()[1:2] == [option])
    with pytest.raises(SceneError, match=rf"mooring.txt:{line}: "):
        load_scene(deck(re.sub(rf"(?m)^\S+(\s+{option}\s)", rf"{value}\1", text)))


def test_without_gravity_a_deck_rests_where_its_stretch_is_balanced(deck):
    """MoorDyn takes g = 0; a straight rope of 300 m over the distance of its ends pulls `EA (distance/300 - 1)`."""
    text = (DECKS / "catenary.txt").read_text().replace("320.0      20", "300.0      4").replace("9.81 ", "0    ")
    scene = load_scene(deck(text))
    assert scene.sea.gravity == scene.effects["weight"]["gravity"] == 0.0
    pull = 4.9e8 * (np.linalg.norm([294.0, 41.0, 108.0]) / 300.0 - 1.0)
    np.testing.assert_allclose(equilibrium(scene).tension, pull, rtol=1e-9)
    waves = {"kind": "regular", "amplitude": 1.0, "period": 8.0}
    with pytest.raises(SceneError, match=r"sea.gravity: 0.0 makes no waves; allowed: > 0 m/s\^2 with \[sea.waves\]"):
        scene.with_values({"sea.waves": waves})


def test_each_omission_that_changes_results_is_named_separately(deck):
    """Waves, currents and friction of OpenFAST's own kinds change all that a run gives: each has a line of its own."""
    text = (DECKS / "openfast_v2.dat").read_text()
    text = text.replace("0.0         mu_kT", "0.1         mu_kT").replace("0.0         mu_kA", "0.3         mu_kA")
    text = text.replace("200         WtrDpth", '200         WtrDpth\n"seastate.dat"   WaterKin')
    notes = load_scene(deck(text)).notes
    for words in ("mu_kT 0.1 is not represented", "mu_kA 0.3 is not represented", "no waves or current of that file"):
        assert len([note for note in notes if words in note]) == 1
    assert not any("mu_k" in note for note in load_scene(DECKS / "openfast_v2.dat").notes)  # of nothing


def test_a_row_of_line_types_is_checked_against_its_header(deck):
    text = (DECKS / "catenary.txt").read_text()
    row = next(line for line in text.splitlines() if line.startswith("chain76"))
    short = " ".join(row.split()[:9])  # EI Cd Ca CdAx of it would be read as Can Cat Cdn Cdt
    with pytest.raises(SceneError, match=r"mooring.txt:\d+: line type: has 9 values; allowed: 10"):
        load_scene(deck(text.replace(row, short)))
    head = next(line for line in text.splitlines() if "CdAx" in line)
    with pytest.raises(SceneError, match=r"mooring.txt:\d+: LINE TYPES: columns CdAx CaAx without EI"):
        load_scene(deck(text.replace(head, head.replace(" EI", "   ")).replace(row, short)))


@pytest.mark.parametrize(
    ("step", "rows", "words"),
    [
        ("0", "0 0\n1 0.5\n2 0\n3 -0.5\n", "dtWave: 0 is out of range"),
        ("-1", "0 0\n1 0.5\n2 0\n3 -0.5\n", "dtWave: -1 is out of range"),
        ("0.25", "0 0.5\n", "at least 4"),
        ("0.25", "0 0\n2 0\n1 0.5\n3 -0.5\n", "the times do not rise"),
        ("0.25", "0 0.5\n1 0.5\n2 0.5\n", "the elevation is constant"),
    ],
)
def test_an_elevation_series_without_waves_is_refused(step, rows, words, deck):
    text = (DECKS / "catenary.txt").read_text()
    path = deck(text.replace("100           TmaxIC", f"3 WaveKin\n{step} dtWave"))
    (path.parent / "wave_elevation.txt").write_text(rows)
    with pytest.raises(SceneError, match=words):
        load_scene(path)


RODS = """---------------------- ROD TYPES -----
TypeName Diam Mass/m Cd Ca CdEnd CaEnd
(name) (m) (kg/m) (-) (-) (-) (-)
post 0.5 0.0 1.0 1.0 1.0 1.0
---------------------- BODIES -----
ID Attachment X0 Y0 Z0 r0 p0 y0 Mass CG I Volume CdA Ca
(#) (word) (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)
1 Free 0 0 -12 0 0 0 500 0 1e3 0.5 CDA 0
---------------------- RODS -----
ID RodType Attachment Xa Ya Za Xb Yb Zb NumSegs RodOutputs
(#) (name) (word/ID) (m) (m) (m) (m) (m) (m) (-) (-)
1 post Body1 0 0 0 0 0 1 3 -
---------------------- POINTS -----"""


@pytest.fixture
def body_deck(deck):
    """`body_deck(old, new)`: a line to a free body with a rod, with one row changed."""
    text = (DECKS / "catenary.txt").read_text().replace("2     Coupled ", "2     Body1   ")
    head = next(line for line in text.splitlines() if " POINTS -" in line)
    return lambda old, new: deck(text.replace(head, RODS.replace(old, new)).replace("CDA", "2.0"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("1 post Body1 0 0 0 0 0 1 3 -", "1 post", "rod: has 2 values"),
        ("1 Free 0 0 -12 0 0 0 500 0 1e3 0.5 CDA 0", "1", "body: has 1 values"),
        ("500 0 1e3", "500 0 1e3|2e3", "I: '1e3|2e3' has 2 numbers; allowed: 1 or 3"),
        ("500 0 1e3", "500 0|1 1e3", "CG: '0|1' has 2 numbers; allowed: 1 or 3"),
    ],
)
def test_rows_of_bodies_and_rods_are_refused_with_their_line(old, new, words, body_deck):
    with pytest.raises(SceneError, match=rf"mooring.txt:\d+: {re.escape(words)}"):
        load_scene(body_deck(old, new))


def test_a_body_needs_no_added_mass_whether_or_not_a_rod_is_on_it(body_deck):
    body = load_scene(body_deck("CDA 0", "CDA")).bodies[0]
    assert body.spheres[0].ca == 0.0
    assert len(body.cylinders) == 1


def test_of_two_drag_areas_the_second_is_that_of_rotations(body_deck):
    """MoorDyn: `translation|rotation`; cd = CdA/(pi d^2/4)."""
    sphere = load_scene(body_deck("CDA", "3.0|50.0")).bodies[0].spheres[0]
    assert sphere.cd * np.pi * sphere.diameter**2 / 4 == pytest.approx(3.0)
