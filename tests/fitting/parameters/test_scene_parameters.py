"""Numbers of the scene as parameters: the model follows them as the scene says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import single_line
from scene_parts import free_at, line_of, scene_of

from dropper_jax import SceneError, build_model, load_scene
from dropper_jax.quantities.quantity_names import quantity
from fitting import Camera, fit, fitted_scene, observe, simulate_truth
from fitting.parameters.names import full_names
from fitting.parameters.parameter import with_parameter_values
from fitting.parameters.paths import resolve
from fitting.parameters.scene_parameters import find_parameters, free_of_traces, scene_parameter
from fitting.parameters.targets import Direction
from fitting.sensitivity import Study, parameter_ranges

SCENE = "paper-case-4"
#: Numbers that the model depends on linearly, and by how much they are changed.
LINEAR = {"line.chain.length": 1.5, "line_type.chain.cdn": -0.3, "point.anchor.position.0": 2.0, "buoy.spar.mass": 50.0}


def test_model_follows_numbers_of_the_scene_exactly_where_it_depends_on_them_linearly():
    scene = load_scene(SCENE).with_values({"point.anchor.position.0": 1.0})
    model = build_model(scene)
    parameters = find_parameters(scene, model, list(LINEAR), "to")
    assert [p.where.linear for p in parameters if isinstance(p.where, Direction)] == [True] * 3
    assert [(p.unit, p.value) for p in parameters] == [("m", 50.0), ("-", 1.4), ("m", 1.0), ("kg", 1200.0)]
    values = {p.name: p.value + LINEAR[p.name] for p in parameters}
    moved = with_parameter_values(model, parameters, jnp.array(list(values.values())))
    other = build_model(scene.with_values(values))
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10)


def test_slope_of_what_is_not_linear_is_its_derivative():
    scene = load_scene(SCENE)
    model = build_model(scene)
    found = scene_parameter(scene, model, "line_type.chain.EA")
    assert not found.where.linear
    slope = jax.jacfwd(lambda x: with_parameter_values(model, [found], x).line.axial.damping)(jnp.array([found.value]))[
        :, 0
    ]
    # BA = ratio l sqrt(EA m): half of it per EA
    expected = 0.5 * 0.1 * (50.0 / 12) * np.sqrt(10.91 / 48884000.0)
    np.testing.assert_allclose(slope, expected, rtol=1e-9)


def test_loads_at_which_nothing_breaks_stay_infinite_when_others_move():
    rope = line_of("rope", "top", "end", 3, 1.0, mass="= m", axial={"law": "rope", "EA": 1e3})
    parts = {"top": [0.0, 0.0, 0.0], "end": free_at([0.0, 0.0, -3.0])}
    failure = [{"line": "rope", "link": 2, "load": "= 50 * m"}]
    scene = load_scene(scene_of(parts, rope, parameters={"m": 0.2}, failure=failure))
    model = build_model(scene)
    found = scene_parameter(scene, model, "parameters.m")
    failures = with_parameter_values(model, [found], jnp.array([0.3])).line.failures
    np.testing.assert_allclose(failures.load, [[np.inf, 15.0, np.inf]])
    np.testing.assert_array_equal(failures.time, np.inf)


def test_a_path_of_the_model_stays_one_and_a_wrong_one_is_named():
    single = load_scene("dropper-release-a")
    names = ["effects.linear_damping.b_l", "line.0.mass.1"]
    assert find_parameters(single, build_model(single), names, "to") == resolve(build_model(single), names)
    with pytest.raises(SceneError, match=r"did you mean 'effects.linear_damping.b_l'"):
        resolve(build_model(single), ["effects.linear_damping.b_k"])
    scene = load_scene(SCENE)
    model = build_model(scene)
    for path, words in (
        ("line_type.chain.EAA", "line_type.chain.EAA"),
        ("line.chain.links", "12 is not a number that can vary"),
        ("line_type.chain.breaking_load", "is not given"),
        ("sea.depth.x", "'sea.depth.x' does not exist"),
    ):
        with pytest.raises(SceneError, match=words):
            find_parameters(scene, model, [path], "to")
    with pytest.raises(SceneError, match="is given twice"):
        find_parameters(scene, model, ["line.chain.length", "line.chain.length"], "to")
    # anchors lie on the bed: it may only be lower
    (depth,) = find_parameters(scene, model, ["sea.depth"], "to")
    assert depth.low == scene.value("sea.depth")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("line.0.mass.2", "line.dropper.mass.2"),
        ("point.right.position.0", "point.1.position.0"),
        ("effects.linear_damping.b_l", "effects.linear_damping.b_l.0"),
        ("clock.lost.0.3", "clock.lost.0.03"),
    ],
)
def test_two_names_of_the_same_number_are_refused(first, second):
    scene = load_scene("dropper-release-a")
    model = build_model(scene)
    for find in (free_of_traces, lambda *given: find_parameters(*given, "to")):
        with pytest.raises(SceneError, match=f"'{first}' and '{second}' are the same number"):
            find(scene, model, [first, "line.0.mass.1", second])


def test_global_studies_refuse_what_a_straight_line_cannot_follow():
    scene = load_scene(SCENE)
    model = build_model(scene)

    def over(path):
        (parameter,) = find_parameters(scene, model, [path], "to")
        return parameter_ranges(Study(scene, quantity("tension.1.mean", model), (parameter,), model, None))

    with pytest.raises(SceneError, match="the model is not linear in 'line_type.chain.EA'"):
        over("line_type.chain.EA")
    ((low, high),) = over("line.chain.length")
    assert (low, high) == pytest.approx((40.0, 60.0))


HELD = single_line(
    [0.12, 0.1, 0.09, 0.11],
    0.03,
    {"kind": "static", "release_nodes": [2], "release_force": [[0.1, 0.0, 0.6]]},
    [0.2, 0.0, 0.0],
    {"weight": {}, "linear_damping": {"b_l": [0.02, 0.02, 0.02, 0.0]}},
)
HELD["run"] = {"dt": 0.002, "duration": 3.0}
#: The node at the head has one coefficient, both others another one.
TIED = HELD | {
    "parameters": {"head": 0.01, "rest": 0.03},
    "effects": {"weight": {}, "linear_damping": {"b_l": ["= head", "= rest", "= rest", 0.0]}},
}


@pytest.mark.parametrize("path", ["effects.linear_damping.b_l", "line.0.mass"])
def test_a_list_of_a_line_between_fixed_points_frees_the_nodes_that_move(path):
    model = build_model(load_scene(HELD))
    assert [p.name for p in resolve(model, [path])] == [f"{path}.{i}" for i in range(3)]
    with pytest.raises(SceneError, match="unknown entry; allowed: 0 to 2"):
        resolve(model, [f"{path}.3"])
    # of a free end, the last one moves too
    loose = HELD | {"point": [HELD["point"][0], HELD["point"][1] | {"kind": "free"}]}
    loose["start"] = {"kind": "angles", "polar": [0.1, 0.2, 0.3, 0.4], "zero": "down"}
    assert len(resolve(build_model(load_scene(loose)), [path])) == 4


@pytest.mark.parametrize(
    ("a", "damping", "slope", "bounds"),
    [
        (0.0, "= 3 * a - 2 * a ** 3", 3.0, (0.0, np.inf)),
        (1.0, "= 1 - a ** 2", -2.0, (0.0, 1.0)),
        (0.5, "= 1 - a ** 2", -1.0, (0.0, np.inf)),
    ],
)
def test_a_number_at_an_end_of_its_range_has_the_slope_and_the_bounds_inside(a, damping, slope, bounds):
    effects = {"weight": {}, "linear_damping": {"b_l": damping}}
    scene = load_scene(HELD | {"parameters": {"a": a}, "effects": effects})
    found = scene_parameter(scene, build_model(scene), "parameters.a")
    assert list(found.where.slopes.values()) == [pytest.approx(slope, rel=1e-6)]
    assert (found.low, found.high) == bounds


def test_a_number_of_parameters_ties_the_values_computed_from_it():
    scene = load_scene(TIED)
    model = build_model(scene)
    names = full_names(scene, ["rest", "parameters.head"])
    assert names == ["parameters.rest", "parameters.head"]
    found = free_of_traces(scene, model, names)
    assert [(p.value, p.unit, p.low) for p in found] == [(0.03, "kg/s", 0.0), (0.01, "kg/s", 0.0)]
    values = np.array([0.05, 0.002])
    moved = with_parameter_values(model, found, jnp.array(values))
    other = fitted_scene(scene, moved, found, values)
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(build_model(other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10)
    squared = TIED | {"effects": {"weight": {}, "linear_damping": {"b_l": "= 10 * rest ** 2"}}}
    bent = load_scene(squared)
    with pytest.raises(SceneError, match="'parameters.rest' changes the model non-linearly"):
        free_of_traces(bent, build_model(bent), ["parameters.rest"])


@pytest.mark.parametrize(
    ("b_l", "low", "high"),
    [
        ("= rest - 0.01", 0.01, np.inf),
        ("= 0.05 - rest", 0.0, 0.05),
        ("= 0.031 - rest", 0.0, 0.031),
        (["= rest - 0.02", "= 0.08 - 2 * rest", "= rest - 0.01", 0.0], 0.02, 0.04),
    ],
)
def test_bounds_of_a_number_of_parameters_are_those_of_the_values_computed_from_it(b_l, low, high):
    tied = load_scene(TIED | {"effects": {"weight": {}, "linear_damping": {"b_l": b_l}}})
    (found,) = free_of_traces(tied, build_model(tied), ["parameters.rest"])
    assert (found.low, found.high) == pytest.approx((low, high))
    for end in filter(np.isfinite, (found.low, found.high)):
        tied.with_values({"parameters.rest": end})  # the scene takes it
    # a mass must stay above 0: it is at least a thousandth of its value
    parameters = {"parameters": {"light": 0.05}, "line": [TIED["line"][0] | {"mass": "= light - 0.02"}]}
    heavy = load_scene(HELD | parameters)
    assert scene_parameter(heavy, build_model(heavy), "parameters.light").low == pytest.approx(0.02 + 3e-5)


@pytest.mark.check
@pytest.mark.parametrize(("free", "truth"), [(["b_l"], [0.01, 0.03, 0.03]), (["head", "rest"], [0.01, 0.03])])
def test_values_of_nodes_between_fixed_points_are_fitted_each_or_tied(free, truth):
    trace = observe(simulate_truth(load_scene(TIED), 3.0, 60.0, 20, "rattle_4"), Camera(angle_noise=0.003), 0, "run")
    result = fit(trace, load_scene(TIED).with_values({"parameters.head": 0.02, "parameters.rest": 0.02}), free)
    assert result.status == "ok"
    assert np.all(np.abs(result.values - truth) < 3.5 * result.uncertainty.std_error)
    np.testing.assert_allclose(result.values, truth, rtol=0.15)
