"""Gradients against two evaluations along them: exact ones are trusted, those that predict no useful change are not."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError


def smooth(x):
    return jnp.sum(x["a"] ** 2) + 3.0 * x["b"]


X = {"a": jnp.array([1.0, 0.0, 2.0]), "b": jnp.array(5.0)}


def test_a_quadratic_function_has_the_central_difference_of_its_gradient():
    found = dj.check_gradient(smooth, X, jax.grad(smooth)(X))
    assert found.ratio == pytest.approx(1.0, rel=1e-9)
    assert found.status == "trusted"
    assert found.measured == pytest.approx(found.predicted)


def test_the_number_that_matters_most_changes_by_the_size():
    seen = []
    gradient = jax.grad(smooth)(X)
    dj.check_gradient(lambda x: seen.append(x) or smooth(x), X, gradient, size=0.01)
    shares = [(np.asarray(x["b"]) / 5.0, np.asarray(x["a"])[1]) for x in seen]
    assert shares == [(pytest.approx(1.01), 0.0), (pytest.approx(0.99), 0.0)]


def test_a_gradient_of_small_scale_ripples_is_not_trusted():
    """`x + 1e-6 sin(1e9 x)`: the slope is up to 1000, the change of engineering size is that of x."""

    def ripples(x):
        return jnp.sum(x + 1e-6 * jnp.sin(1e9 * x))

    x = jnp.array([2.0 * np.pi * 1e-9 * 3e8])
    found = dj.check_gradient(ripples, x, jax.grad(ripples)(x))
    assert found.status == "not_trusted"
    assert abs(found.ratio) < 0.01


@pytest.mark.parametrize("slope", [0.0, np.nan, np.inf])
def test_a_gradient_without_a_direction_is_not_trusted(slope):
    found = dj.check_gradient(jnp.sum, jnp.ones(2), jnp.full(2, slope))
    assert found.status == "not_trusted"
    assert np.isnan(found.ratio)


def test_wrong_forms_are_refused_in_one_line():
    with pytest.raises(SceneError, match="gradient: has another form than x"):
        dj.check_gradient(smooth, X, {"a": jnp.ones(3)})
    with pytest.raises(SceneError, match="size: 2; allowed: above 0 and below 1"):
        dj.check_gradient(jnp.sum, jnp.ones(2), jnp.ones(2), size=2.0)


@pytest.mark.check
def test_the_gradient_of_a_run_is_trusted_by_two_runs():
    model, start = dj.build("dropper-release-a")
    stepper = dj.make_stepper(model, "rattle", track_work=False)
    weight, linear, quadratic = model.effects

    @jax.jit
    def height(b_l):
        damped = replace(model, effects=(weight, replace(linear, b_l=b_l), quadratic))
        return dj.integrate(stepper, damped, start, dt=0.005, steps=100, warn=False)[1].r[:, 2, 2].mean()

    found = dj.check_gradient(height, 0.002, jax.jit(jax.grad(height))(0.002))
    assert found.ratio == pytest.approx(1.0, abs=1e-3)
    assert found.status == "trusted"
    assert dj.check_gradient(height, 0.002, 1.2 * jax.jit(jax.grad(height))(0.002)).status == "not_trusted"
