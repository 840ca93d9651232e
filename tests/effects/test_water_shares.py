"""Compound links in water: their forces are shared between their nodes."""

import numpy as np

import dropper_jax as dj


def test_compound_links_share_the_water_forces_between_their_nodes(hanging, in_water):
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0, "cdt": 0.1}, "morison_inertia": {"can": 1.0}}
    line = {"centre_of_mass": 0.5, "inertia": 10.0 / 12}
    model, state = dj.build(hanging(effects, {"current": {"speed": 1.0}}, links=3, **line))
    point, _ = dj.build(hanging(effects, {"current": {"speed": 1.0}}, links=3))
    shares = np.array([1.0, 1.0, 0.5])
    for name in ("buoyancy", "morison_drag", "morison_inertia"):
        whole = point.effect(name).force(in_water(point, state.r, state.v, 0.0))
        parts = model.effect(name).force(in_water(model, state.r, state.v, 0.0))
        np.testing.assert_allclose(parts, shares[:, None] * whole, atol=1e-10)
