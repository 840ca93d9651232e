"""Forces on nodes: constant, ramped, let go, from a table."""

import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.effects import NodalForce


def ramp(t, start, rise, release):
    return 0.0 if t >= release else min(max((t - start) / rise, 0.0), 1.0)


@pytest.mark.parametrize("t", [0.0, 3.0, 4.0, 5.0, 9.0, 14.999, 15.0, 20.0])
def test_nodal_force_ramps_and_is_released_as_in_the_thesis(instant, t):
    """(E.1): min(max(0.094 (t - 3), 0), M g)."""
    values = {"nodes": [1, 3], "force_n": [[0, 0, 2.0], [1.0, -1.0, 0]], "start": 3.0, "rise": 4.0, "release": 15.0}
    model, k = instant({"nodal_force": values})
    expected = ramp(t, 3.0, 4.0, 15.0) * np.array([[0, 0, 2.0], [0, 0, 0], [1.0, -1.0, 0]])
    found = model.force(model.kinematics(k.r, k.v, jnp.asarray(t)))
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_nodal_force_is_constant_or_follows_its_table():
    force = jnp.ones((1, 3))
    assert NodalForce(force, nodes=(1,)).factor(7.0) == 1.0
    table = NodalForce(force, time=jnp.array([1.0, 2.0, 4.0]), scale=jnp.array([0.0, 1.0, -1.0]), nodes=(1,))
    found = [float(table.factor(t)) for t in (0.0, 1.5, 2.0, 3.0, 4.0, 9.0)]
    np.testing.assert_allclose(found, [0.0, 0.5, 1.0, 0.0, -1.0, -1.0], atol=1e-14)
