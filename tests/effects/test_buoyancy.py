"""Buoyancy: dry and wet weight, and the volume that they give."""

import numpy as np
import pytest

import dropper_jax as dj

RHO, G = 1000.0, 9.81


def test_a_node_out_of_the_water_has_its_dry_weight_back_and_a_deep_one_its_wet_weight(hanging, in_water):
    effects = {"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0}, "morison_inertia": {"can": 1.0}}
    model, state = dj.build(hanging(effects, {}))
    volume = np.pi / 4 * 0.05**2
    for z, lift in ((5.0, 0.0), (-7.0, RHO * G * volume)):
        k = in_water(model, [[0.0, 0.0, z]], [[1.0, 0.0, 0.0]], 0.0)
        assert float(model.effect("buoyancy").force(k)[0, 2]) == pytest.approx(lift, rel=1e-12)
        drag = np.asarray(model.effect("morison_drag").force(k)[0])
        assert np.all(drag == 0.0) if z > 0 else drag[0] < 0.0


def test_volume_follows_from_dry_and_wet_weight(hanging, in_water):
    scene = hanging({"weight": {}, "buoyancy": {"wet_weight": 60.0}}, {}, diameter=None)
    model, state = dj.build(scene)
    k = in_water(model, state.r, state.v, 0.0)
    assert float(model.force(k)[0, 2]) == pytest.approx(-60.0, rel=1e-12)
    assert float(model.line.volume[0]) == pytest.approx((10.0 * G - 60.0) / (RHO * G), rel=1e-12)
