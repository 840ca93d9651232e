"""Spectra: heights, periods, components, spreading; currents and their Doppler shift."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.load.sea_warnings import repeat_time
from dropper_jax.sea import Current
from dropper_jax.sea.dispersion import action_factor, effective_current, on_current, wave_number
from dropper_jax.sea.make import waves_on
from dropper_jax.sea.spectrum import components, shape

G = 9.81


def test_moments_of_jonswap_and_pierson_moskowitz():
    x = np.geomspace(0.2, 3000.0, 200001)  # over the peak frequency: beyond lies 1e-7 of the second moment
    for gamma, periods in ((3.3, (0.7774, 0.8343)), (1.0, (0.7104, 0.7718))):
        m0, m1, m2 = (np.trapezoid(shape(x, gamma) * x**n, x) for n in range(3))
        assert (np.sqrt(m0 / m2), m0 / m1) == pytest.approx(periods, rel=5e-3)  # Tz/Tp and T1/Tp


@pytest.mark.parametrize("spectrum", ["jonswap", "pierson_moskowitz", "tma"])
@pytest.mark.parametrize("frequencies", ["equal_energy", "equal_frequency", "even"])
def test_components_have_the_given_hs(spectrum, frequencies):
    drawn = components(3.0, 8.0, depth=12.0, spectrum=spectrum, frequencies=frequencies)
    assert 4 * np.sqrt(0.5 * np.sum(drawn.amplitude**2)) == pytest.approx(3.0, rel=5e-3)


def test_components_have_the_spectrums_energy_below_every_frequency():
    drawn = components(3.0, 8.0, depth=30.0, count=400)
    omega = np.linspace(0.2, 30.0, 100001)
    below = np.cumsum(shape(omega / (2 * np.pi / 8.0), 3.3))
    below *= 3.0**2 / 16.0 / below[-1]
    for w in (0.6, 0.8, 1.0, 1.5, 2.5):
        found = 0.5 * np.sum(np.where(drawn.omega < w, drawn.amplitude**2, 0.0))
        assert found == pytest.approx(np.interp(w, omega, below), abs=0.005 * below[-1])


def test_three_hours_of_elevation_have_the_right_variance_and_crests():
    drawn = components(8.2, 11.7, depth=30.0, count=200, seed=3)
    t = np.arange(0.0, 10800.0, 0.5)
    eta = np.cos(np.asarray(drawn.phase) - t[:, None] * np.asarray(drawn.omega)) @ np.asarray(drawn.amplitude)
    assert 4 * np.std(eta) == pytest.approx(8.2, rel=0.03)
    # highest of about 1000 Rayleigh crests: sigma sqrt(2 ln N) = 7.6 m, its scatter is about 10 %
    assert 6.0 < eta.max() < 10.5
    ups = np.sum((eta[:-1] < 0) & (eta[1:] >= 0))
    assert 10800.0 / ups == pytest.approx(0.7774 * 11.7, rel=0.06)


def test_equal_energy_and_random_bins_do_not_repeat_but_even_ones_do():
    for frequencies, repeats in (("equal_energy", False), ("equal_frequency", False), ("even", True)):
        drawn = components(3.0, 10.0, depth=30.0, count=50, frequencies=frequencies)
        assert np.isfinite(repeat_time(np.asarray(drawn.omega))) == repeats
    assert repeat_time(np.asarray(drawn.omega)) == pytest.approx(10.0 / (3.5 / 50), rel=1e-6)


def test_spreading_has_the_moments_of_cos_2s_and_one_direction_keeps_hs_everywhere():
    s = 10.0
    drawn = components(3.0, 10.0, 0.4, depth=30.0, count=2000, spreading=s)
    # mean resultant length of cos^2s(d/2) is s/(s + 1)
    assert np.mean(np.cos(drawn.direction - 0.4)) == pytest.approx(s / (s + 1), abs=1e-3)
    several = components(3.0, 10.0, 0.4, depth=30.0, count=100, spreading=s, directions=5, seed=2)

    def height(drawn, x):
        waves = waves_on(drawn, 30.0, G)
        p = np.asarray(waves.phases(jnp.array([x]), jnp.array([0.0]), jnp.array(0.0)))[0]
        amplitude = np.asarray(drawn.amplitude) * np.exp(1j * p)
        same = [amplitude[np.asarray(drawn.omega) == w].sum() for w in np.unique(drawn.omega)]
        return 4 * np.sqrt(0.5 * np.sum(np.abs(same) ** 2))

    assert height(drawn, 0.0) == pytest.approx(3.0, rel=1e-6)
    assert height(drawn, 77.0) == pytest.approx(3.0, rel=1e-6)
    assert abs(height(several, 0.0) - height(several, 77.0)) > 0.01


def test_the_same_seed_gives_the_same_sea():
    a, b, c = (components(3.0, 10.0, depth=30.0, spreading=5.0, seed=seed) for seed in (1, 1, 2))
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert not np.array_equal(a.phase, c.phase)


def current(speed, direction=0.0, **more) -> Current:
    return Current(speed=jnp.asarray(speed), direction=jnp.asarray(direction), **more)


@partial(jax.jit, static_argnames="depth")
def doppler(omega, current: Current, depth: float):
    return on_current(omega, jnp.array(depth), jnp.array(G), along(current, depth))


def along(current: Current, depth: float):
    return lambda z: current.profile(z, depth)[..., 0]


def linear(u: float, shear: float, depth: float) -> Current:
    z = jnp.array([-depth, 0.0])
    velocities = jnp.stack([u + shear * z, 0 * z, 0 * z], axis=1)
    return current(0.0, heights=z, velocities=velocities, kind="table")


@pytest.mark.parametrize("depth", [3.0, 30.0])
def test_effective_current_of_uniform_and_linear_profiles_is_exact(depth):
    k = jnp.geomspace(0.02, 4.0, 20)
    np.testing.assert_allclose(effective_current(k, depth, along(current(0.8), depth)), 0.8, rtol=1e-12)
    found = effective_current(k, depth, along(linear(0.8, 0.02, depth), depth))
    np.testing.assert_allclose(found, 0.8 - 0.02 * np.tanh(k * depth) / (2 * k), rtol=1e-10)


def test_doppler_on_a_linear_shear_satisfies_its_own_dispersion():
    """`s^2 + O s tanh(kd) = g k tanh(kd)`, s = w - kU, holds for the exact shear flow; U_e leaves (O tanh(kd)/2)^2."""
    depth, u, shear = 20.0, 0.7, 0.01
    omega = jnp.linspace(0.4, 2.0, 9)
    k, _, _ = doppler(omega, linear(u, shear, depth), depth)
    s, tanh = omega - k * u, jnp.tanh(k * depth)
    left = s**2 + shear * s * tanh
    np.testing.assert_allclose(left + (0.5 * shear * tanh) ** 2, G * k * tanh, rtol=1e-12)
    np.testing.assert_allclose(left, G * k * tanh, rtol=3e-4)


def test_doppler_is_exact_on_a_uniform_current_and_names_stopped_waves():
    omega = jnp.linspace(0.4, 2.0, 9)
    for u in (1.0, -0.8):
        flow = current(u)
        k, s, _ = doppler(omega, flow, 30.0)
        np.testing.assert_allclose((omega - k * u) ** 2, G * k * jnp.tanh(k * 30.0), rtol=1e-12)
        np.testing.assert_allclose(s, omega - k * u, rtol=1e-12)
    # in deep water waves stop where U = -g/(4 w)
    k, _, _ = doppler(jnp.array([1.2, 1.25]), current(-2.0), 500.0)
    assert np.isfinite(k[0])
    assert np.isnan(k[1])


def test_wave_action_gives_longuet_higgins_and_stewarts_amplitudes_in_deep_water():
    omega = jnp.array([0.8])
    for u in (1.5, 0.5, -1.0):
        k, _, effective = doppler(omega, current(u), 800.0)
        s = np.sqrt(1 + 4 * u * 0.8 / G)
        found = float(action_factor(omega, k, effective, jnp.array(800.0), jnp.array(G))[0]) ** 2
        assert found == pytest.approx(4 / (s * (1 + s) ** 2), rel=1e-10)


def test_doppler_has_exact_derivatives():
    def number(u):
        return doppler(jnp.array([0.9]), current(u), 30.0)[0][0]

    u, e = jnp.array(-0.6), 1e-5
    central = (number(u + e) - number(u - e)) / (2 * e)
    assert float(jax.grad(number)(u)) == pytest.approx(float(central), rel=1e-7)
    assert float(jax.jvp(number, (u,), (jnp.array(1.0),))[1]) == pytest.approx(float(jax.grad(number)(u)), rel=1e-12)


def test_power_law_is_clamped_at_the_bed_with_a_bounded_slope_and_held_above_the_surface():
    flow = current(1.0, exponent=jnp.array(1 / 7), reference=jnp.array(0.0), kind="power")
    z = jnp.array([-40.0, -30.0, -15.0, 0.0, 2.0])
    np.testing.assert_allclose(flow.profile(z, 30.0)[:, 0], [0.0, 0.0, 0.5 ** (1 / 7), 1.0, 1.0], atol=1e-14)
    slope = jax.grad(lambda z: flow.profile(z, 30.0)[0])(jnp.array(-29.9999))
    assert 0.0 < float(slope) < 3.0


def test_current_over_time_has_the_rate_of_its_table():
    flow = current(2.0, np.pi / 2, time=jnp.array([0.0, 10.0]), factor=jnp.array([0.0, 1.0]))
    z, t = jnp.array([-3.0]), jnp.array(4.0)
    np.testing.assert_allclose(flow.velocity(z, t, 30.0), [[0.0, 0.8, 0.0]], atol=1e-12)
    np.testing.assert_allclose(flow.acceleration(z, t, 30.0), [[0.0, 0.2, 0.0]], atol=1e-12)


def test_the_printed_components_have_hs_2_57_not_8_20():
    from dropper_jax import load_scene

    scene = load_scene("dropper-north-sea")
    assert len(scene.sea.waves.period) == 231
    assert 4 * np.sqrt(0.5 * np.sum(scene.sea.waves.amplitude**2)) == pytest.approx(2.57, abs=0.005)
    assert "2.57" in scene.description
    assert float(wave_number(jnp.array(2 * np.pi / 8.33), 30.0, G)) == pytest.approx(2 * np.pi / 103.0, rel=5e-3)
