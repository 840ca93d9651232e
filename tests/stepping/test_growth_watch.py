"""Derivatives in reverse mode that have grown through a run are warned of, once, and are the same as without."""

import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.stepping import growth_watch


@pytest.fixture(scope="module")
def slope():
    """The derivative of the last position of a chaotic double pendulum by its first velocities."""
    model, s = dj.build("double-pendulum-chaotic")
    stepper = dj.make_stepper(model, "rattle", halvings=0, track_work=False)

    def of(steps, **settings):
        def last(v):
            return dj.integrate(stepper, model, replace(s, v=v), 0.01, steps, 4, **settings)[0].r[-1, 0]

        found = jax.jit(jax.grad(last))(s.v)
        jax.effects_barrier()
        return found

    return of


@pytest.mark.check
def test_a_derivative_that_has_grown_is_warned_of_and_unchanged(slope):
    with pytest.warns(RuntimeWarning, match=r"grown by more than e\^10"):
        grown = slope(6_000)
    assert jnp.max(jnp.abs(grown)) > np.exp(10.0)
    np.testing.assert_array_equal(grown, slope(6_000, warn=False))  # warnings are errors here


def test_a_derivative_of_a_short_run_is_not_warned_of(slope):
    assert jnp.max(jnp.abs(slope(200))) < 100.0


@pytest.mark.parametrize(("rate", "count"), [(0.0, 0), (0.8, 0), (1.2, 1)])
def test_growth_is_measured_over_the_run_and_not_from_sums(rate, count):
    """The cotangent of a mean over 1000 steps, which is a sum of contributions, each grown by e^rate per 1/10."""
    meter = jnp.zeros(2)
    for save in reversed(range(1000)):
        ages = (np.arange(save, 1000) - save) / 100
        cotangent = jnp.full((3, 3), np.sum(np.exp(rate * ages)) / 1000)
        meter = growth_watch._measure(meter, cotangent, jnp.asarray((1000 - save) % (1000 // 16) == 0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        growth_watch._warn(np.asarray(meter))
    assert len(caught) == count
