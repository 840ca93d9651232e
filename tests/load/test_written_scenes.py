"""Values by path mean what they mean in the file, also where lines are written by the metre."""

import json

import numpy as np
import pytest

from dropper_jax import Scene, SceneError, load_scene
from dropper_jax.plausibility.plausibility import scene_warnings
from dropper_jax.scene import whole_lines


def test_length_and_links_by_path_are_those_of_the_whole_line():
    scene = load_scene("paper-case-1").with_values({"line.chain.length": 55.0, "line.chain.links": 20})
    (line,) = scene.lines
    np.testing.assert_allclose(line.length, np.full(20, 55.0 / 20), rtol=1e-14)
    np.testing.assert_allclose(line.mass, 10.91 * 55.0 / 20, rtol=1e-14)
    # the internal damping of a ratio is that of the new links
    np.testing.assert_allclose(line.axial_damping, 0.1 * 55.0 / 20 * np.sqrt(48884000.0 * 10.91), rtol=1e-14)
    np.testing.assert_array_equal(scene.effects["morison_drag"]["cdn"], [1.4] * 20)


def test_a_value_of_a_line_type_reaches_all_its_lines():
    scene = load_scene("edulis-longline").with_values({"line_type.sock.EA": 1e5, "line_type.0.cdn": 1.1})
    stiffness = {line.name: set(line.EA) for line in scene.lines}
    assert {name for name, values in stiffness.items() if values == {1e5}} == {f"sock-{i}" for i in range(1, 11)}
    drag = np.split(scene.effects["morison_drag"]["cdn"], np.cumsum([line.links for line in scene.lines]))
    chains = [values for line, values in zip(scene.lines, drag, strict=False) if set(line.EA) == {48884000.0}]
    assert len(chains) == 4
    assert all(set(values) == {1.1} for values in chains)


def test_attached_points_move_and_pieces_know_their_line():
    scene = load_scene("edulis-longline").with_values({"line.backbone.attach.0.at": 5.0, "line.backbone.length": 58.0})
    pieces = [line for line in scene.lines if line.piece_of == "backbone"]
    np.testing.assert_allclose([p.total for p in pieces], np.diff([0, 5, *np.arange(2, 10) * 5.7, 58.0]), rtol=1e-12)
    whole = next(line for line in whole_lines(scene) if line.name == "backbone")
    assert (whole.pieces, whole.spec.total) == (10, pytest.approx(58.0))
    assert list(whole.stops.values()) == ["west-buoy", *(f"v{i}" for i in range(1, 10)), "east-buoy"]
    # every joint once: links + 1 nodes, and stops at the ends of the pieces
    assert len(whole.nodes) == whole.spec.links + 1
    assert list(whole.stops) == [0, *np.cumsum([p.links for p in pieces])]


def test_attached_points_follow_the_ends_of_their_line():
    scene = load_scene("platform-longline")
    table = scene.as_written()
    table["point"][2]["position"] = [27.0, 1.0, -9.0]
    moved = scene.with_values({"point.joint.position": [27.0, 1.0, -9.0]})
    assert moved == Scene.from_dict(table)
    assert moved.points[3].position[1] > 0.0
    own = moved.with_values({f"point.{moved.points[3].name}.position": [30.0, 0.0, -9.0]})
    assert list(own.point(moved.points[3].name).position) == [30.0, 0.0, -9.0]


def test_values_of_single_links_come_after_those_of_the_line():
    values = {"line.chain.diameter": 0.05, "line.chain.links": 15, "effects.morison_drag.cdn.3": 2.0}
    scene = load_scene("paper-case-1").with_values(values)
    np.testing.assert_array_equal(scene.lines[0].diameter, np.full(15, 0.05))
    np.testing.assert_array_equal(scene.effects["morison_drag"]["cdn"], [1.4] * 3 + [2.0] + [1.4] * 11)


@pytest.mark.parametrize("name", ["paper-case-5", "edulis-longline", "dropper-farm-3"])
def test_a_scene_survives_as_it_was_written(name):
    scene = load_scene(name).with_values({"run.duration": 1.0})
    again = Scene.from_dict(json.loads(json.dumps(scene.as_written())))
    assert again == scene
    assert again.written == scene.written is not None
    assert "line_type" in scene.as_written()


def test_arrays_of_a_line_type_are_kept_as_plain_values():
    table = load_scene("paper-case-4").as_written()
    kind = {key: value for key, value in table["line_type"][0].items() if key != "EA"}
    rows = {"law": "tabulated", "strain": np.array([0.0, 0.01]), "tension": np.array([0.0, 5e5])}
    scene = Scene.from_dict({**table, "line_type": [{**kind, **rows}]})
    assert Scene.from_dict(json.loads(json.dumps(scene.as_written()))) == scene
    assert scene.with_values({"line_type.chain.tension.1": 6e5}).lines[0].tables[0].tension[1] == 6e5
    assert (scene.value("line_type.chain.tension.1"), scene.value("point.anchor.position.2")) == (5e5, -30.0)


SECTIONS = [{"type": "chain", "length": 20.0, "links": 4}, {"type": "chain", "length": 30.0, "links": 5}]


def with_sections() -> Scene:
    table = load_scene("paper-case-1").as_written()
    line = {key: value for key, value in table["line"][0].items() if key not in ("type", "length", "links")}
    return Scene.from_dict({**table, "line": [{**line, "sections": SECTIONS}]})


def test_sections_are_changed_one_by_one_and_their_line_has_no_length_to_change(refusal):
    scene = with_sections().with_values({"line.chain.sections.1.length": 35.0})
    np.testing.assert_allclose(scene.lines[0].length, [5.0] * 4 + [7.0] * 5, rtol=1e-14)
    message = refusal(scene.with_values, {"line.chain.length": 55.0})
    assert "Use line.chain.sections.0.length and so on" in message


