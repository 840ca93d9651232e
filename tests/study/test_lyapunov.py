"""The largest Lyapunov exponent against motions whose exponent is known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import chain

import dropper_jax as dj
from dropper_jax.study.lyapunov import lyapunov


def test_an_upside_down_pendulum_leaves_at_its_rate() -> None:
    """Balanced on its head it leaves as exp(t sqrt(g/L)) (linear theory): the exponent is sqrt(9.81/2)."""
    model, s = dj.build(chain("upside-down", [np.pi], 2.0))
    found = lyapunov(model, s, dj.make_stepper(model).plain, 0.002, 1000)
    assert float(found.exponent) == np.float64(found.exponent)
    np.testing.assert_allclose(float(found.exponent), np.sqrt(9.81 / 2.0), rtol=1e-3)


def test_a_damped_pendulum_at_rest_loses_perturbations_at_half_its_damping_rate() -> None:
    """x'' + (b/m) x' + (g/L) x = 0 has the real part -b/(2m) = -0.4 1/s."""
    model, s = dj.build(chain("damped", [0.0], 1.0, effects={"weight": {}, "linear_damping": {"b_l": 0.8}}))
    found = lyapunov(model, s, dj.make_stepper(model).plain, 0.005, 8000)
    np.testing.assert_allclose(float(found.exponent), -0.4, atol=0.02)


def test_growth_is_that_of_two_neighbouring_runs() -> None:
    """The tangent map against the difference of two runs 1e-7 apart, by the ratio of their sizes at two times."""
    model, s = dj.build("double-pendulum-chaotic")
    stepper = dj.make_stepper(model).plain
    steps, dt = 1500, 0.002
    growth = np.asarray(lyapunov(model, s, stepper, dt, steps).growth)
    v = jax.random.normal(jax.random.key(0), s.v.shape)
    links = jnp.stack([s.r[0], s.r[1] - s.r[0]])
    first = v[0] - links[0] * (links[0] @ v[0]) / (links[0] @ links[0])  # the part that keeps the first link's length
    side = v[1] - first - links[1] * (links[1] @ (v[1] - first)) / (links[1] @ links[1])
    run = jax.jit(lambda v0: dj.integrate(stepper, model, replace(s, v=v0), dt, steps)[1].r)
    apart = run(s.v + 1e-7 * jnp.stack([first, first + side])) - run(s.v)
    sizes = np.linalg.norm(np.asarray(apart).reshape(steps, -1), axis=1)
    # another norm and another direction: only the growth between two late times is compared, to a factor 2
    assert abs(np.log(sizes[-1] / sizes[500]) - (growth[-1] - growth[500])) < np.log(2.0)


def test_one_step_has_no_exponent() -> None:
    model, s = dj.build("conical-pendulum")
    with pytest.raises(ValueError, match="steps: 1; allowed: 2 or more"):
        lyapunov(model, s, dj.make_stepper(model), 0.01, 1)


def test_the_same_call_gives_the_same_numbers() -> None:
    model, s = dj.build("double-pendulum-chaotic")
    stepper = dj.make_stepper(model).plain
    once, again = (lyapunov(model, s, stepper, 0.002, 1500).growth for _ in range(2))
    assert np.array_equal(once, again)
