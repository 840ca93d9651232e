"""The theta scheme weighted about the middle of the step."""

import numpy as np
import pytest

import dropper_jax as dj


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("theta_midpoint", (10, 11, 12, 13), gamma=0.51) == pytest.approx(1.0, abs=0.15)


def test_weights_above_one_half_take_energy_and_a_weight_of_one_takes_most(energy_loss):
    loss = [energy_loss("theta_midpoint", gamma) for gamma in (0.6, 1.0)]
    assert 0 < loss[0] < loss[1]


@pytest.mark.check
def test_a_weighting_of_one_half_is_the_energy_momentum_scheme(march):
    model, s = dj.build("dropper-release-a")
    default = march(dj.make_stepper(model, halvings=0, track_work=False), model, s, 0.5, 128, 2)[0]
    weighted = march(
        dj.make_stepper(model, "theta_midpoint", gamma=0.5, halvings=0, track_work=False),
        model,
        s,
        0.5,
        128,
        2,
    )[0]
    np.testing.assert_array_equal(default, weighted)
