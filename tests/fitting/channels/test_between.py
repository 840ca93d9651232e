"""Parameters over runs, against what is known of means of normal samples."""

import numpy as np
import pytest
from scipy.stats import t as student

from dropper_jax import load_scene
from fitting.channels.between_runs import combine_runs, over_runs
from fitting.channels.make_problem import make_problem

VALUES = np.array([1.0, 1.3, 0.9, 1.15, 1.05])


def test_runs_of_equal_and_small_errors_give_students_interval():
    found = combine_runs("b", VALUES, 1e-12 * np.eye(5))
    error = VALUES.std(ddof=1) / np.sqrt(5)
    reach = student(4).ppf(0.95) * error
    expected = (VALUES.mean(), error, VALUES.mean() - reach, VALUES.mean() + reach)
    assert (found.mean, found.std_error, found.low, found.high) == pytest.approx(expected)
    assert found.spread == pytest.approx(VALUES.std(ddof=1), rel=1e-4)


def test_variance_between_runs_is_what_own_errors_do_not_explain():
    """With equal errors s restricted likelihood has tau^2 = var - s^2, or 0."""
    found = combine_runs("b", VALUES, 0.1**2 * np.eye(5))
    assert np.isclose(found.spread**2, VALUES.var(ddof=1) - 0.1**2, rtol=1e-3)
    none = combine_runs("b", VALUES, 0.5**2 * np.eye(5))
    assert none.spread == 0
    assert np.isclose(none.std_error, 0.5 / np.sqrt(5))


def test_intervals_cover_the_mean_of_unequal_runs():
    rng, cover = np.random.default_rng(0), 0
    own = np.array([0.03, 0.04, 0.05, 0.06, 0.04])
    for _ in range(200):
        found = combine_runs("b", 3 + 0.1 * rng.normal(size=5) + own * rng.normal(size=5), np.diag(own**2))
        cover += found.low <= 3 <= found.high
    # 90 % of 200 draws, three standard deviations each way
    assert 167 <= cover <= 193


def test_runs_whose_names_contain_an_at_sign_are_combined_by_parameter():
    scene = load_scene("dropper-release-a")
    t = np.arange(0.0, 1.0, 0.1)
    runs = [{"name": name, "file": {"t": t, "a": 0.0 * t}} for name in ("a@1", "b@2")]
    channel = {"name": "angle", "kind": "angle", "column": "a", "unit": "rad", "link": 1, "noise": 0.01}
    problem = make_problem({"run": runs, "channel": [channel]}, scene, ["b_q"], ["b_l"], {}, {}, {})
    values = np.arange(1.0, 1.0 + len(problem.parameters))
    (found,) = over_runs(problem, values, 1e-12 * np.eye(len(values)))
    assert found.name == "effects.linear_damping.b_l"
    assert found.mean == pytest.approx(values[-2:].mean())
