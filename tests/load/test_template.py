"""Parameters, repetitions and arrays of scenes: what they stand for, who reaches them, and what is refused."""

import copy
import math

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import Scene, SceneError, as_toml, build_model, packaged_scene
from dropper_jax.load.expressions import evaluate
from dropper_jax.load.packaged import parse_toml
from fitting.parameters.scene_parameters import find_parameters

FARM = {
    "name": "farm-{loops}",
    "parameters": {"loops": 3, "spacing": 2.5, "loop": 6.0, "span": "= loops * spacing"},
    "run": {"dt": 0.02, "duration": 2.0},
    "line_type": [{"name": "rope", "mass": 2.0, "diameter": 0.05, "EA": 1e5, "damping": 1e3}],
    "point_type": [{"name": "buoy", "float": 0.2}],
    "point": [
        {"name": "west", "position": [0.0, 0.0, 0.0]},
        {"name": "east", "position": ["= span + spacing", 0.0, 0.0]},
        {"repeat": {"k": "= loops"}, "name": "f-{k}", "type": "buoy", "position": ["= k * spacing", 0.0, 0.0]},
    ],
    "line": [
        {"name": "head", "from": "west", "to": "east", "type": "rope", "length": "= 1.1 * (span + spacing)"}
        | {"links": "= 2 * (loops + 1)"}
        | {"attach": [{"repeat": {"k": "= loops"}, "point": "f-{k}", "at": "= 1.1 * k * spacing"}]},
        {"repeat": {"k": [1, "= loops - 1"]}, "name": "loop-{k}", "from": "f-{k}", "to": "f-{k + 1}"}
        | {"type": "rope", "length": "= loop + 0.1 * k", "links": 4},
    ],
    "effects": {"weight": {}},
}


def changed(**values):
    return {**copy.deepcopy(FARM), **values}


ROPE = {
    "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [10.0, 0.0, 0.0]}],
    "line": [{"name": "l", "from": "a", "to": "b", "type": "rope", "length": 11.0, "links": 4}],
}


def ropes(line=(), points=(), **array):
    """An array of ropes over 10 m, with other values of their line, further points of the scene and of the array."""
    unit = copy.deepcopy(ROPE)
    unit["line"][0].update(line)
    table = {key: FARM[key] for key in ("run", "line_type", "effects")}
    return {**table, "point": list(points), "unit": {"rope": unit}, "array": [{"of": "rope", "name": "k-"} | array]}


def test_the_plain_scene():
    scene = dj.load_scene(FARM)
    assert scene.name == "farm-3"
    assert [p.name for p in scene.points] == ["west", "east", "f-1", "f-2", "f-3"]
    np.testing.assert_allclose([p.position[0] for p in scene.points], [0.0, 10.0, 2.5, 5.0, 7.5])
    assert [line.name for line in scene.lines] == ["head-1", "head-2", "head-3", "head-4", "loop-1", "loop-2"]
    assert [float(line.length.sum()) for line in scene.lines[-2:]] == pytest.approx([6.1, 6.2])
    sphere = math.pi / 4 * (6 * 0.2 / math.pi) ** (2 / 3)
    assert scene.point("f-2").drag_area == pytest.approx(0.5 * sphere)
    assert (scene.point("f-2").mass, scene.point("f-2").volume) == (16.0, 0.2)


def test_parameters_by_path_and_what_was_changed_before_stays():
    scene = dj.load_scene(FARM).with_values({"run.duration": 5.0, "line.loop-2.length": 7.0})
    more = scene.with_values({"parameters.loops": 4, "parameters.loop": 8.0})
    assert more.value("parameters.span") == 10.0
    assert len([line for line in more.lines if line.name.startswith("loop-")]) == 3
    assert more.run.duration == 5.0
    assert [float(line.length.sum()) for line in more.lines[-3:]] == pytest.approx([8.1, 7.0, 8.3])


def test_a_parameter_is_a_number_that_varies():
    """The model that is moved along a parameter is the one of the changed scene."""
    scene = dj.load_scene(FARM)
    model = build_model(scene)
    (loop,) = find_parameters(scene, model, ["parameters.loop"], "to")
    assert (loop.value, loop.name) == (6.0, "parameters.loop")
    moved, built = loop.where.set_in(model, 6.6), build_model(scene.with_values({"parameters.loop": 6.6}))
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(built), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9)
    with pytest.raises(SceneError, match="whole number"):
        find_parameters(scene, model, ["parameters.loops"], "to")


def test_the_same_from_toml():
    again = Scene.from_dict(parse_toml(as_toml(FARM).encode(), "farm"))
    assert again.to_dict() == dj.load_scene(FARM).to_dict()


