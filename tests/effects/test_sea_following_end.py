"""An end that moves with the water at the surface."""

import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import build_model

WAVES = {"kind": "regular", "amplitude": 1.0, "period": 7.0, "direction": 0.5}


@pytest.fixture
def following(hanging):
    """`following(**factors)`: a line whose end follows the waves."""

    def make(**factors):
        sea = {"waves": WAVES, "ramp": 2.0, "stretching": "none"}
        return hanging({"weight": {}, "sea_following_end": {"point": "top", **factors}}, sea)

    return make


def test_an_end_that_follows_the_sea_moves_with_the_water_at_the_surface(following):
    scene = following()
    scene["point"][0]["position"], scene["point"][1]["position"] = [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]
    model = build_model(dj.load_scene(scene))
    place, t = jnp.zeros((1, 3)), jnp.array(5.0)
    ends = model.ends(t)
    np.testing.assert_allclose(ends.start[2], model.sea.elevation(place, t)[0], atol=1e-12)
    np.testing.assert_allclose(ends.velocities[0], model.sea.at(place, t).velocity[0], atol=1e-12)
    assert np.all(np.asarray(model.ends(jnp.array(0.0)).start) == 0.0)


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        ({"heave": [0.0, 1.0], "omega": [2.0, 1.0]}, "sea_following_end.omega: needs at least one number, each above"),
        ({"heave": [0.0, 1.0]}, "heave: has 2 values, but there is no `omega`; allowed: 1"),
        ({"heave": [0.0, 1.0, 0.0], "omega": [1.0, 2.0]}, "heave: has 3 values; allowed: 1, or 2 as `omega`"),
    ],
)
def test_factors_over_frequencies_that_do_not_rise_or_match_are_refused(factors, message, following, refusal):
    assert message in refusal(dj.load_scene, following(**factors))


def test_a_factor_of_one_entry_is_that_of_all_frequencies(following):
    one, several = (
        build_model(dj.load_scene(following(**factors))).ends(jnp.array(5.0)).start
        for factors in ({"heave": 0.8}, {"heave": [0.8], "omega": [0.5, 2.0]})
    )
    np.testing.assert_array_equal(one, several)
