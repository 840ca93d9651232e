"""The wave force of the thesis: that of the water at the origin."""

import jax.numpy as jnp
import numpy as np

import dropper_jax as dj

RHO = 1000.0


def test_the_thesis_force_is_that_of_the_water_at_the_origin_on_every_node(hanging, in_water):
    waves = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}
    scene = hanging({"weight": {}, "thesis_wave_force": {"c_d": 2.0, "c_m": 1.5}}, {"waves": waves}, links=2)
    model, state = dj.build(scene)
    water = model.sea.at(jnp.zeros((1, 3)), jnp.array(1.3))
    u, a = np.asarray(water.velocity[0]), np.asarray(water.acceleration[0])
    force = np.pi / 4 * RHO * 0.05**2 * 1.5 * a + 0.5 * RHO * 0.05 * 2.0 * np.abs(u) * u
    found = model.effect("thesis_wave_force").force(in_water(model, state.r, state.v + 3.0, 1.3))
    np.testing.assert_allclose(found, [force, force], rtol=1e-12)
