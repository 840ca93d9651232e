"""Weight: mass times gravity, its potential, its place in compound links."""

import jax
import numpy as np
import pytest

G = 9.81


def test_weight_is_mass_times_gravity_downwards(instant):
    model, k = instant({"weight": {"gravity": 9.7}})
    np.testing.assert_allclose(model.force(k), -9.7 * np.outer([0.2, 0.1, 0.3], [0, 0, 1]), rtol=1e-14)
    assert model.potential_energy(k) == pytest.approx(9.7 * (-0.08 - 0.04 - 0.27), rel=1e-14)


def test_weight_in_water_takes_the_place_of_the_weight_in_air(instant):
    model, k = instant({"weight": {"wet_weight": [0.5, -0.2, 0.1]}})
    np.testing.assert_allclose(model.force(k)[:, 2], [-0.5, 0.2, -0.1], rtol=1e-14)


def test_weight_of_compound_links_acts_in_their_centres_of_mass(instant):
    """Virtual work: the potential is m g z of the centres, and minus its gradient is the force."""
    model, k = instant({"weight": {}}, centre_of_mass=[0.2, 0.1, 0.4], inertia=1e-3)
    z = np.array([0.0, *k.r[:, 2]])
    centres = z[:-1] + np.array([0.4, 0.2, 0.8]) * np.diff(z)
    assert model.potential_energy(k) == pytest.approx(G * np.dot([0.2, 0.1, 0.3], centres), rel=1e-13)
    gradient = jax.grad(lambda r: model.potential_energy(model.kinematics(r, k.v, k.t)))(k.r)
    np.testing.assert_allclose(model.force(k), -gradient, atol=1e-14)
