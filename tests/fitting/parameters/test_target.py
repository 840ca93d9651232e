"""Places of parameters: where a value goes, and what else stays as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax import build_model, load_scene
from fitting.parameters.parameter import Parameter, with_parameter_values
from fitting.parameters.paths import resolve
from fitting.parameters.targets import Direction


@pytest.fixture(scope="module")
def model():
    return build_model(load_scene("dropper-release-a"))


def test_only_the_numbers_that_are_named_change(model):
    damping = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]
    names = ["line.0.mass.2", "point.right.position.0", "effects.weight.gravity", "camera.offset", *damping]
    parameters = resolve(model, names)
    assert [p.low for p in parameters[-2:]] == [0.0, 0.0]
    changed = with_parameter_values(model, parameters, jnp.array([0.5, 0.3, 9.7, 0.1, 0.004, 0.005]))
    pairs = zip(jax.tree.leaves(model), jax.tree.leaves(changed), strict=True)
    differences = np.concatenate([np.ravel(b)[np.ravel(a) != np.ravel(b)] for a, b in pairs])
    np.testing.assert_array_equal(np.sort(differences), [0.004, 0.005, 0.3, 0.5, 9.7])
    assert (float(changed.line.mass[2]), float(changed.points[1].position[0])) == (0.5, 0.3)
    assert float(changed.effect("weight").gravity) == 9.7


def test_an_entry_of_a_table_of_vectors_is_one_number():
    """Entries are counted through all axes: entry 4 of forces (2, 3) is the second component of the second node."""
    points = [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [0.6, 0.0, 0.0]}]
    force = {"nodes": [2, 3], "force_n": [[0.1, 0.0, 0.3], [0.0, 0.2, 0.1]]}
    loop = {"name": "loop", "from": "a", "to": "b", "links": 4, "length": 0.3, "mass": 0.1}
    scene = {"point": points, "line": [loop], "effects": {"weight": {}, "nodal_force": force}}
    pushed = build_model(load_scene({"run": {"dt": 0.01, "duration": 1.0}, **scene}))
    path = "effects.nodal_force.force_n"
    values = jnp.array([0.1, 0.0, 0.3, 0.0, 0.7, 0.1])
    for names, given in (([path], values), ([f"{path}.4"], values[4:5])):
        changed = with_parameter_values(pushed, resolve(pushed, names), given)
        np.testing.assert_array_equal(jnp.ravel(changed.effects[1].force_n), values)


@pytest.mark.parametrize("turned", [False, True])
def test_a_direction_moves_what_was_put_in_place_whichever_is_named_first(model, turned):
    (entry,) = resolve(model, ["line.0.mass.2"])
    leaves = jax.tree.leaves(model)
    leaf = next(i for i, x in enumerate(leaves) if x is model.line.mass)
    along = Parameter("all masses", Direction({leaf: np.ones_like(leaves[leaf])}, 1.0, True), 1.0)
    pair = [(along, 1.25), (entry, 0.5)]
    parameters, values = zip(*(pair[::-1] if turned else pair), strict=True)
    changed = with_parameter_values(model, parameters, jnp.array(values))
    expected = np.asarray(model.line.mass) + 0.25
    expected[2] = 0.75
    np.testing.assert_allclose(changed.line.mass, expected, rtol=1e-15)