def test_a_point_along_a_line_of_a_unit_needs_no_name():
    scene = dj.load_scene(ropes({"attach": [{"at": 5.0}]}))
    assert [point.name for point in scene.points] == ["k-a", "k-b", "k-l-at-5"]
    assert [(line.start, line.end) for line in scene.lines] == [("k-a", "k-l-at-5"), ("k-l-at-5", "k-b")]


def test_units_that_share_a_point_agree_on_its_position(refusal):
    row = {"repeat": {"k": 2}, "name": "r{k}-", "shared": {"a": "p-{k}", "b": "p-{k + 1}"}}
    scene = dj.load_scene(ropes(**row, origin=["= 10 * k / cos(0)", 0.0, 0.0]))
    assert [point.name for point in scene.points] == ["p-1", "p-2", "p-3"]
    message = refusal(dj.load_scene, ropes(**row, origin=["= 10.5 * k", 0.0, 0.0]))
    assert message.startswith("array.0.shared.a: 'p-2' is at (20.5, 0, 0) m, but at (21, 0, 0) m in this unit")
    anchor = {"name": "p-1", "position": [0.0, 0.1, 0.0]}
    assert "shared.a: 'p-1' is at (0, 0.1, 0) m" in refusal(dj.load_scene, ropes(points=[anchor], shared={"a": "p-1"}))


def test_descriptions_and_notes_are_free_texts():
    scene = dj.load_scene(changed(description="= a scene with {braces}", notes=["= a note", "with {braces}"]))
    assert scene.description == "= a scene with {braces}"
    assert list(scene.notes) == ["= a note", "with {braces}"]


def test_different_numbers_give_different_names():
    numbers = {**FARM["parameters"], "x": 1234567.0}
    assert (
        dj.load_scene(changed(parameters=numbers, name="{x} {x + 1} {x / 2} {3 * 0.1}")).name
        == "1234567 1234568 617283.5 0.3"
    )


def test_a_long_chain_of_parameters_has_a_value_or_one_short_reason(refusal):
    """Each is evaluated once, however many refer to it."""
    chain = {f"p{i}": f"= p{i - 1} + p{i - 1}" for i in range(400, 0, -1)}
    numbers = {**FARM["parameters"], **chain, "max": "= max(loops, 2)"}
    scene = dj.load_scene(changed(parameters={**numbers, "p0": 1}))
    assert (scene.value("parameters.p400"), scene.value("parameters.max")) == (2.0**400, 3.0)
    message = refusal(dj.load_scene, changed(parameters={**numbers, "p0": "= 1 / 0"}))
    assert message == "parameters.p0: '1 / 0' has no value (division by zero); allowed: a finite number"


def test_rows_of_units_with_heading_and_shared_anchors():
    unit = {
        "point": [
            {"name": "a", "position": [0.0, 0.0, -10.0]},
            {"name": "b", "position": [20.0, 0.0, -10.0]},
            {"name": "top", "kind": "free", "position": [10.0, 0.0, 0.0]},
        ],
        "line": [
            {"name": f"leg-{end}", "from": end, "to": "top", "type": "rope", "length": 15.0, "links": 3}
            for end in ("a", "b")
        ],
        "buoy": [{"name": "spar", "point": "top", "mass": 50.0, "diameter": 0.5, "height": 2.0}],
    }
    array = {
        "of": "longline",
        "repeat": {"row": 2, "column": 3},
        "name": "r{row}c{column}-",
        "origin": ["= 20 * (column - 1) * cos(radians(30))", "= 20 * (column - 1) * sin(radians(30)) + 40 * row", 0.0],
        "heading": 30.0,
        "shared": {"a": "anchor-{row}-{column}", "b": "anchor-{row}-{column + 1}"},
    }
    table = {key: FARM[key] for key in ("run", "line_type", "effects")} | {"sea": {"depth": 10.0}}
    scene = dj.load_scene({**table, "unit": {"longline": unit}, "array": [array]})
    assert len(scene.lines) == 12
    assert len(scene.points) == 2 * (4 + 3)
    ends = {line.name: (line.start, line.end) for line in scene.lines}
    assert ends["r2c2-leg-a"] == ("anchor-2-2", "r2c2-top")
    assert ends["r2c1-leg-b"][0] == "anchor-2-2"
    turned = np.array([math.cos(math.pi / 6), math.sin(math.pi / 6)])
    np.testing.assert_allclose(scene.point("anchor-2-4").position[:2], 60 * turned + [0.0, 80.0])
    np.testing.assert_allclose(scene.point("r1c1-top").position, [*(10 * turned + [0.0, 40.0]), 0.0])


