"""Every bad input is refused with one line: the field, its value, what is allowed, the nearest name."""

import copy
import gc
import math
import os
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dropper_jax import Scene, SceneError, Solution, as_toml, build_model, cli, equilibrium, load_scene
from dropper_jax.base.files import read_lines
from dropper_jax.load.expressions import evaluate
from dropper_jax.load.paths import set_value

LOOP = {
    "description": "a loop of four links",
    "run": {"dt": 0.01, "duration": 1.0},
    "point": [{"name": "left", "position": [0, 0, 0]}, {"name": "right", "position": [0.2, 0.0, 0.0]}],
    "line": [{"name": "loop", "from": "left", "to": "right", "links": 4, "length": 0.1, "mass": 0.03}],
    "effects": {"weight": {}, "linear_damping": {"b_l": 0.002}},
}
REMOVE = object()


def _shown(value):
    """What a test is called after: the same in every process."""
    return "removed" if value is REMOVE else repr(value)


def changed(path: str, value: object) -> dict:
    """The loop with one value set, added or removed."""
    table = copy.deepcopy(LOOP)
    *parents, key = (int(part) if part.isdecimal() else part for part in path.split("."))
    place = table
    for part in parents:
        place = place[part] if isinstance(place, list) else place.setdefault(part, {})
    if value is REMOVE:
        del place[key]
    else:
        place[key] = value
    return table


