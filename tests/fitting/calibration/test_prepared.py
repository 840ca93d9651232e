"""What a fit is prepared with."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fitting import Trace
from fitting.estimate.noise import Noise
from fitting.estimate.rest import rests
from fitting.windows.prepared import Prepared


def test_the_least_noise_of_a_link_without_standard_errors_is_that_of_its_samples():
    """Rounding to 0.01 rad; standard errors of 0.004 rad are stated of the first link alone."""
    theta = np.zeros((20, 2))
    trace = Trace("run", np.arange(20.0), theta, se=np.where([True, False], 0.004, np.nan) + theta)
    fit = SimpleNamespace(resolution=lambda quantity: 0.01)
    prepared = SimpleNamespace(scene=SimpleNamespace(fit=fit), sigma=[np.array([0.1, 0.02])], traces=[trace])
    rounding = 0.01 / np.sqrt(12)
    np.testing.assert_allclose(Prepared.floor.fget(prepared), [[rounding / 0.004, rounding / 0.02]])


def test_laws_weigh_poses_at_rest_by_the_noise_of_the_fit(prepared):
    """Noise of twice the claimed size leaves a quarter of the cost of the poses."""
    still = Trace("rods", np.arange(40) / 30, np.full((40, 2), np.pi / 2 + 1e-3))
    rest = rests([still], [np.full(2, 0.005)], [(0.0, 1.0)])
    claimed = replace(prepared, rest=rest).problem()
    twice = replace(Noise.as_claimed(1, 2), factor=np.full((1, 2), 2.0))
    fitted = claimed.with_noise(twice, claimed.windows, prepared.values)
    law = replace(prepared, rest=rest).with_noise_of(fitted).problem()
    cost = [problem.rest.prior(prepared.simulator, prepared.values).cost for problem in (claimed, law)]
    np.testing.assert_allclose(cost[1], cost[0] / 4)
