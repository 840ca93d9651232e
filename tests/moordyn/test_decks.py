"""MoorDyn decks as they are found: names of the depth, headers with more words, bodies, what results lack."""

from __future__ import annotations

from pathlib import Path

import pytest

from dropper_jax import SceneError
from dropper_jax.moordyn.reading.reader import read_moordyn

DECK = (Path(__file__).parent / "chain.txt").read_text()


@pytest.mark.parametrize("name", ["depth", "DEPTH", "WATERDEPTH", "WtrDpth"])
def test_depth_by_any_of_its_names(tmp_path, name):
    file = tmp_path / "deck.txt"
    file.write_text(DECK.replace("WtrDpth", name))
    assert read_moordyn(file)["sea"]["depth"] == 50.0


def test_depth_of_the_caller_where_the_file_has_none(tmp_path):
    file = tmp_path / "deck.txt"
    file.write_text("\n".join(line for line in DECK.splitlines() if "WtrDpth" not in line))
    with pytest.raises(SceneError, match="WtrDpth: missing; needed: > 0 m, in the file or as --depth"):
        read_moordyn(file)
    assert read_moordyn(file, 40.0)["sea"]["depth"] == 40.0
    with pytest.raises(SceneError, match="--depth: -1 is out of range"):
        read_moordyn(file, -1.0)
    file.write_text(DECK)
    with pytest.raises(SceneError, match="the file has its own"):
        read_moordyn(file, 40.0)


def test_headers_with_more_words_and_options_that_change_nothing_here(tmp_path):
    file = tmp_path / "deck.txt"
    text = DECK.replace(" LINE TYPES --", " LINE TYPES Chain of grade R4 --").replace(" OUTPUTS --", " OUTPUT --")
    file.write_text(text.replace("50            WtrDpth", "50            WtrDpth\n0 fileIC"))
    found = read_moordyn(file)
    assert [kind["name"] for kind in found["line_type"]] == ["Chain"]
    assert any("fileIC" in note for note in found["notes"])


def test_what_results_lack_is_named_by_itself(tmp_path):
    file = tmp_path / "deck.txt"
    more = '"water.dat" WaterKin\n0.3 MU_KT\n0.0 MU_KA'
    file.write_text(DECK.replace("50            WtrDpth", f"50            WtrDpth\n{more}"))
    notes = read_moordyn(file)["notes"]
    assert any("WaterKin" in note and "no waves or current" in note for note in notes)
    assert any("MU_KT 0.3" in note and "no friction" in note for note in notes)
    assert not any("MU_KA" in note for note in notes)


def test_a_step_for_stability_is_not_ours(tmp_path):
    file = tmp_path / "deck.txt"
    file.write_text(DECK.replace("0.002         dtM", "5e-5          dtM"))
    found = read_moordyn(file)
    assert found["run"]["dt"] == 0.01
    assert any("dtM of 5e-05 s" in note for note in found["notes"])


BODIES = """---------------------- BODIES ---------------------------------------
ID   Attachment  X0  Y0  Z0  r0  p0  y0  Mass  CG  I  Volume  CdA  Ca
(#)  (-)  (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)
1    KIND     10.0 2.0 -1.0 0 0 TURN 1e5 0 1e6 100 0 0
---------------------- POINTS"""


def test_points_on_a_coupled_body_are_held(tmp_path):
    file = tmp_path / "deck.txt"
    text = DECK.replace("---------------------- POINTS", BODIES.replace("TURN", "0")).replace(
        "2     Coupled ", "2     Body1 "
    )
    file.write_text(text.replace("KIND", "Coupled"))
    found = read_moordyn(file)
    top = next(point for point in found["point"] if point["name"] == "fairlead")
    assert top.get("kind", "fixed") == "fixed"
    assert top["position"] == [10.0, 2.0, -6.0]
    assert any("on coupled body 1" in note for note in found["notes"])
    file.write_text(text.replace("KIND", "Free"))
    with pytest.raises(SceneError, match="bodies that move by themselves are not read"):
        read_moordyn(file)