BAD = [
    # unknown keys, with the nearest name
    ("runs", {}, "runs: unknown key", "'run'"),
    ("line.0.lenght", 0.1, "line.0.lenght: unknown key", "'length'"),
    ("effects.linear_dampin", {"b_l": 1}, "effects.linear_dampin: unknown key", "'linear_damping'"),
    ("effects.linear_damping.bl", 1.0, "effects.linear_damping.bl: unknown key", "'b_l'"),
    ("line.0.axial", {"law": "elastic", "EA": 1.0, "dampin": 0.1}, "line.0.axial.dampin: unknown key", "'damping'"),
    # missing values
    ("run", REMOVE, "run: missing", "`duration`"),
    ("line.0.mass", REMOVE, "line.0.mass: missing", "> 0 kg"),
    ("line", REMOVE, "line: missing", "[[line]]"),
    ("point", [], "point: missing", "[[point]]"),
    ("line.0.axial", {"law": "elastic"}, "line.0.axial.EA: missing", "> 0 N"),
    ("line.0.axial", {"damping": 1.0}, "line.0.axial.EA: missing", "> 0 N"),
    # wrong types; a truth value is not a number
    ("run.dt", "0.01", "run.dt: '0.01' is not a number", "> 0 s"),
    ("run.dt", True, "run.dt: True is not a number", "> 0 s"),
    ("run.save_every", 1.5, "run.save_every: 1.5 is not a whole number", ">= 1"),
    ("line.0.links", True, "line.0.links: True is not a whole number", ">= 1"),
    ("line.0.mass", {"a": 1}, "line.0.mass: {'a': 1} is not a number", "list of 4 numbers"),
    ("line.0.mass", [0.1, 0.1, "x", 0.1], "line.0.mass.2: 'x' is not a number", "> 0 kg"),
    ("line.0.name", 3, "line.0.name: 3 is not a text", "text"),
    ("line.0.name", "", "line.0.name: '' is not one line", "not empty"),
    ("line.0.name", "west\nleg", r"line.0.name: 'west\nleg' is not one line", "not empty"),
    ("point", {"name": "left"}, "point: {'name': 'left'} is not a list", "[[point]]"),
    ("point.0", 7, "point.0: 7 is not a table", "keys"),
    ("effects", [1], "effects: [1] is not a table", "keys"),
    (
        "effects.nodal_force",
        {"nodes": 2, "force_n": [[0, 0, 1]]},
        "effects.nodal_force.nodes: 2 is not a list",
        "whole",
    ),
    # out of range
    ("line.0.mass", -0.1, "line.0.mass: -0.1 is out of range", "> 0 kg"),
    ("line.0.mass", 0.0, "line.0.mass: 0.0 is out of range", "> 0 kg"),
    ("line.0.length", [0.1, 0.1, -0.1, 0.1], "line.0.length.2: -0.1 is out of range", "> 0 m"),
    ("line.0.links", 0, "line.0.links: 0 is out of range", ">= 1"),
    ("run.dt", 0.0, "run.dt: 0.0 is out of range", "> 0 s"),
    ("run.duration", 0.001, "run.duration: 0.001 is shorter than the step", "0.01 s"),
    ("run.save_interval", 500.0, "run.save_interval: 500.0 s is longer than the run", "at most its duration"),
    ("run.gamma", 1.5, "run.gamma: 1.5 is out of range", "0 to 1"),
    ("run.dtype", "float16", "run.dtype: 'float16' is unknown", "float64, float32"),
    ("point.1.kind", "fixd", "point.1.kind: 'fixd' is unknown", "'fixed'"),
    ("line.0.axial", {"law": "rubber"}, "line.0.axial.law: 'rubber' is unknown", "rigid, elastic"),
    ("effects.nodal_force", {"nodes": [9], "force_n": [[0, 0, 1]]}, "effects.nodal_force.nodes: 9", "1 to 4"),
    # wrong lengths of lists
    ("line.0.mass", [0.1, 0.1], "line.0.mass: [0.1, 0.1] has 2 entries", "4 numbers"),
    ("point.0.position", [0, 0], "point.0.position: [0, 0] has 2 entries", "3 numbers"),
    ("effects.joint_friction", {"dry": [1] * 4}, "effects.joint_friction.dry: [1, 1, 1, 1] has 4", "5 numbers"),
    ("start", {"kind": "angles", "polar": [0.1]}, "start.polar: [0.1] has 1 entries", "4, one per link"),
    ("start", {"kind": "positions", "positions": [[0, 0, 0]]}, "start.positions: [[0.0, 0.0, 0.0]] has 1 rows", "5"),
    # how the parts belong together
    ("point.1.name", "left", "point.1.name: 'left' is used twice", "a unique name"),
    ("line.0.to", "rigt", "line.0.to: 'rigt' is not a point", "'right'"),
    ("point.0.kind", "free", "point.0.kind: 'free' cannot be the start of a rigid line", "fixed"),
    ("point.1.position", [0.5, 0, 0], "line.0.length: the links are 0.4 m long in all", "0.5 m between"),
    ("line.0.length", [0.1, 0.1, 0.1, 0.9], "line.0.length: a link of 0.9 m cannot be closed", "less than 0.5 m"),
    ("line.0.inertia", 1e-4, "line.0.centre_of_mass: missing", "both"),
    ("line.0.centre_of_mass", 0.05, "line.0.inertia: missing", "both"),
    ("start", {"release_nodes": [1]}, "start: `release_nodes` and `release_force`", "together"),
    ("start", {"release_nodes": [4], "release_force": [[0, 0, 1]]}, "start.release_nodes.0: 4 is not", "1 to 3"),
    ("start", {"kind": "static", "polar": [0] * 4}, "start.polar: not used by kind 'static'", "release_force"),
    ("start", {"kind": "angles", "polar": [0.3] * 4}, "start.polar: node 4 is at", "the position of 'right'"),
    # the entry of a list
    ("start", {"release_nodes": [1], "release_force": [[0, math.nan, 1]]}, "start.release_force.0.1: nan is not", ""),
]


@pytest.mark.parametrize(
    ("path", "value", "named", "allowed"), BAD, ids=[f"{case[0]}={_shown(case[1])}"[:60] for case in BAD]
)
def test_bad_value_is_refused_by_name_with_what_is_allowed(path, value, named, allowed, refusal):
    message = refusal(Scene.from_dict, changed(path, value))
    assert message.startswith(named)
    assert allowed in message[len(named) :]


