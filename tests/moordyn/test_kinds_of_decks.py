"""One mooring in the ways its formats allow: all of them are the same scene, and what lacks something says what."""

from pathlib import Path

import pytest

from dropper_jax import SceneError, read_moordyn

DECK = (Path(__file__).parent / "chain.txt").read_text()
SAME = ("line_type", "point", "line", "effects", "sea")

VERSION_1 = """--------------------- MoorDyn Input File ------------------------------------
MoorDyn input of an OpenFAST case
FALSE    Echo      - echo the input file data (flag)
----------------------- LINE TYPES ------------------------------------------
1        NTypes    - number of LineTypes
Name     Diam     MassDen       EA      BA/-zeta   Can    Cat   Cdn   Cdt
(-)       (m)      (kg/m)       (N)     (N-s/-)     (-)   (-)   (-)   (-)
Chain     0.1      30.0        1e8      -0.8        1     0.5   1.6   0.1
---------------------- CONNECTION PROPERTIES --------------------------------
2        NConnects - number of connections including anchors and fairleads
Node    Type       X        Y       Z       M       V       FX      FY      FZ    CdA   CA
(-)     (-)       (m)      (m)     (m)     (kg)   (m^3)    (kN)    (kN)    (kN)   (m^2) (-)
1       Fixed    -80.0      0     -50.0     0       0       0       0       0      0     0
2       Vessel     0.0      0      -5.0     0       0       0       0       0      0     0   ! name: fairlead
---------------------- LINE PROPERTIES --------------------------------------
1        NLines    - number of line objects
Line    LineType  UnstrLen  NumSegs   NodeAnch  NodeFair  Flags/Outputs
(-)      (-)       (m)        (-)        (-)       (-)       (-)
1       Chain      100        20          1         2         p
---------------------- SOLVER OPTIONS ---------------------------------------
0.002    dtM       - time step to use in mooring integration (s)
3.0e6    kbot      - bottom stiffness (Pa/m)
3.0e5    cbot      - bottom damping (Pa-s/m)
50       WtrDpth   - water depth (m)
1.0      dtIC      - time interval for analyzing convergence during IC gen (s)
60.0     TmaxIC    - max time for ic gen (s)
4.0      CdScaleIC - factor by which to scale drag coefficients during dynamic relaxation (-)
0.01     threshIC  - threshold for IC convergence (-)
-------------------------- OUTPUTS ------------------------------------------
FairTen1
END
--------------------- need this line ----------------------------------------
"""


def swapped(*pairs: tuple[str, str]) -> str:
    text = DECK
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    return text


KINDS = {
    "version 1": VERSION_1,
    "version 1 without counts": "\n".join(x for x in VERSION_1.splitlines() if " - number of " not in x),
    "anchor and vessel": swapped((" Fixed ", " Anchor "), (" Coupled ", " Vessel ")),
    "fix and cpld": swapped((" Fixed ", " Fix "), (" Coupled ", " Cpld ")),
    "older headers": swapped((" LINE TYPES --", " LINE DICTIONARY --"), (" LINES --", " LINE LIST --")),
    "connections": swapped((" POINTS --", " CONNECTION PROPERTIES --"), (" LINES --", " LINE PROPERTIES --")),
    "point list": swapped((" POINTS --", " POINT LIST --"), (" OPTIONS --", " SOLVER OPTIONS --")),
    "output": swapped((" OUTPUTS --", " OUTPUT --")),
    "no outputs": DECK.split("---------------------- OUTPUTS")[0],
    "tabs": DECK.replace("  ", "\t"),
    "windows": DECK.replace("\n", "\r\n"),
    "byte order mark": "\ufeff" + DECK,
    "small letters": swapped((" LINE TYPES --", " line types --"), ("WtrDpth", "wtrdpth")),
    "depth": swapped(("WtrDpth", "depth")),
    "water depth": swapped(("WtrDpth", "WATERDEPTH")),
    "more words": swapped((" LINE TYPES --", " LINE TYPES Chain of grade R4 --")),
    "density and gravity": swapped(("50            WtrDpth", "50  WtrDpth\n1025 WtrDens\n9.81 gravity")),
}


@pytest.mark.parametrize("kind", KINDS)
def test_one_mooring_in_many_ways_is_one_scene(kind, tmp_path, read):
    file = tmp_path / "deck.dat"
    file.write_bytes(KINDS[kind].encode())
    base, found = read(DECK), read_moordyn(file)
    for key in SAME:
        assert found[key] == base[key], key


def test_a_seafloor_file_stands_beside_its_deck(tmp_path, monkeypatch):
    """A bed that falls by 10 m over 200 m, looked for where the deck is and not where the command runs."""
    rows = "\n".join(f"{x} {y} {-45 + 0.05 * x}" for x in (-100.0, 100.0) for y in (-10.0, 10.0))
    (tmp_path / "bed.txt").write_text(f"num_x {2} num_y {2}\n-100.0 100.0\n-10.0 10.0\n{rows}\n")
    file = tmp_path / "deck.txt"
    file.write_text(swapped(("50            WtrDpth", "bed.txt       SeafloorFile")))
    monkeypatch.chdir("/")
    bed = read_moordyn(file)["effects"]["seabed"]
    assert bed["bed_depth"] == [50.0, 50.0, 40.0, 40.0]
    (tmp_path / "bed.txt").unlink()
    with pytest.raises(SceneError, match=r"bed\.txt: cannot be read"):
        read_moordyn(file)


def test_a_line_of_one_segment_between_held_points_has_two_links_and_a_note(read):
    found = read(swapped(("100       20       p", "100       1       p")))
    assert [line["links"] for line in found["line"]] == [2]
    assert any("NumSegs 1 between fixed points: 2 links are used" in note for note in found["notes"])


def test_a_seafloor_file_is_found_from_the_working_folder_as_moordyn_finds_it(tmp_path, monkeypatch):
    (tmp_path / "decks").mkdir()
    file = tmp_path / "decks" / "deck.txt"
    file.write_text(swapped(("50            WtrDpth", "decks/../bed.txt SeafloorFile\n50            WtrDpth")))
    (tmp_path / "bed.txt").write_text("2 2\n-100 100\n-100 100\n-100 -100 50\n-100 100 50\n100 -100 52\n100 100 52\n")
    monkeypatch.chdir(tmp_path)
    assert read_moordyn(file)["effects"]["seabed"]["bed_depth"] == [50.0, 50.0, 52.0, 52.0]
