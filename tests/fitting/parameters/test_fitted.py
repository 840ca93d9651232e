"""Fitted values back in the scene: where the model has them the scene has them too."""

import numpy as np

import dropper_jax as dj
from dropper_jax import build_model
from fitting import fitted_scene
from fitting.channels.free_numbers import find_free
from fitting.parameters.parameter import with_parameter_values
from fitting.parameters.scene_parameters import find_parameters

LINE = {"name": "l", "from": "a", "to": "b", "links": 3, "length": 0.3, "mass": 0.1}
SCENE = {
    "run": {"dt": 0.01, "duration": 1.0},
    "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "kind": "free", "position": [0.0, 0.0, -0.9]}],
    "line": [LINE],
    "effects": {"weight": {}, "linear_damping": {"b_l": 0.1}, "joint_friction": {"viscous": 1e-3}},
}


def fitted_to(table, values):
    """The model with these values by their paths, and the fitted scene."""
    scene = dj.load_scene(table)
    parameters = find_parameters(scene, build_model(scene), list(values), "free")
    numbers = np.array(list(values.values()))
    moved = with_parameter_values(build_model(scene), parameters, numbers)
    return moved, fitted_scene(scene, moved, parameters, numbers)


def test_a_scene_built_from_the_fitted_one_has_the_fitted_model():
    values = {"effects.linear_damping.b_l": 0.2, "line.0.mass.1": 0.13, "point.a.position.0": 0.01}
    values["effects.weight.gravity"] = 9.7
    _, fitted = fitted_to(SCENE, values)
    again = find_parameters(fitted, build_model(fitted), list(values), "free")
    assert np.allclose([p.value for p in again], list(values.values()))
    assert fitted.value("line.0.mass.2") == 0.1


def test_the_scale_of_a_rig_grows_a_length_that_is_fitted_too():
    bars = {**LINE, "centre_of_mass": 0.15, "inertia": 0.003}
    moved, fitted = fitted_to({**SCENE, "line": [bars]}, {"rig.scale": 1.2, "line.0.length.1": 0.5})
    np.testing.assert_allclose(moved.line.length, [0.36, 0.6, 0.36])
    again = build_model(fitted)
    np.testing.assert_allclose(again.line.length, moved.line.length)
    np.testing.assert_allclose(again.line.inertia, 1.44 * 0.003)
    np.testing.assert_allclose(again.points[1].position, moved.points[1].position)


def test_the_scale_of_a_rig_grows_a_line_by_the_metre_as_a_whole():
    rope = {"name": "rope", "mass": 1.0, "diameter": 0.02, "EA": 1e5}
    line = {"name": "l", "from": "a", "to": "b", "type": "rope", "links": 3, "length": 0.9}
    scene = {**SCENE, "line_type": [rope], "line": [line], "effects": {"weight": {}}}
    again = build_model(fitted_to(scene, {"rig.scale": 1.2})[1])
    np.testing.assert_allclose(again.line.length, [0.36, 0.36, 0.36])
    np.testing.assert_allclose(again.points[1].position, [0.0, 0.0, -1.08])


def test_a_link_counted_among_all_lines_is_the_right_lines():
    rope = {"links": 2, "length": 1.0, "mass": 1.0, "axial": {"law": "rope", "EA": 1e4}}
    points = [
        {"name": "a", "position": [0.0, 0.0, 0.0]},
        {"name": "b", "kind": "free", "position": [1.5, 0.0, -1.0]},
        {"name": "c", "position": [3.0, 0.0, 0.0]},
    ]
    lines = [{"name": "p", "from": "a", "to": "b", **rope}, {"name": "q", "from": "b", "to": "c", **rope}]
    _, fitted = fitted_to({**SCENE, "point": points, "line": lines, "effects": {"weight": {}}}, {"line.0.mass.2": 3.0})
    assert [np.ravel(line.mass).tolist() for line in fitted.lines] == [[1.0, 1.0], [3.0, 1.0]]


def test_values_of_sensors_are_not_of_the_scene():
    from fitting import read_data

    scene = dj.load_scene(SCENE)
    t = np.linspace(0, 1, 5)
    depth = {"name": "d", "kind": "depth", "column": "y", "unit": "m", "node": 3}
    data = read_data({"run": [{"file": {"t": t, "y": t}}], "channel": [depth]}, scene)
    parameters = find_free(scene, data, ["channel.d.offset", "b_l"])
    fitted = fitted_scene(scene, build_model(scene), parameters, np.array([1.0, 0.3]))
    assert fitted.value("effects.linear_damping.b_l") == 0.3
    assert fitted == scene.with_values({"effects.linear_damping.b_l": 0.3})
