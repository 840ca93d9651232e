"""Ropes: what their law promises at an instant and over a step; a mass dropped on one, against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax import make_stepper
from dropper_jax.axial import Elastic, LinkStart, Rope
from dropper_jax.base.springs import limit_damper, mean_positive_part, unresolved_force

EA, BA = 2e4, 300.0
LENGTH = jnp.ones(1)
G = 9.81


def rope(damping=BA):
    return Rope(EA=jnp.array([EA]), damping=None if damping is None else jnp.array([damping]))


def along(x):
    return jnp.array([[0.0, 0.0, x]])


@pytest.mark.parametrize("speed", [-30.0, -1.0, -0.01, 0.0, 0.01, 1.0, 30.0])
def test_the_tension_is_continuous_never_negative_and_the_damper_only_takes(speed):
    strain = np.concatenate([np.linspace(-0.01, 0.01, 2001), np.linspace(0.0105, 0.2, 400)])
    pull = jax.vmap(lambda e: rope().tension(along(1.0 + e), along(speed), LENGTH)[0])(jnp.asarray(strain))
    pull = np.asarray(pull)
    assert np.all(pull >= 0.0)
    assert np.all(pull[strain < -1e-12] == 0.0)
    # a jump would not shrink with the distance of neighbours
    assert np.max(np.abs(np.diff(pull)) / np.diff(strain)) < 2.1 * EA
    assert np.all((pull - EA * np.maximum(strain, 0.0)) * speed >= 0.0)


def test_a_taut_rope_that_vibrates_gently_has_the_damping_of_a_spring():
    spring = Elastic(EA=jnp.array([EA]), damping=jnp.array([BA]))
    for speed in (-0.5, 0.5):
        given = along(1.02), along(speed), LENGTH
        np.testing.assert_allclose(rope().tension(*given), spring.tension(*given), rtol=1e-12)


@jax.jit
def over(law, start, d1, length, h):
    """Tensions over a step: the roots of its rows."""

    def halve(_, bounds):
        low, high = bounds
        middle = 0.5 * (low + high)
        more = law.residual(start, d1, middle, length, h) > 0.0
        return jnp.where(more, middle, low), jnp.where(more, high, middle)

    return jax.lax.fori_loop(0, 80, halve, (jnp.full_like(length, -1.0), jnp.full_like(length, 1e5)))[0]


@pytest.mark.parametrize("damping", [None, BA, 3e4])
@pytest.mark.parametrize("h", [1e-4, 1e-2])
def test_over_a_step_it_never_pushes_its_damper_never_gives_energy_and_all_of_it_is_booked(damping, h):
    rng, length = np.random.default_rng(3), jnp.ones(64)
    e0, e1 = rng.uniform(-0.02, 0.03, (2, 64))
    law = Rope(EA=jnp.full(64, EA), damping=None if damping is None else jnp.full(64, damping))
    rate, acceleration = (jnp.asarray(rng.uniform(-size, size, (64, 3))) for size in (5.0, 500.0))
    start = LinkStart(jnp.zeros((64, 3)).at[:, 2].set(1.0 + e0), rate, acceleration, jnp.full(64, 0.1))
    d1 = jnp.zeros((64, 3)).at[:, 2].set(1.0 + e1)
    tension = np.asarray(over(law, start, d1, length, h))
    assert np.all(tension > -1e-6)
    stored = 0.5 * EA * (np.maximum(e1, 0.0) ** 2 - np.maximum(e0, 0.0) ** 2)
    taken = stored - tension * (e1 - e0)
    works = {name: float(work) for name, work in law.works(start, d1, length, h).items()}
    assert works.get("internal_damping", 0.0) <= 0.0
    assert np.sum(taken) == pytest.approx(sum(works.values()), abs=1e-5)


def test_springs_over_a_step():
    # the integral of max(e, 0) over the way
    means = mean_positive_part(jnp.array([2.0, -1.0, -1.0]), jnp.array([4.0, -2.0, 3.0]))
    np.testing.assert_allclose(means, [3.0, 0.0, 9.0 / 2 / 4], rtol=1e-15)
    # slower than expected, ahead of it, at most the pull at the end
    before, after = jnp.array([1.0, 1.0, 1.0, 2.0]), jnp.array([2.0, 2.0, 2.0, 1.0])
    np.testing.assert_array_equal(
        unresolved_force(before, after, jnp.array([2.5, 1.5, -9.0, 9.0])), [0.0, 0.125, 0.5, -0.5]
    )
    np.testing.assert_array_equal(limit_damper(jnp.array([-9.0, 1.0, 9.0]), jnp.full(3, 2.0)), [-2.0, 1.0, 2.0])


def test_a_spring_at_rest_has_the_derivative_of_the_motion_that_follows():
    # any motion from rest is ahead of what was expected: half of its half; rounding must not choose
    for off in (-1e-9, 0.0, 1e-9):
        slope = jax.grad(lambda after, off=off: unresolved_force(jnp.array(2e3), after, jnp.array(2e3 + off), 1e-6))(
            jnp.array(2e3)
        )
        assert float(slope) == 0.25


@pytest.mark.parametrize("expected", [-3e-10, 0.0, 2e-10, 8e-10])
def test_the_lag_of_a_slow_spring_has_no_jump_that_a_step_cannot_solve(expected):
    """Mean force and lag rise with the stretch, by steps that shrink with it, also where rest becomes motion."""
    after = jnp.linspace(-8e-10, 8e-10, 20001)
    force = 0.5 * after + unresolved_force(jnp.zeros(()), after, jnp.array(expected), 1e-10)
    rise = jnp.diff(force) / (after[1] - after[0])
    assert float(jnp.min(rise)) >= 0.0
    assert float(jnp.max(rise)) < 3.0


def test_a_link_at_its_natural_length_has_the_derivatives_of_a_taut_one():
    """Not the mean of the derivatives of a taut and a slack link, which is that of no motion."""
    law, one = Rope(EA=jnp.full(1, EA)), jnp.ones(1)
    assert float(jax.grad(lambda size: law.spring(size, one)[0])(one)[0]) == EA
    both = jax.grad(mean_positive_part, argnums=(0, 1))
    for ends in ((0.0, 2.0), (2.0, 0.0)):
        assert both(*map(jnp.array, ends)) == (0.5, 0.5)


@pytest.mark.check
@pytest.mark.parametrize("law", ["elastic", "rope"])
def test_a_step_from_rest_has_exact_derivatives_by_stiffness_in_both_modes(law, slopes_of, one_line):
    kind = {"mass": 4.0, "diameter": 0.05, "EA": 8e4, "damping_ratio": 0.1, "law": law}
    model, start = dj.build(one_line(10.0, 4, [0.0, 0.0, 0.0], [8.0, 0.0, 0.0], kind, {"weight": {}}))
    stepper = make_stepper(model, halvings=0)
    leaves, tree = jax.tree_util.tree_flatten_with_path(model)
    stiff = ["EA" in jax.tree_util.keystr(path) for path, _ in leaves]
    assert sum(stiff) == 1

    def sunk(factor):
        scaled = (x * factor if hit else x for hit, (_, x) in zip(stiff, leaves, strict=True))
        last, _ = dj.integrate(stepper, jax.tree.unflatten(tree, list(scaled)), start, 0.02, 1)
        return jnp.sum(last.v[:, 2])

    slopes_of(sunk, 1.0)


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_a_dropped_mass_meets_its_peak_and_comes_back_up_within_two_per_cent(falling, dt):
    stiffness = 100.0 * (2 * np.pi / 0.2) ** 2

    def fall(t, y):
        return [y[1], -G + stiffness / 100.0 * max(-2.0 - y[0], 0.0)]

    exact = solve_ivp(fall, (0.0, 0.6), [-1.8, 0.0], rtol=1e-10, atol=1e-12, max_step=1e-3)
    run = dj.simulate(falling(0.2, dt), duration=0.6)
    assert run.status == "ok"
    lowest = np.argmin(exact.y[0])
    peak = stiffness * (-2.0 - exact.y[0][lowest])
    # tensions are means over a step: as high as the top of a wave cut off at half a step
    assert run.tension.max() == pytest.approx(peak, rel=0.02)
    assert run.positions[:, 1, 2].min() == pytest.approx(exact.y[0][lowest], rel=0.02)
    back = run.positions[int(0.3 / dt) :, 1, 2].max()
    assert back == pytest.approx(-1.8, abs=0.02 * 0.2)
    assert run.energy_drift < 1e-10 * run.energy_scale
