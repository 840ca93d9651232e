"""One sample that is far off is named and not fitted; its window is. Traces of another simulator."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import FitSettings, prepare
from fitting.calibration.summarise import summarise
from fitting.windows.method import estimate
from fitting.windows.sound_windows import with_sound_windows

FRAME, LINK = 100, 1
#: In a window of 12 frames one outlier moves all residuals by many times the noise.
SHORT = FitSettings(window=0.4)


@pytest.fixture(scope="module")
def fit_with(two, rods, ready, motion):
    """`fit_with(value)`: the fit of a trace with another value of one sample."""
    trace = two.seen(motion, 0)
    simulator = ready(trace).simulator

    def run(value):
        theta = trace.theta.copy()
        theta[FRAME, LINK] = value
        changed = replace(trace, theta=theta)
        sound = with_sound_windows(prepare([changed], rods, two.FREE, settings=SHORT, simulator=simulator))
        return summarise(sound, "windows", estimate(sound, "windows"))

    return run, trace


@pytest.fixture(scope="module")
def without(fit_with):
    return fit_with[0](np.nan)


@pytest.mark.parametrize("off", [0.5, -2.0])
def test_one_outlier_is_named_and_its_window_is_fitted_without_it(two, fit_with, without, off):
    run, trace = fit_with
    found = run(trace.theta[FRAME, LINK] + off)
    assert found.status == "ok"
    assert not found.left_out
    assert found.windows.samples == without.windows.samples
    assert np.all(np.abs(found.values - two.TRUTH) < 3.5 * found.uncertainty.std_error)
    line = f"isolated outliers are not fitted: rods link {LINK + 1} at {trace.t[FRAME]:.3f} s"
    assert any(line in warning for warning in found.warnings)
    assert not any("outliers" in warning for warning in without.warnings)


def test_a_fit_without_its_outlier_is_that_of_a_trace_without_this_sample(fit_with, without):
    """Half a radian does not change how the windows are cut."""
    run, trace = fit_with
    found = run(trace.theta[FRAME, LINK] + 0.5)
    np.testing.assert_array_equal(found.windows.begin, without.windows.begin)
    np.testing.assert_allclose(found.values, without.values, atol=0.02 * without.uncertainty.std_error.min())
