"""Intervals of estimates at their bounds, and by profile likelihood."""

from types import SimpleNamespace

import numpy as np
import pytest

import dropper_jax as dj
from fitting import profile
from fitting.estimate.uncertainty import intervals, prior_conflicts
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import CameraTarget


@pytest.mark.parametrize("beyond", [0.5, 3.0, 60.0])
def test_the_interval_at_an_upper_bound_mirrors_that_at_a_lower_one(beyond):
    found = []
    for side in (-1, 1):
        bound = side * 2.0
        limits = (bound, np.inf) if side < 0 else (-np.inf, bound)
        problem = SimpleNamespace(parameters=[Parameter("a", CameraTarget(), bound, *limits)])
        solution = SimpleNamespace(
            problem=problem,
            values=np.array([bound]),
            free=np.array([0]),
            free_information=np.eye(1),
            gradient=np.array([-side * beyond]),
        )
        found.append(np.concatenate(intervals(solution, np.ones(1), 0)))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[1], -found[0][::-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "points", "words"),
    [
        ("b_q", 1, "profile: 'effects.quadratic_damping.b_q' is not a free parameter"),
        ("b_l", 0, "profile: 0 points on either side; allowed: at least 1"),
    ],
)
def test_a_profile_without_points_or_of_a_parameter_that_is_not_free_is_refused(name, points, words, refusal):
    """Names may be short, as those of a fit."""
    problem = SimpleNamespace(names=["effects.linear_damping.b_l"])
    result = SimpleNamespace(scene=dj.load_scene("dropper-release-a"), solution=SimpleNamespace(problem=problem))
    assert words in refusal(profile, result, name, points=points)


@pytest.mark.parametrize("prior_error", [0.02, 1.0, 30.0])
def test_a_prior_that_the_data_contradict_is_as_far_off_as_both_estimates(prior_error):
    """Two estimates of one number, 10 +- 0.5 by the data and 13 +- s by the prior: (13 - 10)/sqrt(0.5^2 + s^2)."""
    data, error, mean = 10.0, 0.5, 13.0
    information = 1 / error**2 + 1 / prior_error**2
    value = (data / error**2 + mean / prior_error**2) / information
    parameters = [SimpleNamespace(prior=(mean, prior_error)), SimpleNamespace(prior=None)]
    solution = SimpleNamespace(
        values=np.array([value, 1.0]),
        free=np.array([0, 1]),
        free_information=np.diag([information, 1.0]),
        problem=SimpleNamespace(parameters=parameters),
    )
    errors = SimpleNamespace(at_bound=np.zeros(2, bool), inflation=1.0, noise=1.0)
    found = prior_conflicts(solution, errors)
    np.testing.assert_allclose(found, [(data - mean) / np.hypot(error, prior_error), 0.0], rtol=1e-6)