@pytest.mark.parametrize("zero", ["horizontal", "down"])
def test_start_angles_with_four_decimals_are_closed_and_those_further_off_are_refused(zero, refusal):
    """Two links down and two up, symmetric about the middle; the angles by which they close are known."""
    outer = np.arccos(0.6)
    polar = np.array([outer, np.arccos(0.4), -np.arccos(0.4), -outer])
    polar = polar if zero == "horizontal" else np.pi / 2 - polar
    start = {"kind": "angles", "zero": zero, "polar": np.round(polar, 4).tolist()}
    scene = Scene.from_dict(changed("start", start))
    along = np.cos(scene.start.polar) if zero == "horizontal" else np.sin(scene.start.polar)
    assert 0.1 * along.sum() == pytest.approx(0.2, abs=1e-13)
    np.testing.assert_allclose(scene.start.polar, polar, atol=1e-4)
    start["polar"] = (polar + [0.002, 0, 0, 0]).tolist()
    assert "the position of" in refusal(Scene.from_dict, changed("start", start))


NUMBERS = ["run.dt", "run.duration", "run.gamma", "line.0.length", "line.0.mass", "effects.weight.gravity"]
NUMBERS += ["effects.linear_damping.b_l", "point.1.position.2"]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 10**400])
@pytest.mark.parametrize("path", NUMBERS)
def test_a_number_that_is_not_finite_is_refused_everywhere(path, bad, refusal):
    message = refusal(Scene.from_dict, changed(path, bad))
    assert message.startswith(f"{path}: ")
    assert "is not finite; allowed: " in message


def test_rigid_lines_make_a_system_in_which_each_keeps_its_length():
    table = copy.deepcopy(LOOP)
    table["line"].append({**table["line"][0], "name": "other"})
    pose = equilibrium(table)
    assert pose.status == "ok"
    one, other = np.split(pose.positions, 2)
    np.testing.assert_allclose(one, other, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(one, axis=0), axis=1), table["line"][0]["length"], rtol=1e-9)


def test_a_stiffness_alone_is_that_of_a_rope():
    """As for a line type."""
    line = load_scene(changed("line.0.axial", {"EA": 1e5})).line
    assert (line.axial_law, line.EA.tolist()) == ("rope", [1e5] * 4)


@pytest.mark.parametrize(
    ("section", "more", "start"),
    [
        ("line", {**LOOP["line"][0], "name": "short", "length": 0.01}, "line.1.length: the links are"),
        ("point", {"name": "lost", "position": [0, 0, 0]}, "point.2.name: 'lost' is not an end of any line"),
    ],
)
def test_lines_must_reach_their_ends_and_points_need_a_line(section, more, start, refusal):
    assert refusal(Scene.from_dict, {**LOOP, section: [*LOOP[section], more]}).startswith(start)


def test_rigid_links_must_reach_the_points_between_which_they_start(refusal):
    """Where the weight is placed at the very length of its line nothing determines the tension."""
    line = {"name": "line", "from": "top", "to": "weight", "links": 3, "length": 1.0, "mass": 5.0}
    points = [{"name": "top", "position": [0, 0, 0]}]
    points.append({"name": "weight", "position": [0, 0, -3], "kind": "free", "mass": 1.0})
    sections = {"line": [line], "point": points, "start": {"kind": "points"}, "effects": {"weight": {}}}
    message = refusal(Scene.from_dict, {"run": LOOP["run"], **sections})
    assert message.startswith("line.0.length: the links are 3 m long in all, too short for the 3 m between")


def test_a_pose_with_wrong_link_lengths_is_refused(refusal):
    rows = [[0, 0, 0], [0.1, 0, 0], [0.1, 0, -0.15], [0.2, 0, -0.1], [0.2, 0, 0]]
    message = refusal(Scene.from_dict, changed("start", {"kind": "positions", "positions": rows}))
    assert message == "start.positions: link 2 is 0.15 m long; allowed: its length 0.1 m"


@pytest.mark.parametrize(
    ("content", "words"),
    [(b'description = "x"\n[run]\ndt = = 3\n', r"broken\.toml: TOML syntax: .*line 3"), (b"\xff\xfe\x00", "UTF-8")],
)
def test_a_file_that_is_no_toml_is_refused_with_file_and_line(content, words, tmp_path):
    file = tmp_path / "broken.toml"
    file.write_bytes(content)
    with pytest.raises(SceneError, match=words):
        load_scene(file)


def test_files_that_windows_marks_as_utf_8_are_read_as_others(tmp_path):
    text = as_toml(load_scene("dropper-release-a"))
    (tmp_path / "plain.toml").write_text(text, encoding="utf-8")
    (tmp_path / "marked.toml").write_text(text, encoding="utf-8-sig")
    assert load_scene(tmp_path / "marked.toml") == load_scene(tmp_path / "plain.toml")


