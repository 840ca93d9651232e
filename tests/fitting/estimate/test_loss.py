"""Losses: their weights give the slope that their cost has, and outliers pull no more than they should."""

import numpy as np
import pytest

from fitting.estimate.loss import LEAST_SQUARES, Huber, loss_of

RESIDUALS = np.array([-7.0, -2.1, -1.9, -0.3, 0.0, 0.4, 1.0, 2.5, 40.0])


@pytest.mark.parametrize("loss", [LEAST_SQUARES, Huber(2.0)])
def test_weighted_residuals_are_the_slope_of_the_cost(loss):
    slope = [(loss.cost(np.array([r + 1e-6])) - loss.cost(np.array([r - 1e-6]))) / 2e-6 for r in RESIDUALS]
    np.testing.assert_allclose(loss.weights(RESIDUALS) * RESIDUALS, slope, atol=1e-6)


def test_huber_is_least_squares_within_its_threshold_and_straight_beyond():
    near = RESIDUALS[np.abs(RESIDUALS) <= 2.0]
    assert Huber(2.0).cost(near) == pytest.approx(0.5 * np.sum(near**2))
    assert Huber(2.0).cost(np.array([40.0])) - Huber(2.0).cost(np.array([39.0])) == pytest.approx(2.0)


def test_a_fit_without_a_threshold_is_one_of_least_squares():
    assert loss_of(None) is LEAST_SQUARES
    assert loss_of(3.0) == Huber(3.0)
