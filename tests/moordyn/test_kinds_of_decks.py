"""One mooring in the ways its formats allow: all of them are the same scene, and what lacks something says what."""

from pathlib import Path

import pytest

from dropper_jax import SceneError, read_moordyn

FOLDER = Path(__file__).parent
DECK = (FOLDER / "chain.txt").read_text()
SAME = ("line_type", "point", "line", "effects", "sea")

VERSION_1 = (FOLDER / "version_1.txt").read_text()


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


def test_a_seafloor_file_is_found_next_to_its_deck(tmp_path, monkeypatch):
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