def test_what_is_not_a_scene_is_refused(refusal):
    assert refusal(load_scene, None) == "scene: None is not a scene; allowed: a name, a file, a table, or a Scene"


def test_missing_file_and_folder_are_refused(tmp_path, refusal):
    for path in (tmp_path / "none.toml", tmp_path):
        assert "cannot read" in refusal(load_scene, path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("dropper-farm-" + "1" * 5000, "cannot read"),
        ("x" * 300, "cannot read"),
        ("a\0b", "is not a packaged scene"),
        ("x" * 300 + ".toml", "cannot read"),
        ("a\0b.toml", "cannot read"),
    ],
    ids=["digits", "long", "nul", "long-file", "nul-file"],
)
def test_a_name_that_no_file_can_have_is_refused_as_any_other(name, words, refusal):
    message = refusal(load_scene, name)
    assert message.startswith("scene: ")
    assert words in message


def test_values_are_changed_by_path_number_or_name():
    scene = Scene.from_dict(LOOP)
    values = {"effects.linear_damping.b_l": 0.5, "effects.quadratic_damping.b_q": 0.25, "run.dt": 0.02}
    values |= {"line.0.axial.law": "elastic", "line.0.axial.EA": 100.0}
    new = scene.with_values(values | {"line.loop.mass": [1.0, 2.0, 3.0, 4.0], "point.right.position.0": 0.3})
    assert new.effects["linear_damping"]["b_l"] == 0.5
    assert new.effects["quadratic_damping"]["b_q"] == 0.25
    np.testing.assert_array_equal(new.lines[0].mass, [1, 2, 3, 4])
    assert new.points[1].position[0] == 0.3
    assert (new.lines[0].axial_law, new.lines[0].EA[0], new.run.dt) == ("elastic", 100.0, 0.02)
    assert scene == Scene.from_dict(LOOP)


def test_a_number_in_a_path_is_never_the_name_of_another_line():
    rope = {**LOOP["line"][0], "axial": {"EA": 1e5}}
    scene = Scene.from_dict({**LOOP, "line": [{**rope, "name": "first"}, {**rope, "name": "0"}]})
    assert [line.length[0] for line in scene.with_values({"line.0.length": 0.2}).lines] == [0.2, 0.1]


def test_one_of_several_equal_values_is_changed_by_path():
    scene = Scene.from_dict({**LOOP, "line": [{**LOOP["line"][0], "mass": [0.03] * 4}]})
    assert scene.value("line.0.mass.1") == 0.03
    assert scene.with_values({"line.0.mass.1": 0.04}).lines[0].mass.tolist() == [0.03, 0.04, 0.03, 0.03]


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("effects.linear_dampin.b_l", 1.0, "did you mean 'effects.linear_damping.b_l'"),
        ("run.dtt", 1.0, "did you mean 'run.dt"),
        ("line.3.mass", 1.0, "did you mean 'line.0.mass'"),
        ("line.0.mass.4", 1.0, "entry 4 does not exist; allowed: 0 to 3"),
        ("run.duration.0", 1.0, "has no entries, its value is"),
        ("point.0.position.3", 1.0, "entry 3 does not exist; allowed: 0 to 2"),
        ("point.0.position.x", 1.0, "unknown path"),
        ("line.0.mass", -1.0, "is out of range; allowed: a number or a list of 4 numbers, each > 0 kg"),
    ],
)
def test_unknown_path_or_bad_value_by_path_is_refused(path, value, words, refusal):
    message = refusal(Scene.from_dict(LOOP).with_values, {path: value})
    assert message.startswith(path)
    assert words in message


