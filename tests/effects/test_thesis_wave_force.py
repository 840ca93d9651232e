"""The wave force of the thesis: that of the water at the origin."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj

RHO = 1000.0
WAVES = {"waves": {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}}


def test_the_thesis_force_is_that_of_the_water_at_the_origin_on_every_node(hanging, in_water):
    model, state = dj.build(hanging({"weight": {}, "thesis_wave_force": {"c_d": 2.0, "c_m": 1.5}}, WAVES, links=2))
    water = model.sea.at(jnp.zeros((1, 3)), jnp.array(1.3))
    u, a = np.asarray(water.velocity[0]), np.asarray(water.acceleration[0])
    force = np.pi / 4 * RHO * 0.05**2 * 1.5 * a + 0.5 * RHO * 0.05 * 2.0 * np.abs(u) * u
    found = model.effect("thesis_wave_force").force(in_water(model, state.r, state.v + 3.0, 1.3))
    np.testing.assert_allclose(found, [force, force], rtol=1e-12)


def relative_scene(hanging, **more):
    force = {"c_d": 2.0, "c_m": 1.5, "velocity": "relative", **more}
    return hanging({"weight": {}, "thesis_wave_force": force}, WAVES, links=2)


def test_with_relative_velocity_the_nodes_own_motion_counts(hanging, in_water):
    model, state = dj.build(relative_scene(hanging, c_a=0.5))
    v = np.array([[0.3, -0.2, 0.1], [-1.0, 0.4, 0.0]])
    water = model.sea.at(jnp.zeros((1, 3)), jnp.array(1.3))
    u, a = np.asarray(water.velocity[0]), np.asarray(water.acceleration[0])
    volume = np.pi / 4 * 0.05**2
    force = RHO * volume * 1.5 * a + 0.5 * RHO * 0.05 * 2.0 * np.abs(u - v) * (u - v)
    effect, k = model.effect("thesis_wave_force"), in_water(model, state.r, v, 1.3)
    np.testing.assert_allclose(effect.force(k), force, rtol=1e-12)
    np.testing.assert_allclose(effect.inertia(k, jnp.ones((2, 3))), RHO * volume * 0.5 * np.ones((2, 3)))
    slope = jax.grad(lambda w: jnp.sum(effect.force(in_water(model, state.r, w, 1.3))))(jnp.asarray(v))
    np.testing.assert_allclose(slope, -RHO * 0.05 * 2.0 * np.abs(u - v), rtol=1e-9)


def test_relative_velocity_damps_where_the_water_rests(hanging, runs):
    scene = relative_scene(hanging)
    scene["sea"] = {"depth": 50.0, "density": RHO}
    scene["start"] = {"kind": "angles", "zero": "down", "polar": [0.8, 0.8]}
    _, saved = runs(scene, 0.01, 200, every=20)
    speed = np.linalg.norm(np.asarray(saved.v), axis=2).max(axis=1)
    assert speed[-1] < 0.5 * speed.max()


def test_added_mass_needs_the_relative_velocity(hanging):
    with pytest.raises(dj.SceneError, match="c_a: is only used with velocity 'relative'"):
        dj.build(relative_scene(hanging, velocity="absolute", c_a=1.0))


@pytest.mark.check
def test_the_thesis_scheme_in_angles_books_the_work_of_the_water(hanging):
    """Energy is that of the start and of the work, to the first order of the scheme."""
    scene = hanging({"weight": {}, "thesis_wave_force": {}}, WAVES)
    scene["start"] = {"kind": "angles", "zero": "down", "polar": [0.8]}
    plain = {"integrator": "thesis_angles", "halvings": 0}
    runs = [dj.simulate(scene, dt=dt, **plain) for dt in (0.004, 0.002)]
    assert np.ptp(runs[1].work) > 0.05 * runs[1].energy_scale
    drift = [run.energy_drift / run.energy_scale for run in runs]
    assert drift[1] < 0.05
    assert drift[1] / drift[0] == pytest.approx(0.5, abs=0.1)


def test_the_relative_form_has_added_mass_only_where_it_is_given(hanging):
    """Schemes with point masses, as the thesis' own, take it without."""
    model = dj.build(relative_scene(hanging))[0]
    assert dj.make_stepper(model, "thesis_angles").integrator.name == "thesis_angles"
    with pytest.raises(dj.SceneError, match="added mass"):
        dj.make_stepper(dj.build(relative_scene(hanging, c_a=0.5))[0], "thesis_angles")
