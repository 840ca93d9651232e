"""`[fit]` of a scene: read, refused, and of no effect on the simulation."""

import copy

import jax
import numpy as np
import pytest

from dropper_jax import Scene, build_model, load_scene

PRIOR = {"of": "line.0.mass", "sigma": 0.3, "unit": "%", "common": True}
SENSOR = {"channel": "angle", "resolution": 0.36, "unit": "deg"}
FIT = {"free": ["b_l"], "sensor": [SENSOR], "prior": [PRIOR]}


def scene(fit):
    table = copy.deepcopy(load_scene("conical-pendulum-damped").to_dict())
    return Scene.from_dict({**table, "fit": fit})


def test_what_a_rig_knows_survives_plain_values():
    first = scene(FIT)
    assert Scene.from_dict(first.to_dict()) == first
    assert first.fit.free == ("b_l",)
    assert first.fit.resolution("angle") == pytest.approx(np.radians(0.36))
    assert first.fit.priors[0].in_si_units == (pytest.approx(0.003), "%")


def test_what_a_rig_knows_is_no_part_of_the_model():
    with_fit, without = build_model(scene(FIT)), build_model(load_scene("conical-pendulum-damped"))
    assert jax.tree.structure(with_fit) == jax.tree.structure(without)
    for a, b in zip(jax.tree.leaves(with_fit), jax.tree.leaves(without), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("fit", "words"),
    [
        ({"prior": [{**PRIOR, "sigma": 0.0}]}, "fit.prior.0.sigma: 0.0 is out of range"),
        ({"prior": [{**PRIOR, "sigma": -1.0}]}, "fit.prior.0.sigma: -1.0 is out of range"),
        ({"prior": [{**PRIOR, "unit": "stone"}]}, "fit.prior.0.unit: 'stone' is unknown"),
        ({"prior": [{**PRIOR, "unit": "g"}]}, "fit.prior.0.unit: 'g' is not a relative unit"),
        ({"prior": [PRIOR, PRIOR]}, "fit.prior.1.of: 'line.0.mass' is given twice"),
        ({"prior": [{"of": "line.0.mass", "unit": "%"}]}, "fit.prior.0.sigma: missing"),
        ({"sensor": [{**SENSOR, "channel": "smell"}]}, "fit.sensor.0.channel: 'smell' is unknown"),
        ({"sensor": [{**SENSOR, "unit": "kg"}]}, "fit.sensor.0.unit: 'kg' does not measure this"),
        ({"sensor": [{**SENSOR, "resolution": 0.0}]}, "fit.sensor.0.resolution: 0.0 is out of range"),
        ({"free": ["b_l", "b_l"]}, "fit.free.1: 'b_l' is given twice"),
        ({"free": [3]}, "fit.free.0: 3 is not a text"),
        ({"free": "b_l"}, "fit.free: 'b_l' is not a list"),
        ({"priors": []}, "fit.priors: unknown key; did you mean 'prior'"),
    ],
)
def test_what_cannot_be_used_is_named(fit, words, refusal):
    assert words in refusal(scene, fit)
