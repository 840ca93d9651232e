"""Growth of errors over windows of which some have no motion."""

import warnings
from types import SimpleNamespace

import numpy as np

import dropper_jax as dj
from fitting.estimate.error_growth import transitions


def test_a_window_whose_run_failed_has_no_transition_and_leaves_the_others_theirs():
    # next to missing samples a window's start, and so its end, can be NaN: no basis of closed motions exists there
    model, _ = dj.build("dropper-release-a")
    rng = np.random.default_rng(0)
    links, free, windows = 7, 10, 3
    simulator = SimpleNamespace(freedoms=free, model_at=lambda values: model)
    end = rng.normal(size=(windows, 2 * links))
    jacobian = rng.normal(size=(windows, 2 * links, free))
    whole = SimpleNamespace(start=end, end=end, end_jacobian=jacobian)
    lost = SimpleNamespace(start=end, end=end.copy(), end_jacobian=jacobian)
    lost.end[1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = transitions(simulator, lost, np.zeros(2))
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(found[[0, 2]], transitions(simulator, whole, np.zeros(2))[[0, 2]])
