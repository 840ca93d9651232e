"""Importance weights and the posterior they give: known laws, a pendulum whose posterior is nearly normal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import genpareto, norm
from scipy.stats import t as student

from dropper_jax import SceneError
from fitting import Camera, fit
from fitting.estimate.posterior import Posterior, importance, pareto, smooth_weights
from fitting.traces.synthetic import synthetic_traces


@pytest.mark.parametrize("shape", [-0.3, 0.2, 0.5, 0.9])
def test_the_shape_of_a_tail(shape):
    """Against draws of SciPy's law; the estimate leans to a half by ten draws' worth."""
    found = [pareto(np.sort(genpareto.rvs(shape, scale=2.0, size=400, random_state=seed)))[0] for seed in range(20)]
    assert np.mean(found) == pytest.approx(shape, abs=0.06)


def test_weights_of_a_wide_proposal_are_good_and_of_a_narrow_one_are_told():
    random = np.random.default_rng(1)
    wide = student.rvs(5, size=2000, random_state=random)
    weight, shape = smooth_weights(norm.logpdf(wide) - student.logpdf(wide, 5))
    assert shape < 0.5
    found = Posterior(("x",), wide[:, None], weight, shape)
    np.testing.assert_allclose(found.mean, 0.0, atol=0.08)
    np.testing.assert_allclose(found.std, 1.0, atol=0.06)
    np.testing.assert_allclose(found.quantile(0.95), norm.ppf(0.95), atol=0.12)
    assert not found.warnings
    narrow = 0.3 * random.standard_normal(2000)
    weight, shape = smooth_weights(student.logpdf(narrow, 2) - norm.logpdf(narrow, scale=0.3))
    assert shape > 0.7
    assert "not to be trusted" in Posterior(("x",), narrow[:, None], weight, shape).warnings[0]


def test_no_weight_at_all_is_told():
    weight, shape = smooth_weights(np.full(100, -np.inf))
    assert not weight.any()
    assert np.isinf(shape)


@pytest.fixture(scope="module")
def pendulum():
    scene = {
        "run": {"dt": 0.01, "duration": 12.0},
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "bob", "kind": "free", "position": [0.8, 0.0, 0.0]},
        ],
        "line": [{"name": "rod", "from": "top", "to": "bob", "links": 1, "length": 0.8, "mass": 0.5}],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.05}},
        "start": {"kind": "angles", "polar": [1.2]},
    }
    traces = synthetic_traces([scene], 12.0, Camera(angle_noise=0.01))
    return fit(traces, scene, ["b_l", "line.0.length"], start={"b_l": 0.1})


def test_a_nearly_normal_posterior_is_the_fit_itself(pendulum):
    """Damping and length of a small swing: linear in both, so that the posterior is the normal law of the fit."""
    u = pendulum.uncertainty
    found = importance(pendulum.solution, 300)
    assert found.shape < 0.7
    assert found.unsolved == 0
    assert found.effective > 100
    np.testing.assert_allclose((found.mean - pendulum.values) / u.std_error, 0.0, atol=0.3)
    np.testing.assert_allclose(found.std / u.std_error, 1.0, atol=0.2)
    for p, end in ((0.05, u.low), (0.95, u.high)):
        np.testing.assert_allclose((found.quantile(p) - end) / u.std_error, 0.0, atol=0.3)


def test_few_draws_are_refused(pendulum):
    with pytest.raises(SceneError, match="posterior: 20 draws"):
        importance(pendulum.solution, 20)


def test_the_density_of_starts_and_parameters_and_its_slope(pendulum):
    """At the optimum it is flat; away from it, its slope is that of differences, and its fall that of a normal law."""
    import jax
    import jax.numpy as jnp

    from fitting.estimate.nuts import Density

    target = Density(pendulum.solution, np.arange(2))
    both = jax.jit(jax.value_and_grad(target.function()))
    size = len(target.to_moves)
    best, flat = both(jnp.zeros(size))
    assert np.abs(flat).max() < 0.05
    y = 0.7 * np.random.default_rng(2).standard_normal(size)
    value, slope = both(jnp.asarray(y))
    for i in (0, 3, size - 2, size - 1):
        step = 1e-4 * np.eye(size)[i]
        ends = [float(both(jnp.asarray(y + sign * step))[0]) for sign in (1, -1)]
        assert (ends[0] - ends[1]) / 2e-4 == pytest.approx(float(slope[i]), rel=2e-4, abs=2e-4)
    assert float(best - value) == pytest.approx(0.5 * y @ y, rel=0.05)


@pytest.mark.check
def test_chains_of_a_nearly_normal_posterior_are_its_normal_law(pendulum):
    pytest.importorskip("blackjax")
    from fitting.estimate.nuts import nuts

    u, found = pendulum.uncertainty, nuts(pendulum.solution, 200, seed=1)
    assert not found.divergent
    assert np.max(found.rhat) < 1.01
    assert found.effective > 400
    assert not found.warnings
    for p, end in ((0.05, u.low), (0.5, pendulum.values), (0.95, u.high)):
        np.testing.assert_allclose((found.quantile(p) - end) / u.std_error, 0.0, atol=0.3)