def test_free_end_and_elastic_stretch_need_no_slack():
    Scene.from_dict(changed("point.1", {"name": "right", "kind": "free", "position": [9, 0, 0]}))
    stretched = changed("point.1.position", [0.5, 0, 0])
    stretched["line"][0]["axial"] = {"law": "elastic", "EA": 10.0, "damping": 0.1}
    scene = Scene.from_dict(stretched)
    assert Scene.from_dict(scene.to_dict()) == scene
    assert build_model(scene).line.axial.damping.shape == (4,)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.sampled_from([10**400, "left"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
PLACES = [
    *("name", "description", "run", "point", "line", "effects", "start", "odd", *NUMBERS),
    *("run.integrator", "run.save_every", "point.0", "point.1.position", "point.1.kind", "line.0.from", "line.0.links"),
    *("line.0.centre_of_mass", "line.0.axial", "line.0.axial.EA", "start.kind", "start.polar", "start.release_nodes"),
    *("start.positions", "effects.weight", "effects.weight.wet_weight", "effects.joint_friction.dry"),
    *("effects.joint_friction.axis", "effects.nodal_force.force_n", "effects.end_motion.point"),
]


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.sampled_from(PLACES), JUNK)
def test_junk_anywhere_is_taken_or_refused_in_one_line(path, value):
    message = "taken"
    try:
        Scene.from_dict(changed(path, value))
    except SceneError as error:
        message = str(error)
    assert len(message.splitlines()) == 1


def test_model_has_the_precision_of_the_scene():
    assert build_model(Scene.from_dict(changed("run.dtype", "float32"))).dtype == np.float32


@pytest.mark.parametrize("bad", [["rope"], {"name": "rope"}, 3])
@pytest.mark.parametrize("path", ["line.0.type", "line.0.sections.0.type", "line_type.0.name", "point.0.name"])
def test_a_list_or_table_for_a_name_is_refused_by_its_path(path, bad):
    section = {"type": "rope", "length": 20.0, "links": 4}
    line = {"name": "line", "from": "a", "to": "b"}
    scene = {
        "run": {"dt": 0.1, "duration": 1.0},
        "line_type": [{"name": "rope", "mass": 1.0, "diameter": 0.02, "EA": 1e5}],
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [15.0, 0.0, 0.0]}],
        "line": [line | ({"sections": [section]} if "sections" in path else section)],
        "effects": {"weight": {}},
    }
    load_scene(scene)
    *steps, key = path.split(".")
    inner = scene
    for step in steps:
        inner = inner[int(step) if step.isdecimal() else step]
    inner[key] = bad
    with pytest.raises(SceneError, match=f"^{path}: .* is not a text"):
        load_scene(scene)


def test_a_named_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "scene.toml")
    with pytest.raises(SceneError, match=r"scene: '.*scene.toml' is a named pipe"):
        load_scene(tmp_path / "scene.toml")
    for name in ("run.npz", "run.nc", "trace.csv"):
        os.mkfifo(tmp_path / name)
    for read, name in ((Solution.load, "run.npz"), (Solution.load, "run.nc"), (read_lines, "trace.csv")):
        with pytest.raises(SceneError, match=rf".*{name}' is a named pipe, which may never end"):
            read(tmp_path / name)


@pytest.mark.parametrize("path", ["name", "line.0.name", "point.1.name", "line.0.from"])
def test_a_very_long_name_is_refused_in_a_short_line(path):
    scene = load_scene("string").to_dict()
    set_value(scene, path, "x" * 100_000)
    with pytest.raises(SceneError, match=f"^{path}") as caught:
        load_scene(scene)
    assert len(str(caught.value)) < 400


def test_an_expression_that_python_warns_of_is_refused_without_its_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SceneError, match="is not allowed in an expression"):
            evaluate("1if 1 else 0", {}, "parameters.a")


def test_messages_of_the_compiler_for_its_developers_are_not_shown_by_commands(monkeypatch):
    monkeypatch.setenv(cli.XLA_LOG, "")
    monkeypatch.delenv(cli.XLA_LOG)
    threshold = gc.get_threshold()
    try:
        cli.prepare()
    finally:
        gc.set_threshold(*threshold)
    assert os.environ[cli.XLA_LOG] == "3"  # fatal ones alone, in the words of XLA's logger


def test_a_point_that_a_scene_lacks_is_named_with_the_nearest(refusal):
    scene = load_scene("dropper-release-a")
    name = scene.points[0].name
    assert refusal(scene.point, f"{name}x") == f"point: '{name}x' is unknown; did you mean '{name}'?"
