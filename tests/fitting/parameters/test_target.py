"""Places of parameters: where a value goes, and what else stays as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax import build
from fitting.parameters.parameter import Parameter, apply, resolve
from fitting.parameters.target import Direction


@pytest.fixture(scope="module")
def model():
    return build("dropper-release-a")[0]


def test_only_the_numbers_that_are_named_change(model):
    parameters = resolve(model, ["line.0.mass.2", "camera.offset"])
    changed = apply(model, parameters, jnp.array([0.5, 0.1]))
    expected = np.asarray(model.line.mass).copy()
    expected[2] = 0.5
    np.testing.assert_array_equal(changed.line.mass, expected)
    others = [
        (a, b)
        for a, b in zip(jax.tree.leaves(model), jax.tree.leaves(changed), strict=True)
        if not np.array_equal(a, b)
    ]
    assert len(others) == 1


@pytest.mark.parametrize("turned", [False, True])
def test_a_direction_moves_what_was_put_in_place_whichever_is_named_first(model, turned):
    (entry,) = resolve(model, ["line.0.mass.2"])
    leaves = jax.tree.leaves(model)
    leaf = next(i for i, x in enumerate(leaves) if x is model.line.mass)
    along = Parameter("all masses", Direction({leaf: np.ones_like(leaves[leaf])}, 1.0, True), 1.0)
    pair = [(along, 1.25), (entry, 0.5)]
    parameters, values = zip(*(pair[::-1] if turned else pair), strict=True)
    changed = apply(model, parameters, jnp.array(values))
    expected = np.asarray(model.line.mass) + 0.25
    expected[2] = 0.75
    np.testing.assert_allclose(changed.line.mass, expected, rtol=1e-15)
