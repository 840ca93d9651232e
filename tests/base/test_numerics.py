"""Small linear algebra on vectors of three components."""

import jax.numpy as jnp
import pytest

from dropper_jax.base.numerics import cross, dot, safe_norm

PLANE = jnp.ones((4, 2))


@pytest.mark.parametrize("call", [dot, cross, lambda a, b: safe_norm(a)], ids=["dot", "cross", "safe_norm"])
def test_vectors_of_two_components_are_refused(call):
    with pytest.raises(ValueError, match=r"vectors of shape \(4, 2\); needed: \(\.\.\., 3\)"):
        call(PLANE, PLANE)
