"""Numbers of the scene as parameters: the model follows them as the scene says."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax import SceneError, build_model, load_scene
from dropper_jax.run.quantities import quantity
from fitting.parameters.of_scene import find_parameters, scene_parameter
from fitting.parameters.parameter import apply, resolve
from fitting.parameters.target import Direction
from fitting.sensitivity import Study, ranges

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
    moved = apply(model, parameters, jnp.array(list(values.values())))
    other = build_model(scene.with_values(values))
    for a, b in zip(jax.tree.leaves(moved), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10)


def test_slope_of_what_is_not_linear_is_its_derivative():
    scene = load_scene(SCENE)
    model = build_model(scene)
    found = scene_parameter(scene, model, "line_type.chain.EA")
    assert not found.where.linear
    slope = jax.jacfwd(lambda x: apply(model, [found], x).line.axial.damping)(jnp.array([found.value]))[:, 0]
    # BA = ratio l sqrt(EA m): half of it per EA
    expected = 0.5 * 0.1 * (50.0 / 12) * np.sqrt(10.91 / 48884000.0)
    np.testing.assert_allclose(slope, expected, rtol=1e-9)


def test_a_path_of_the_model_stays_one_and_a_wrong_one_is_named():
    single = load_scene("dropper-release-a")
    names = ["effects.linear_damping.b_l", "line.0.mass.1"]
    assert find_parameters(single, build_model(single), names, "to") == resolve(build_model(single), names)
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


def test_global_studies_refuse_what_a_straight_line_cannot_follow():
    scene = load_scene(SCENE)
    model = build_model(scene)

    def over(path):
        (parameter,) = find_parameters(scene, model, [path], "to")
        return ranges(Study(scene, quantity("tension.1.mean", model), (parameter,), model, None))

    with pytest.raises(SceneError, match="the model is not linear in 'line_type.chain.EA'"):
        over("line_type.chain.EA")
    ((low, high),) = over("line.chain.length")
    assert (low, high) == pytest.approx((40.0, 60.0))
