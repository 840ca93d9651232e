"""Moorings of MoorPy's and RAFT's YAML files: tensions at rest are MoorPy's, what is not read is named."""

from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError

yaml = pytest.importorskip("yaml")
FILE = Path(__file__).parent / "raft.yaml"
TEXT = FILE.read_text()
#: Forces [N] on the points that MoorPy 1.3.0 gives (`System.parseYAML`, `solveEquilibrium`, `Line.fA` and `fB`):
#: tension at the very end of the line, the point's share of its weight included.
MOORPY = {
    "fairlead west": [-1000187.27, 0.0, -623894.14],
    "fairlead east": [786852.68, 110824.32, -395138.42],
    "anchor west": [1000187.27, 0.0, 0.0],
    "anchor east": [-786852.68, -110824.32, 0.0],
}


def test_forces_at_rest_are_those_of_moorpy():
    found = dj.Coupled(FILE, points=list(MOORPY)).init()
    for force, (name, other) in zip(found, MOORPY.items(), strict=True):
        if name.startswith("anchor"):  # the bed carries what hangs at an anchor
            force = force * [1.0, 1.0, 0.0]
        assert np.linalg.norm(force - other) < 0.01 * np.linalg.norm(other), name


def test_what_is_not_read_is_named():
    notes = "\n".join(dj.load_scene(FILE).notes)
    outside = ("settings", "mooring.anchor_types", "points.0.anchor_type", "line_types.0.cost")
    for word in (*outside, "is on the vessel: it is fixed", "tangential_drag, transverse_added", "20 links"):
        assert word in notes


def changed(tmp_path, old, new, name="deck.yaml"):
    assert old in TEXT
    file = tmp_path / name
    file.write_text(TEXT.replace(old, new))
    return file


def test_moorpys_own_files_have_no_mooring_around(tmp_path):
    inner = yaml.safe_load(TEXT)["mooring"]
    file = tmp_path / "deck.yml"
    file.write_text(yaml.safe_dump(inner))
    for key in ("line", "point", "effects", "sea"):
        assert dj.load_scene(file).to_dict()[key] == dj.load_scene(FILE).to_dict()[key]
    deep = {key: value for key, value in inner.items() if key != "water_depth"}
    file.write_text(yaml.safe_dump(deep))
    with pytest.raises(SceneError, match=r"deck\.yml: water_depth: missing; needed: > 0 m, in the file or as --depth"):
        dj.load_scene(file)


def test_a_point_without_a_name_is_noted_with_the_one_it_is_given(tmp_path):
    file = changed(tmp_path, "name: fairlead west, ", "")
    file.write_text(file.read_text().replace("endB: fairlead west", "endB: point-2"))
    assert any("points.1: 'point-2' is on the vessel" in note for note in dj.load_scene(file).notes)


def test_a_file_that_names_a_moordyn_file_is_that(tmp_path):
    (tmp_path / "chain.txt").write_text((FILE.parent / "chain.txt").read_text())
    file = tmp_path / "deck.yaml"
    file.write_text("mooring: {file: chain.txt}\n")
    assert [line.name for line in dj.load_scene(file).lines] == ["line-1"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("endA: anchor west", "endA: anchr west", "lines.0.endA: 'anchr west' is not in the file; did you mean"),
        ("type: wire", "type: wird", "lines.2.type: 'wird' is not in the file; did you mean 'wire'"),
        ("length: 795.0", "length: long", "lines.0.length: 'long' is not a number; allowed: a number > 0"),
        ("length: 795.0", "length: -1", "lines.0.length: -1 is out of range"),
        ("stiffness: 7.536e8, ", "", "line_types.0.stiffness: missing"),
        ("diameter: 0.10,", "diameter: .nan,", "line_types.1.diameter: nan is not finite"),
        ("type: free", "type: body1", "points.3.type: 'body1' is on a body"),
        ("type: free", "type: swivel", "points.3.type: 'swivel' is unknown; allowed: fixed, vessel, free"),
        ("[750.0, 100.0, -200.0]", "[750.0, 100.0]", r"points.2.location: \[750.0, 100.0\] is not a position"),
        ("name: clump, ", "name: anchor east, ", "points.3.name: 'anchor east' is duplicate"),
        ("  lines:", "  lines: []\n  rows:", "lines: missing; needed: a list"),
        ("settings:", "settings: [", "line [0-9]+: YAML syntax"),
        ("water_depth: 200\n  points", "water_depth: deep\n  points", "water_depth: 'deep' is not a number"),
    ],
)
def test_refusals_name_file_place_and_what_is_allowed(tmp_path, old, new, message):
    with pytest.raises(SceneError, match=rf"deck\.yaml: {message}") as caught:
        dj.load_scene(changed(tmp_path, old, new))
    assert "\n" not in str(caught.value)
