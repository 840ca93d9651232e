"""What written decks have of bodies, vessels, floats and a sea of their own, and what they list as lost."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError, load_scene, write_moordyn
from dropper_jax.decks.writing.differences import WRITTEN_FIELDS, differences
from dropper_jax.effects import EFFECTS

CHAIN, FLOAT = ((Path(__file__).parent / f"{name}.txt").read_text() for name in ("chain", "float"))


def test_bodies_go_to_a_file_and_back(tmp_path):
    scene = load_scene("ballasted-spar").with_values({"body.0.attitude": [0.0, 0.1, 0.0], "body.0.pinned": True})
    notes = write_moordyn(scene, tmp_path / "spar.txt")
    assert [note for note in notes if note.startswith("body")] == [
        "body 'spar': cylinder 0 has exposed ends 'from'; MoorDyn exposes both",
        "body 'spar': touches_bed = false is not represented; MoorDyn's rods touch the seabed",
    ]
    (body,), (ours,) = load_scene(tmp_path / "spar.txt").bodies, scene.bodies
    for key in ("mass", "centre_of_mass", "inertia", "position", "attitude", "pinned"):
        np.testing.assert_allclose(getattr(body, key), getattr(ours, key), rtol=1e-12, atol=1e-12)
    for key in ("start", "end", "diameter", "slices", "cdn", "cdt", "can", "cat"):
        np.testing.assert_array_equal(getattr(body.cylinders[0], key), getattr(ours.cylinders[0], key))
    assert [place.tolist() for place in body.attachments.values()] == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        ({"body.0.attitude": [0.1, 0.1, 0.0]}, "body.0.attitude: .* about one of x, y and z"),
        ({"body.0.inertia": [6e4, 6e4, 8e2, 10.0, 0.0, 0.0]}, "body.0.inertia: .* no products of inertia"),
        ({"body.0.spheres": [{"centre": [0.0, 0.0, 12.0], "diameter": 1.0}]}, "body.0.spheres: .* one sphere there"),
    ],
)
def test_a_body_that_moordyn_does_not_have_is_refused(change, refused, tmp_path):
    with pytest.raises(SceneError, match=refused):
        write_moordyn(load_scene("ballasted-spar").with_values(change), tmp_path / "spar.txt")
    assert list(tmp_path.iterdir()) == []


def vessel_scene() -> dict:
    kind = {"name": "rope", "mass": 5.0, "diameter": 0.05, "EA": 1e6, "cdn": 1.2, "cdt": 0.0, "can": 1.0, "cat": 0.0}
    rows = [[0.0] * 6, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
    return {
        "run": {"dt": 0.1, "duration": 1.0},
        "line_type": [kind],
        "point": [{"name": "anchor", "position": [0.0, 0.0, -20.0]}],
        "vessel": [
            {"name": "barge", "position": [20.0, 0.0, 0.0], "attachments": {"fairlead": [-2.0, 0.0, 0.0]}}
            | {"time": [0.0, 1.0], "motion": rows}
        ],
        "line": [{"name": "leg", "from": "anchor", "to": "fairlead", "type": "rope", "length": 28.0, "links": 4}],
        "sea": {"depth": 20.0, "current": {"kind": "uniform", "speed": 1.0}},
        "effects": {name: {} for name in ("weight", "buoyancy", "morison_drag", "morison_inertia", "seabed")},
    }


def test_points_of_a_vessel_are_coupled_and_their_motion_is_listed_as_lost(tmp_path):
    notes = write_moordyn(vessel_scene(), tmp_path / "deck.txt")
    assert notes.count("vessel 'barge': point 'fairlead' is Coupled; its motion is not in the file") == 1
    assert " Coupled 18.0 0.0 0.0 " in (tmp_path / "deck.txt").read_text()


def test_floats_that_moordyn_keeps_wet_above_the_surface_are_listed(tmp_path):
    # measured: a float of 0.1 m3 on 25 m of rope in 20 m of water rests 5.2 m above it in MoorDyn 2.7.2, afloat here
    scene = vessel_scene()
    scene["point"].append({"name": "float", "position": [9.0, 0.0, -8.0], "kind": "free", "mass": 10.0, "volume": 0.1})
    scene["line"].append({**scene["line"][0], "name": "riser", "to": "float"})
    note = "points that float ('float'): MoorDyn treats their full volume as submerged, also above the surface"
    assert note in write_moordyn(scene, tmp_path / "deck.txt")
    scene["point"][-1]["mass"] = 110.0  # it sinks
    assert note not in write_moordyn(scene, tmp_path / "deck.txt")


def test_every_value_of_an_effect_that_a_file_cannot_have_is_listed_as_lost(tmp_path):
    scene = vessel_scene()
    scene["line"][0]["shelter"] = 0.6
    notes = write_moordyn(scene, tmp_path / "deck.txt")
    assert "effects.morison_drag.shelter: not represented" in notes
    scene = load_scene(vessel_scene())
    for name in scene.effects:
        for field in dataclasses.fields(EFFECTS[name]):
            default = field.default
            if "kind" not in field.metadata or field.name in WRITTEN_FIELDS[name]:
                continue
            other = next((c for c in field.metadata.get("choices") or () if c != default), 0.5)
            changed = {**scene.effects, name: {**scene.effects[name], field.name: other}}
            notes = differences(dataclasses.replace(scene, effects=changed))
            assert f"effects.{name}.{field.name}: not represented" in notes


def test_two_decks_in_one_folder_do_not_share_a_sea_silently(tmp_path):
    scene = vessel_scene()
    scene["sea"]["waves"] = {"kind": "regular", "amplitude": 1.0, "period": 8.0}
    write_moordyn(scene, tmp_path / "first.txt")
    before = {file.name: file.read_text() for file in tmp_path.iterdir()}
    write_moordyn(scene, tmp_path / "first.txt")  # again: nothing differs
    other = {**scene, "sea": {**scene["sea"], "waves": {"kind": "regular", "amplitude": 2.0, "period": 8.0}}}
    with pytest.raises(SceneError, match=r"wave_frequencies.txt: exists and differs.*--force"):
        write_moordyn(other, tmp_path / "second.txt")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == before
    write_moordyn(other, tmp_path / "second.txt", force=True)
    assert (tmp_path / "wave_frequencies.txt").read_text() != before["wave_frequencies.txt"]
    flow = lambda speed: {**scene, "sea": {**scene["sea"], "waves": None, "current": {"speed": speed}}}  # noqa: E731
    write_moordyn(flow(0.5), tmp_path / "slow.txt", force=True)
    before = {file.name: file.read_text() for file in tmp_path.iterdir()}
    with pytest.raises(SceneError, match=r"current_profile.txt: exists and differs.*--force"):
        write_moordyn(flow(0.8), tmp_path / "fast.txt")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == before
    for deck, deep in (("a.txt", 20.0), ("b.txt", 25.0)):
        sloped = {**scene, "effects": {**scene["effects"], "seabed": {}}}
        sloped["effects"]["seabed"] = {"bed_x": [-50.0, 50.0], "bed_y": [-50.0, 50.0], "bed_depth": [20.0, deep] * 2}
        write_moordyn(sloped, tmp_path / deck, force=True)
    assert (tmp_path / "a-seafloor.txt").read_text() != (tmp_path / "b-seafloor.txt").read_text()
    assert load_scene(tmp_path / "a.txt").effects["seabed"]["bed_depth"].tolist() == [20.0] * 4


def test_a_deck_writes_its_output_as_often_as_the_run_is_saved(tmp_path):
    write_moordyn(load_scene("paper-case-4").with_values({"run.save_interval": 0.25}), tmp_path / "deck.txt")
    assert "\n0.25 dtOut\n" in (tmp_path / "deck.txt").read_text()


def test_damped_ropes_next_to_ropes_are_listed_as_such_a_deck_has_one_law(tmp_path):
    table = load_scene("platform-longline").as_written()
    table["line_type"][0]["law"] = "damped_rope"
    lost = write_moordyn(table, tmp_path / "mixed.txt", force=True)
    assert sum("axial law 'damped_rope' is read again as 'rope'" in words for words in lost) >= 1
    assert {line.axial_law for line in load_scene(tmp_path / "mixed.txt").lines} == {"rope"}
