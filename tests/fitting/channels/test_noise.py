"""Noise estimated from residuals, against noises that were put in."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import Huber, StudentT
from fitting.channels.data import ChannelData, MeasuredRun, Sensor
from fitting.channels.problem import Evaluation, Problem
from fitting.channels.sensors import Angle
from fitting.estimate.least_squares import first_solution
from fitting.estimate.loss import LEAST_SQUARES
from fitting.estimate.neighbour_correlation import lag_one
from fitting.estimate.noise import Noise
from fitting.estimate.residual_noise import ResidualNoiseModel
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import Direction

N = 4000
T = np.arange(N) * 0.1
NO_SCENES = {"scenes": (SimpleNamespace(fit=None),), "of_run": (), "plain": (), "near": ()}


def measured(y):
    channel = Angle("a", ("a",), "rad")
    return ChannelData((Sensor(channel),), (), (MeasuredRun("r", (T[: len(y)],), (y[:, None],)),))


def estimate_size(y, slopes, size=1.0, loss=LEAST_SQUARES, rounds=3):
    """Size, memory (1/s), correlation of neighbours and derivatives, whitened, of samples (N,) of a sensor at rest.

    Args:
        slopes: derivatives (N, p) by the parameters of a fit whose residuals the samples are.
        size: of the noise to start from.
    """
    parameters = [Parameter(str(i), Direction({}, 0.0, linear=True), 0.0, -np.inf) for i in range(slopes.shape[1])]
    problem = Problem(data=measured(y), parameters=tuple(parameters), loss=loss, **NO_SCENES)
    still = Evaluation(((np.zeros((len(y), 1)),),), ((slopes[:, None, :],),), ())
    point = first_solution(problem, np.zeros(len(parameters)), problem.whiten_residuals(still))
    noise = Noise(np.full((1, 1), size / problem.claimed_noise[0]), np.full((1, 1), np.inf), np.zeros(1))
    model = ResidualNoiseModel(point, problem.windows, (), np.array([[1e-9]]))
    for _ in range(rounds):
        point = model.estimate(noise)
        noise = point.problem.noise
    rho = lag_one(point.evaluation.residual, point.windows.weight > 0)[0]
    return float(point.problem.noise_size[0]), float(noise.decay[0, 0]), rho, point.evaluation.jacobian[0, :, 0]


def of_line(y, loss=LEAST_SQUARES, rounds=3):
    return estimate_size(y, np.stack([np.ones(N), T], 1), loss=loss, rounds=rounds)


def test_the_size_of_white_noise_is_estimated():
    size, decay, rho, _ = of_line(0.02 * np.random.default_rng(0).normal(size=N))
    assert size == pytest.approx(0.02, rel=0.04)
    assert np.isinf(decay)
    assert abs(rho) < 0.06


def test_degrees_of_freedom_that_a_fit_takes_are_counted():
    rng = np.random.default_rng(1)
    sizes = []
    for _ in range(300):
        x, y = rng.normal(size=(8, 4)), rng.normal(size=8)
        rest = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        sizes.append(estimate_size(rest, x, rounds=1)[0] ** 2)
    # mean of chi-square over its degrees of freedom, 4: 1 +- 0.04
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("loss", [Huber(3.0), StudentT()])
def test_robust_losses_estimate_the_noise_without_outliers(loss):
    """From a size that is fifty times too large; 2 % of the samples are a hundred deviations off."""
    rng = np.random.default_rng(5)
    wild = np.where(rng.random(N) < 0.02, 2.0, 0.0)
    assert of_line(0.02 * rng.normal(size=N) + wild, loss, 14)[0] == pytest.approx(0.02, rel=0.15)


def test_memory_of_noise_is_estimated_and_removed():
    rng = np.random.default_rng(2)
    r = np.zeros(N)
    for i in range(1, N):
        r[i] = 0.9 * r[i - 1] + np.sqrt(1 - 0.81) * rng.normal()
    size, decay, rho, slopes = of_line(0.05 * r)
    assert np.exp(-0.1 * decay) == pytest.approx(0.9, abs=0.02)
    assert size == pytest.approx(0.05, rel=0.15)
    assert abs(rho) < 0.06
    # whitened derivatives of an offset contain as little as so few independent samples: (1 - phi)/(1 + phi) of them
    assert np.sum(slopes[:, 0] ** 2) * size**2 == pytest.approx(N / 19, rel=0.25)


def test_a_smooth_misfit_is_no_noise():
    _, decay, rho, _ = of_line(0.05 * np.sin(0.3 * T) + 1e-4 * np.random.default_rng(3).normal(size=N))
    assert np.isinf(decay)
    assert rho > 0.9


def test_each_sensor_has_a_memory_of_its_own():
    """A sensor with memory and one without, in two runs: each has its own size and memory, and no other is assumed."""
    rng = np.random.default_rng(6)
    white, kept = rng.normal(size=(2, N)), rng.normal(size=(2, N))
    for i in range(1, N):
        kept[:, i] = 0.8 * kept[:, i - 1] + 0.6 * kept[:, i]
    sensors = tuple(Sensor(Angle(name, (name,), "rad"), noise=1.0) for name in ("a", "b"))
    runs = tuple(MeasuredRun(str(i), (T, T), (0.02 * white[i][:, None], 0.5 * kept[i][:, None])) for i in range(2))
    problem = Problem(data=ChannelData(sensors, (), runs), parameters=(), **NO_SCENES)
    shown = [[np.zeros((N, 1))] * 2] * 2
    e = problem.whiten_residuals(Evaluation(shown, [[np.zeros((N, 1, 0))] * 2] * 2, ()))
    model = ResidualNoiseModel(first_solution(problem, np.zeros(0), e), problem.windows, (), np.full((2, 1), 1e-9))
    noise = model.estimate(Noise.as_claimed(2, 1)).problem.noise
    np.testing.assert_allclose(noise.factor[:, 0], [0.02, 0.5], rtol=0.08)
    np.testing.assert_allclose(np.exp(-0.1 * noise.decay[:, 0]), [0.0, 0.8], atol=0.03)
