"""Noise told by residuals, against noises that were put in."""

import numpy as np
import pytest

from fitting import Huber, StudentT
from fitting.channels.channel import Data, Run, Sensor
from fitting.channels.noise import Evaluation, Noise, estimate_noise, first_noise, lag_one, rows_of
from fitting.channels.sensors import Angle
from fitting.estimate.loss import LEAST_SQUARES

N = 4000
T = np.arange(N) * 0.1


def measured(y):
    channel = Angle("a", ("a",), "rad")
    return Data((Sensor(channel),), (), (Run("r", (T,), (y[:, None],)),))


def shown(y, slopes):
    return Evaluation(((y[:, None],),), ((slopes[:, None, :],),), ())


def told_of(noise, loss=LEAST_SQUARES):
    slopes = np.stack([np.ones(N), T], 1)
    data, e = measured(noise), shown(np.zeros(N), slopes)
    ones = ((np.ones((N, 1)),),)
    at = Noise(np.array([1.0]), np.full(1, np.inf))
    for _ in range(40):
        rows = rows_of(data, e, at, ones)
        at = estimate_noise(data, e, at, ones, rows.jacobian.T @ rows.jacobian, np.array([1e-9]), loss)
    return at, rows_of(data, e, at, ones)


def test_the_size_of_white_noise_is_told():
    rng = np.random.default_rng(0)
    at, rows = told_of(0.02 * rng.normal(size=N))
    assert at.size[0] == pytest.approx(0.02, rel=0.04)
    assert np.isinf(at.decay[0])
    assert abs(lag_one(rows, 0, rows.residual)[0]) < 0.06


def test_degrees_of_freedom_that_a_fit_takes_are_counted():
    rng = np.random.default_rng(1)
    sizes = []
    for _ in range(300):
        x, y = rng.normal(size=(8, 4)), rng.normal(size=8)
        rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        data = Data((Sensor(Angle("a", ("a",), "rad")),), (), (Run("r", (T[:8],), (rest[:, None],)),))
        e = Evaluation(((np.zeros((8, 1)),),), ((x[:, None, :],),), ())
        one = Noise(np.ones(1), np.full(1, np.inf))
        rows = rows_of(data, e, one, ((np.ones((8, 1)),),))
        found = estimate_noise(data, e, one, ((np.ones((8, 1)),),), rows.jacobian.T @ rows.jacobian, np.array([1e-9]))
        sizes.append(found.size[0] ** 2)
    # mean of chi-square over its degrees of freedom, 4: 1 +- 0.04
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("loss", [Huber(3.0), StudentT()])
def test_robust_losses_tell_the_noise_of_what_does_not_stand_out(loss):
    """From a size that is fifty times too large; 2 % of the samples are a hundred deviations off."""
    rng = np.random.default_rng(5)
    wild = np.where(rng.random(N) < 0.02, 2.0, 0.0)
    at, _ = told_of(0.02 * rng.normal(size=N) + wild, loss)
    assert at.size[0] == pytest.approx(0.02, rel=0.15)


def test_memory_is_told_and_taken_out():
    rng = np.random.default_rng(2)
    r = np.zeros(N)
    for i in range(1, N):
        r[i] = 0.9 * r[i - 1] + np.sqrt(1 - 0.81) * rng.normal()
    at, rows = told_of(0.05 * r)
    assert at.lag_correlation(np.array([0.1]))[0] == pytest.approx(0.9, abs=0.02)
    assert at.size[0] == pytest.approx(0.05, rel=0.15)
    assert abs(lag_one(rows, 0, rows.residual)[0]) < 0.06
    # whitened derivatives of an offset tell as little as so few independent samples: (1 - phi)/(1 + phi) of them
    assert np.sum(rows.jacobian[:, 0] ** 2) * at.size[0] ** 2 == pytest.approx(N / 19, rel=0.25)


def test_a_smooth_misfit_is_no_noise():
    at, rows = told_of(0.05 * np.sin(0.3 * T) + 1e-4 * np.random.default_rng(3).normal(size=N))
    assert np.isinf(at.decay[0])
    assert lag_one(rows, 0, rows.residual)[0] > 0.9


def test_what_samples_say_of_their_noise_on_a_smooth_motion():
    y = np.sin(T) + 0.01 * np.random.default_rng(4).normal(size=N)
    assert first_noise(measured(y), np.zeros(1)).size[0] == pytest.approx(0.01, rel=0.15)
