"""Quadratic damping in both forms, and its derivative at rest."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest


@pytest.mark.parametrize("form", ["isotropic", "componentwise"])
def test_quadratic_damping_opposes_motion_of_either_sign(instant, form):
    model, k = instant({"quadratic_damping": {"b_q": 0.7, "form": form}})
    v = np.asarray(k.v)
    for sign in (1, -1):
        size = np.abs(v) if form == "componentwise" else np.linalg.norm(v, axis=1, keepdims=True)
        found = model.force(k.with_velocity(jnp.asarray(sign * v)))
        np.testing.assert_allclose(found, -0.7 * size * sign * v, rtol=1e-12)
        assert np.sum(found * sign * v) < 0


def test_quadratic_damping_has_finite_derivatives_at_rest(instant):
    model, k = instant({"quadratic_damping": {"b_q": 0.7}})
    slope = jax.jacfwd(lambda v: model.force(k.with_velocity(v)))(jnp.zeros((3, 3)))
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)
