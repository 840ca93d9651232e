"""Losses: their weights give the slope that their cost has, and outliers pull no more than they should."""

import numpy as np
import pytest
from scipy.stats import t as student_t

from dropper_jax import SceneError
from fitting import Huber, StudentT
from fitting.estimate.loss import LEAST_SQUARES, as_loss, initial_loss
from fitting.estimate.uncertainty import robust_variance

RESIDUALS = np.array([-7.0, -2.1, -1.9, -0.3, 0.0, 0.4, 1.0, 2.5, 40.0])


@pytest.mark.parametrize("loss", [LEAST_SQUARES, Huber(2.0), StudentT()])
def test_weighted_residuals_are_the_slope_of_the_cost_and_curvature_is_its_derivative(loss):
    pull = lambda r: loss.weights(r) * r  # noqa: E731
    slope = [(loss.cost(np.array([r + 1e-6])) - loss.cost(np.array([r - 1e-6]))) / 2e-6 for r in RESIDUALS]
    np.testing.assert_allclose(pull(RESIDUALS), slope, atol=1e-6)
    difference = (pull(RESIDUALS + 1e-6) - pull(RESIDUALS - 1e-6)) / 2e-6
    np.testing.assert_allclose(loss.curvature(RESIDUALS), difference, atol=1e-5)


@pytest.mark.parametrize("loss", [Huber(1.5), StudentT()])
def test_the_variance_of_a_robust_mean_is_the_scatter_of_draws(loss):
    """Means of 200 normal samples, one in twenty of them 5 times as wide: by Newton, against their own spread."""
    rng = np.random.default_rng(0)
    samples = rng.standard_normal((2000, 200)) * np.where(rng.random((2000, 200)) < 0.05, 5.0, 1.0)
    mean = np.zeros((2000, 1))
    for _ in range(50):
        weight = loss.weights(samples - mean)
        mean = np.sum(weight * samples, axis=1, keepdims=True) / np.sum(weight, axis=1, keepdims=True)
    reported = [robust_variance(x, loss, 199) / loss.weights(x).sum() for x in (samples - mean)[:200]]
    assert np.mean(reported) == pytest.approx(mean.var(), rel=0.1)


@pytest.mark.parametrize("size", [0.0, -1.0, np.nan])
def test_a_loss_without_a_size_is_refused(size):
    with pytest.raises(SceneError, match="huber: .* is not positive"):
        Huber(size)
    with pytest.raises(SceneError, match="student: .* is not positive"):
        StudentT(size)


def test_huber_is_least_squares_within_its_threshold_and_straight_beyond():
    near = RESIDUALS[np.abs(RESIDUALS) <= 2.0]
    assert Huber(2.0).cost(near) == pytest.approx(0.5 * np.sum(near**2))
    assert Huber(2.0).cost(np.array([40.0])) - Huber(2.0).cost(np.array([39.0])) == pytest.approx(2.0)


def test_a_loss_is_given_by_its_name_or_itself_and_starts_with_one_of_a_single_minimum():
    assert as_loss("squares") is initial_loss(LEAST_SQUARES) is LEAST_SQUARES
    assert as_loss("huber") == initial_loss(StudentT()) == Huber(3.0)
    assert as_loss(Huber(2.0)) == Huber(2.0)
    with pytest.raises(SceneError, match="loss: 3 is unknown"):
        as_loss(3)


def test_students_loss_is_the_log_density_of_t_with_its_freedom():
    density = student_t(4.0).logpdf
    found = StudentT().cost(np.array([3.0])) - StudentT().cost(np.array([1.0]))
    assert found == pytest.approx((density(1.0) - density(3.0)) * 4 / 5)  # of curvature 1 at zero
    slope = StudentT().weights(RESIDUALS) * RESIDUALS
    assert abs(slope[-1]) < abs(slope[-2])  # the farthest pulls least


def test_squares_give_the_variance_of_normal_noise():
    draws = np.random.default_rng(0).standard_normal(400_000)
    for loss in (LEAST_SQUARES, Huber(1.0), Huber(1.5), Huber(3.0), StudentT()):
        assert np.mean(loss.squares(draws)) == pytest.approx(1.0, rel=0.01)
