"""The theta scheme: first order, and the energy it takes."""

import pytest


@pytest.mark.slow
def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("theta", (10, 11, 12, 13), gamma=0.51) == pytest.approx(1.0, abs=0.15)
    assert order("theta", (13, 14, 15, 16), gamma=1.0) == pytest.approx(1.0, abs=0.2)


def test_damping_leaves_the_order_as_it_is(order):
    assert order("theta", (11, 12), damped=True) == pytest.approx(1.0, abs=0.15)


def test_weights_above_one_half_take_energy_and_a_weight_of_one_takes_most(energy_loss):
    loss = [energy_loss("theta", gamma) for gamma in (0.6, 1.0)]
    assert 0 < loss[0] < loss[1]
