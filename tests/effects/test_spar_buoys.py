"""Spar buoys: the heave force of a wave, and the natural period."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.optimize import brentq

from dropper_jax import build_model, equilibrium, load_scene, natural_modes

G = 9.81


def moored_buoy(sea, **buoy):
    """A spar on a slack, light line, so that it is all but free."""
    spar = {"mass": 1200.0, "diameter": 0.79, "height": 8.865, "cdn": 0.0, "cdt": 0.0, "can": 0.0, "cat": 0.0, **buoy}
    return system(
        [fixed("anchor", 0.0, 0.0, -30.0), free("buoy", 0.0, 0.0, -2.5)],
        [line_of("rope", "anchor", "buoy", 4, 40.0, type="rope")],
        line_type=[{"name": "rope", "mass": 1e-3, "diameter": 1e-3, "EA": 1e3}],
        buoy=[{"name": "spar", "point": "buoy", **spar}],
        sea={"depth": 30.0, **sea},
    )


def test_heave_force_on_a_fixed_spar_is_the_pressure_on_its_base_to_first_order(in_water):
    amplitude, period, depth = 0.01, 8.33, 30.0
    sea = {"waves": {"kind": "regular", "amplitude": amplitude, "period": period}, "stretching": "none"}
    model = build_model(load_scene(moored_buoy(sea)))
    node, base = model.free_nodes - 1, -5.0
    r = jnp.zeros((model.free_nodes, 3)).at[:, 2].set(base)

    def force(t):
        return model.effect("spar_buoys").force(in_water(model, r, jnp.zeros_like(r), t))[node, 2]

    times = jnp.linspace(0.0, period, 33)[:-1]
    found = jax.jit(jax.vmap(force))(times)
    k = brentq(lambda k: G * k * np.tanh(k * depth) - (2 * np.pi / period) ** 2, 1e-3, 1.0)
    expected = 1025.0 * G * np.pi / 4 * 0.79**2 * amplitude * np.cosh(k * (depth + base)) / np.cosh(k * depth)
    first_harmonic = 2 * np.abs(np.mean(np.asarray(found) * np.exp(-2j * np.pi * np.arange(32) / 32)))
    assert first_harmonic == pytest.approx(expected, rel=1e-3)  # second-order terms are a/H = 1e-3 of it


@pytest.mark.check
def test_free_spar_heaves_with_its_natural_period_and_added_mass_of_a_half_sphere():
    scene = moored_buoy({}, cat=0.5)
    pose = equilibrium(scene)
    modes = natural_modes(build_model(load_scene(scene)), pose.state)
    area = np.pi / 4 * 0.79**2
    added = 1025.0 * 0.5 * 2 / 3 * np.pi * (0.79 / 2) ** 3
    assert added == pytest.approx(66.0, abs=0.5)  # errata: 66 kg on a hemisphere
    expected = 2 * np.pi * np.sqrt((1200.0 + added) / (1025.0 * G * area))
    assert np.min(np.abs(modes.period / expected - 1)) < 1e-4