@pytest.mark.parametrize(
    ("sections", "lacking"), [([3000.0, None], True), ([3000.0, 4000.0], False), ([None] * 2, False)]
)
def test_a_line_of_which_only_some_types_have_a_breaking_load_is_warned_of(sections, lacking):
    table = with_sections().as_written()
    kinds = [{**table["line_type"][0], "name": name} for name in ("old", "new")]
    for kind, section, load in zip(kinds, table["line"][0]["sections"], sections, strict=True):
        section["type"] = kind["name"]
        if load is not None:
            kind["breaking_load"] = load
    scene = Scene.from_dict({**table, "line_type": kinds})
    found = [text for text in scene_warnings(scene) if "line 'chain': has no breaking load, as its type 'new'" in text]
    assert len(found) == lacking
    assert (scene.lines[0].breaking_load is None) == (None in sections)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("line.chain.lenght", 55.0, "did you mean 'line.chain.length'"),
        ("line_type.chian.EA", 1e7, "did you mean 'line_type.chain.EA'"),
        ("line_type.chain.EA", 0.0, "allowed: a number > 0 N"),
        ("odd.path", 1.0, "known sections: buoy, description, effects, line, line_type,"),
    ],
)
def test_a_wrong_path_is_refused_in_one_line(path, value, words):
    with pytest.raises(SceneError, match=words) as caught:
        load_scene("paper-case-1").with_values({path: value})
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t["line"][4]["attach"][1].update(at=5.7), "'v1' and 'v2' are both at 5.7 m"),
        (lambda t: t["line"][4]["attach"][1].update(at=1e-320), "1e-320 is not on the line; allowed: above 0"),
        (lambda t: t["line"][4].pop("type"), "line.4.attach: the line has no type; `attach` needs one"),
        (lambda t: t["line"][4].update(EA=1.0), "line.4.EA: unknown key; known: attach, axial,"),
        (
            lambda t: t.update(failure=[{"line": "backbone", "load": 1e4}]),
            "one of its pieces, backbone-1 to backbone-10",
        ),
    ],
)
def test_mistakes_with_attached_points_are_named(change, words):
    table = load_scene("edulis-longline").as_written()
    change(table)
    with pytest.raises(SceneError, match=words):
        Scene.from_dict(table)


SLOPE = {"bed_x": [-10.0, 10.0, 60.0], "bed_y": [-20.0, 20.0], "bed_depth": [30.0, 30.0, 30.0, 30.0, 20.0, 20.0]}
LYING = {
    "run": {"dt": 0.01, "duration": 0.1},
    "point": [{"name": "a", "position": [0.0, 0.0, -5.0]}, {"name": "b", "kind": "free", "position": [3.0, 0.0, -5.0]}],
    "line": [{"name": "l", "from": "a", "to": "b", "links": 3, "length": 1.0, "mass": 1.0, "diameter": 0.05}],
    "effects": {"weight": {}, "seabed": {"depth": 5.2}},
    "start": {"kind": "angles", "zero": "horizontal", "polar": [0.1, 0.1, 0.0]},
}


@pytest.mark.parametrize(
    ("point", "position", "words"),
    [
        # the bed rises from 30 m at x = 10 to 20 m at x = 60: by 0.2 per metre
        ("anchor", [40.0, 0.0, -24.1], "z = -24.1 m is below the seabed; .* >= -24 m"),
        ("buoy", [55.0, 0.0, -22.0], "z = -22 m is below the seabed; .* >= -21 m"),
    ],
)
def test_a_point_below_the_bed_at_its_place_is_named(point, position, words):
    table = load_scene("paper-case-4").as_written()
    table["effects"]["seabed"] = SLOPE
    with pytest.raises(SceneError, match=f"point.{point}.position: {words}"):
        Scene.from_dict(table).with_values({f"point.{point}.position": position})
    Scene.from_dict(table).with_values({"point.anchor.position": [40.0, 0.0, -24.0]})


def test_a_node_of_a_given_pose_below_the_bed_is_named():
    Scene.from_dict(LYING)  # its lowest nodes are at -5 - 2 sin 0.1 = -5.1997
    with pytest.raises(SceneError, match=r"start.polar: node 2 is at z = -5.29556 m, below .* allowed: >= -5.2 m"):
        Scene.from_dict(LYING).with_values({"start.polar": [0.1, 0.197, 0.0]})
    Scene.from_dict(LYING).with_values({"start.polar": [0.1, 0.12, 0.0]})  # pressed in by less than its diameter


def test_shelter_of_both_lines_and_drag_is_refused_never_ignored():
    table = load_scene("paper-case-4").as_written()
    table["effects"]["morison_drag"].pop("shelter", None)
    table["line"][0]["shelter"] = 0.5
    scene = Scene.from_dict(table)
    with pytest.raises(SceneError, match="effects.morison_drag.shelter: cannot be combined with line.shelter"):
        scene.with_values({"effects.morison_drag.shelter": 0.7})


def test_a_length_changed_after_a_single_link_is_that_of_the_line():
    scene = load_scene("paper-case-1")
    values = {"line.0.axial.EA": 1e6, "line.chain.mass.2": 30.0, "line.chain.length": 55.0, "run.duration": 2.0}
    one_by_one = scene
    for path, value in values.items():
        one_by_one = one_by_one.with_values({path: value})
    assert one_by_one.lines[0].total == pytest.approx(55.0)
    assert one_by_one.to_dict() == scene.with_values(values).to_dict()