@pytest.mark.parametrize(
    ("repeat", "words"), [("= -6 * 1", "-6 makes -6 copies; allowed: a count >= 0"), ([4, 1], "[4, 1] makes -2 copies")]
)
def test_a_negative_repeat_is_refused(repeat, words, refusal):
    point = {"repeat": {"k": repeat}, "name": "end-{k}", "position": [0.0, 0.0, 0.0]}
    table = {key: FARM[key] for key in ("run", "line_type", "line", "effects", "parameters")}
    assert f".repeat.k: {words}" in refusal(dj.load_scene, {**table, "point": [*FARM["point"], point]})
    with pytest.raises(SceneError, match="makes -4 copies"):
        dj.load_scene("dropper-farm").with_values({"parameters.droppers": -4})


def test_the_packaged_farm_is_such_a_scene():
    found = dj.load_scene("dropper-farm-20")
    assert found.name == "dropper-farm-20"
    assert found.value("parameters.backbone_length") == 61.0
    assert sum(line.name.startswith("dropper-") for line in found.lines) == 20
    # 0.85 to the power of the droppers before it, at least 0.4, on 18 links each
    np.testing.assert_allclose(
        found.effects["morison_drag"]["shelter"][-20 * 18 :: 18][:7], [0.85**k for k in range(6)] + [0.4]
    )
    assert "parameters" in packaged_scene("dropper-farm")


@pytest.mark.parametrize(
    ("text", "value"),
    [("2 + 3 * 4", 14), ("-(7 // 2)", -3), ("2 ** 10", 1024.0), ("max(1, sqrt(x))", 3.0), ("round(pi * 100)", 314)],
)
def test_arithmetic(text, value):
    assert evaluate(text, {"x": 9.0}, "here") == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("__import__('os')", "unknown"),
        ("x.real", "is not allowed in an expression"),
        ("[1][0]", "is not allowed"),
        ("y + 1", "'y' is unknown"),
        ("1 / (x - x)", "has no value"),
        ("10.0 ** 400", "has no value"),
        ("*".join(["floor(1e308)"] * 16), "has no value"),
        ("9 ** 9 ** 9 ** 9", "has no value"),
        ("x +", "is not a valid expression"),
        ("(" * 300, "is not a valid expression"),
        ("1 if x else 2", "is not allowed"),
        ("'a' * 9", "is not allowed"),
        ("+".join("1" * 400), "characters"),
    ],
)
def test_only_arithmetic(text, message):
    with pytest.raises(SceneError, match=message):
        evaluate(text, {"x": 1.0}, "here")


def with_parameters(**numbers):
    return changed(parameters={"loops": 3, "spacing": 1.0, "loop": 1.0, "span": 1.0, **numbers})


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (changed(parameters={"a": "= b", "b": "= a"}), ": circular reference: "),
        (with_parameters(loops=2.5), "2.5 is not a whole number"),
        (with_parameters(loops=1e9), "more than 20000 parts"),
        (with_parameters(spacing="wide"), "parameters.spacing: 'wide' is unknown"),
        (changed(parameters={"1st": 3}), "parameters.1st: is not a valid name"),
        (changed(point_type=[{"name": "other"}]), "'buoy' is unknown"),
        (changed(point_type=[{"name": "buoy", "float": -1.0}]), "point.2.float: -1.0 is out of range"),
        (changed(array=[{"of": "row"}]), "array.0.of: 'row' is unknown"),
        (changed(array=[{"off": "row"}]), "array.0.off: unknown key"),
        (ropes(origin=0), "array.0.origin: 0 is not a list"),
        (ropes(origin=False), "array.0.origin: False is not a list"),
        (ropes(heading=""), "array.0.heading: '' is not a number"),
        (ropes(shared=[]), "array.0.shared: [] is not a table"),
        (ropes(shared={"a": ["x"]}), "array.0.shared.a: ['x'] is not a text"),
        (ropes(shared={"a": 3}), "array.0.shared.a: 3 is not a text"),
        (ropes({"from": ["a"]}), "unit.rope.line.0.from: ['a'] is not a text"),
        (ropes({"attach": [{"point": ["x"]}]}), "unit.rope.line.0.attach.0.point: ['x'] is not a text"),
        # points that are not shared have names of their own
        (ropes(points=[{"name": "k-a", "position": [0.0, 5.0, 0.0]}]), "array.0.name: 'k-a' is used twice; allowed: "),
        (ropes(repeat={"row": 2}), "array.0.name: 'k-a' is used twice; allowed: "),
    ],
)
def test_templates_that_stand_for_no_scene_are_refused_by_path(table, words, refusal):
    assert words in refusal(dj.load_scene, table)


def test_unknown_parameters_are_named():
    with pytest.raises(SceneError, match="parameters.lop: unknown parameter; .*loop"):
        dj.load_scene(FARM).with_values({"parameters.lop": 1.0})
    with pytest.raises(SceneError, match=r"has no \[parameters\]"):
        dj.load_scene("string").with_values({"parameters.loop": 1.0})
