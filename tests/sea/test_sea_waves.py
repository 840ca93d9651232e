"""Dispersion and kinematics of linear waves against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.sea import Sea, Waves
from dropper_jax.sea.dispersion import fenton, frequency, wave_number
from dropper_jax.sea.make import waves_on
from dropper_jax.sea.spectrum import Components

G = 9.81
PLACES = np.random.default_rng(0).uniform([-50, -50, -29], [50, 50, -0.5], (40, 3))


def regular(period: float, depth: float, amplitude: float = 1.0, direction: float = 0.6, **options) -> Sea:
    drawn = Components(*(jnp.array([x]) for x in (amplitude, 2 * np.pi / period, 0.3)), jnp.array(direction))
    return Sea(depth=depth, density=1000.0, gravity=G, waves=waves_on(drawn, depth, G, **options))


def mixed(depth: float = 30.0, **options) -> Sea:
    rng = np.random.default_rng(1)
    drawn = Components(
        *(jnp.asarray(x) for x in (rng.uniform(0.1, 0.5, 12), rng.uniform(0.4, 2.0, 12), rng.uniform(0, 6, 12))),
        jnp.asarray(rng.uniform(-3, 3, 12)),
    )
    return Sea(depth=depth, density=1000.0, gravity=G, waves=waves_on(drawn, depth, G, **options))


def test_dispersion_holds_to_rounding_and_gives_the_tabulated_wavelength():
    omega, depth = np.meshgrid(np.geomspace(0.05, 12.0, 60), np.array([0.5, 5.0, 30.0, 500.0]))
    k = wave_number(jnp.asarray(omega), jnp.asarray(depth), G)
    assert np.max(np.abs(frequency(k, depth, G) ** 2 / omega**2 - 1)) < 1e-12
    # Shore Protection Manual, table C-1: d/L0 = 0.1 gives d/L = 0.14098
    w = np.sqrt(2 * np.pi * G * 0.1)
    assert float(wave_number(jnp.array(w), jnp.array(1.0), G)) / (2 * np.pi) == pytest.approx(0.14098, abs=5e-6)


def test_fenton_1988_is_within_its_stated_error_and_reaches_it():
    omega = jnp.geomspace(0.05, 12.0, 4000)
    error = np.abs(fenton(omega, 10.0, G) / wave_number(omega, 10.0, G) - 1)
    assert 4e-4 < error.max() <= 5.2e-4


@pytest.mark.parametrize(
    ("period", "depth"), [(2.0, 30.0), (8.0, 30.0), (60.0, 5.0)], ids=["deep", "middle", "shallow"]
)
def test_kinematics_equal_the_closed_forms(period, depth):
    sea = regular(period, depth, stretching="none")
    r = np.random.default_rng(2).uniform([-50, -50, -depth], [50, 50, 0.0], (30, 3))
    t = 3.7
    found = sea.at(jnp.asarray(r), jnp.asarray(t))
    w = 2 * np.pi / period
    k = float(wave_number(jnp.array(w), depth, G))
    along = np.array([np.cos(0.6), np.sin(0.6)])
    p = k * (r[:, :2] @ along) - w * t + 0.3
    level = np.cosh(k * (r[:, 2] + depth)) / np.sinh(k * depth)
    upright = np.sinh(k * (r[:, 2] + depth)) / np.sinh(k * depth)
    u = np.concatenate([(w * level * np.cos(p))[:, None] * along, (w * upright * np.sin(p))[:, None]], axis=1)
    a = np.concatenate([(w**2 * level * np.sin(p))[:, None] * along, (-(w**2) * upright * np.cos(p))[:, None]], axis=1)
    np.testing.assert_allclose(found.elevation, np.cos(p), atol=1e-10)
    np.testing.assert_allclose(found.velocity, u, atol=1e-10)
    np.testing.assert_allclose(found.acceleration, a, atol=1e-10)


def test_velocity_is_the_time_integral_of_the_acceleration_ramp_included():
    for options in ({"stretching": "none"}, {"stretching": "constant"}, {"stretching": "none", "ramp": 9.0}):
        sea = mixed(**options)
        at = lambda t, sea=sea: sea.at(jnp.asarray(PLACES), t).velocity  # noqa: E731
        rate = jax.jit(lambda t, at=at: jax.jvp(at, (t,), (jnp.ones_like(t),))[1])(jnp.asarray(4.0))
        np.testing.assert_allclose(sea.at(jnp.asarray(PLACES), jnp.asarray(4.0)).acceleration, rate, atol=1e-8)


def test_velocity_is_free_of_divergence_and_of_rotation_and_its_convective_part_is_u_grad_u():
    sea = mixed(stretching="none")
    r, t = jnp.asarray(PLACES), jnp.asarray(2.0)
    motion = sea.at(r, t)
    gradient = jax.jit(jax.vmap(jax.jacfwd(lambda place: sea.at(place[None], t).velocity[0])))(r)
    assert np.max(np.abs(np.trace(gradient, axis1=1, axis2=2))) < 1e-8
    assert np.max(np.abs(gradient - np.swapaxes(gradient, 1, 2))) < 1e-8
    expected = jnp.einsum("nij,nj->ni", gradient, motion.velocity)
    np.testing.assert_allclose(sea.convective(r, t, motion), expected, atol=1e-12)


def test_wheeler_takes_the_mean_surface_to_the_actual_one_and_keeps_the_bed():
    sea, t = mixed(), jnp.asarray(1.0)
    r = jnp.asarray(PLACES[:5])
    eta = sea.elevation(r, t)
    crest = jnp.concatenate([r[:, :2], eta[:, None]], axis=1)
    mean = jnp.concatenate([r[:, :2], jnp.zeros((5, 1))], axis=1)
    plain = mixed(stretching="none")
    np.testing.assert_allclose(sea.at(crest, t).velocity, plain.at(mean, t).velocity, atol=1e-12)
    np.testing.assert_allclose(sea.at(crest, t).acceleration, plain.at(mean, t).acceleration, atol=1e-12)
    bed = r.at[:, 2].set(-30.0)
    np.testing.assert_allclose(sea.at(bed, t).velocity, plain.at(bed, t).velocity, atol=1e-12)


def test_kd_of_95_is_finite_in_float32_with_its_derivatives():
    sea = regular(0.7264, 12.46, direction=0.0)
    sea = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), sea)
    assert float(sea.waves.wave_number[0] * sea.depth) == pytest.approx(95.0, rel=1e-3)
    r = jnp.asarray([[0.0, 0.0, -12.46], [0.0, 0.0, -6.0], [1.0, 0.0, 0.0], [0.3, 0.0, 1.5]], jnp.float32)
    value = lambda r: sum(jnp.sum(x) for x in sea.at(r, jnp.float32(0.3)))  # noqa: E731
    assert np.isfinite(value(r))
    assert np.all(np.isfinite(jax.jit(jax.grad(value))(r)))
    k32 = wave_number(jnp.float32(8.65), jnp.float32(12.46), jnp.float32(G))
    assert float(k32) == pytest.approx(8.65**2 / G, rel=1e-6)


def test_kinematics_far_above_the_surface_are_finite_with_their_derivatives():
    r = jnp.asarray([[0.0, 0.0, 3000.0], [1.0, 2.0, 20.0]], jnp.float32)
    sea = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), mixed(stretching="none"))
    drag = lambda r: jnp.sum(jnp.sum(sea.at(r, jnp.float32(1.0)).velocity ** 2, axis=1) * (r[:, 2] < 0.0))  # noqa: E731
    assert drag(r) == 0.0
    assert np.all(np.isfinite(jax.jit(jax.grad(drag))(r)))


def test_a_waves_component_needs_no_direction_list():
    one, many = regular(8.0, 30.0), regular(8.0, 30.0, direction=0.6)
    many = Sea(30.0, 1000.0, G, waves=Waves(**{**vars(many.waves), "direction": jnp.array([0.6])}))
    r = jnp.asarray(PLACES)
    for a, b in zip(one.at(r, jnp.array(1.0)), many.at(r, jnp.array(1.0)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-13)
