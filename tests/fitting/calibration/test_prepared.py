"""What a fit is prepared with."""

from types import SimpleNamespace

import numpy as np

from fitting import Trace
from fitting.calibration.prepared import Prepared


def test_the_least_noise_of_a_link_without_standard_errors_is_that_of_its_samples():
    """Rounding to 0.01 rad; standard errors of 0.004 rad are stated of the first link alone."""
    theta = np.zeros((20, 2))
    trace = Trace("run", np.arange(20.0), theta, se=np.where([True, False], 0.004, np.nan) + theta)
    fit = SimpleNamespace(resolution=lambda quantity: 0.01)
    prepared = SimpleNamespace(scene=SimpleNamespace(fit=fit), sigma=[np.array([0.1, 0.02])], traces=[trace])
    rounding = 0.01 / np.sqrt(12)
    np.testing.assert_allclose(Prepared.floor.fget(prepared), [[rounding / 0.004, rounding / 0.02]])
