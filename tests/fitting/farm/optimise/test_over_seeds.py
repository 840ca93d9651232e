"""Characteristic values of seeds' maxima as weights: those of the load cases, and their derivatives."""

import numpy as np
import pytest

from dropper_jax import SceneError
from fitting.farm.cases.characteristic import characteristic_load
from fitting.farm.optimise.maxima_weights import check_seeds, maxima_weights
from fitting.farm.site.sections import RunValues


def run(kind, seeds=10):
    return RunValues(duration=600.0, skip=40.0, seeds=seeds, characteristic=kind)


@pytest.mark.parametrize("kind", ["mean", "most_probable"])
@pytest.mark.parametrize("seeds", [3, 10])
def test_weights_give_what_load_cases_say(kind, seeds):
    maxima = np.random.default_rng(seeds).gumbel(5.0, 1.0, (seeds, 4))
    found = np.sum(maxima_weights(maxima, run(kind)) * maxima, axis=0)
    expected = [characteristic_load(column, run(kind)).value for column in maxima.T]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_most_probable_value_of_a_known_distribution_is_found():
    # the mode of the largest of N Gumbel maxima is mode + scale log N
    maxima = np.random.default_rng(0).gumbel(100.0, 7.0, (4000, 1))
    found = np.sum(maxima_weights(maxima, run("most_probable")) * maxima)
    np.testing.assert_allclose(found, 100.0 + 7.0 * np.log(10800 / 560), rtol=0.01)


def test_loads_that_some_seeds_do_not_know_or_that_do_not_vary_take_the_mean():
    maxima = np.array([[0.0, 2.0], [1.0, 2.0], [3.0, 2.0]])
    np.testing.assert_allclose(maxima_weights(maxima, run("most_probable")), 1 / 3)


def test_too_few_seeds_for_a_distribution_are_refused():
    check_seeds(run("most_probable", 3))
    check_seeds(run("mean", 1))
    with pytest.raises(SceneError, match="run.seeds: 2 for the most probable .* Use 3 or more"):
        check_seeds(run("most_probable", 2))
