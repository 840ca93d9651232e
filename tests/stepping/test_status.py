"""Runs that fail: named status, what is kept, neighbours in a batch untouched; and runs that halving saves."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj

SCENE = "dropper-release-a"


@pytest.fixture(scope="module")
def lab():
    model, s = dj.build(SCENE)
    stepper = dj.make_stepper(model, halvings=2)
    run = jax.jit(lambda s, dt: dj.integrate(stepper, model, s, dt, 20)[1])
    return model, s, stepper, run


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"steps": 0}, "steps: 0 is not a number of steps; allowed: a whole number >= 1"),
        ({"steps": 2.5}, "steps: 2.5 is not a number of steps; allowed: a whole number >= 1"),
        ({"save_every": 0}, "save_every: 0 is not a number of steps"),
        ({"accuracy": 0.01, "most": 0}, "most: 0 is not a number of steps"),
        ({"dt": np.full(3, 0.005)}, r"dt: has the shape \(3,\); allowed: \(\) or \(4,\)"),
    ],
)
def test_numbers_and_lengths_of_steps_that_fit_no_run_are_refused(lab, given, reason):
    model, s, stepper, _ = lab
    with pytest.raises(ValueError, match=reason):
        dj.integrate(stepper, model, s, **{"dt": 0.005, "steps": 4, **given})


def test_a_state_that_is_not_a_number_is_reported_at_the_first_step(lab):
    _, s, _, run = lab
    result = run(replace(s, r=s.r.at[2, 1].set(jnp.nan)), 0.005)
    assert np.all(result.first_bad == 0)
    assert np.isnan(result.residual[0])


def test_a_start_that_no_links_can_reach_exhausts_the_retries_and_stays_finite(lab):
    """A node ten metres from a loop of 0.7 m."""
    _, s, stepper, run = lab
    result = run(replace(s, r=s.r.at[3, 2].set(-10.0)), 0.005)
    assert result.first_bad[0] == 0
    assert not result.residual[0] <= 1e-11
    assert np.sum(result.retried) == 1  # a dead run is not retried again
    assert stepper.halvings == 2


@pytest.mark.check
def test_one_bad_member_of_a_batch_leaves_the_others_as_they_are_to_the_bit(lab):
    _, s, _, run = lab
    speed = 0.1 * np.random.default_rng(0).normal(size=(3, *s.r.shape))
    batch = jax.tree.map(lambda a: jnp.broadcast_to(a, (3, *a.shape)), s)
    batch = replace(batch, v=jnp.asarray(speed))
    spoiled = replace(batch, r=batch.r.at[1, 0, 0].set(jnp.nan))
    many = jax.jit(jax.vmap(run, in_axes=(0, None)))
    good, mixed = many(batch, 0.005), many(spoiled, 0.005)
    assert np.all(good.first_bad == -1)
    assert np.all(mixed.first_bad == np.array([-1, 0, -1])[:, None])
    for member in (0, 2):
        for a, b in zip(jax.tree.leaves(good), jax.tree.leaves(mixed), strict=True):
            np.testing.assert_array_equal(a[member], b[member])


@pytest.mark.check
def test_a_member_that_needs_halving_moves_the_others_by_rounding_only(lab):
    """One member starts with wild speeds; the rest of the batch follows the path that it has alone."""
    _, s, _, run = lab
    wild = replace(s, v=30.0 * jnp.asarray(np.random.default_rng(1).normal(size=s.r.shape)))
    batch = jax.tree.map(lambda a, b: jnp.stack([a, b]), s, wild)
    many = jax.jit(jax.vmap(run, in_axes=(0, None)))(batch, 0.02)
    alone = run(s, 0.02)
    assert many.first_bad[0, -1] == alone.first_bad[-1] == -1
    assert np.sum(many.retried[1]) > 0
    np.testing.assert_allclose(many.r[0], alone.r, rtol=0, atol=1e-10)


def test_halving_saves_a_step_that_does_not_solve_as_a_whole_and_counts_it(lab):
    """A step far beyond the period of the shortest waves, begun in full motion; energy is still kept."""
    model, s, _, _ = lab
    easy = dj.make_stepper(model)
    moving = jax.jit(lambda s: dj.integrate(easy, model, s, 0.005, 60)[0])(s)
    whole = jax.jit(lambda h: dj.step(easy, model, moving, h)[1])
    halved = jax.jit(lambda h: dj.integrate(easy, model, moving, h, 1)[1])
    runs = [halved(h) for h in (0.05, 0.1, 0.15, 0.2) if not whole(h) <= 1e-11]
    saved = [run for run in runs if run.residual[0] <= 1e-11]
    assert saved
    run = saved[0]
    assert run.retried[0] == 1
    assert run.failed[0] == 0


def test_solution_of_a_failed_run_keeps_what_is_good_and_names_step_time_and_reason():
    """No retries and one iteration: the residual stays above the tolerance at once."""
    solution = dj.simulate(SCENE, dt=0.02, duration=0.4, iterations=1, halvings=0)
    assert solution.status == "not_converged"
    assert solution.first_bad["step"] == 1
    assert solution.first_bad["time_s"] == pytest.approx(0.02)
    assert solution.first_bad["residual"] > 1e-11
    assert len(solution.t) == len(solution.positions) == len(solution.tension) == 1
    assert np.all(np.isfinite(solution.positions))


def test_a_run_that_fails_in_the_middle_is_cut_before_the_failure_and_can_throw():
    """The thesis' weighting on the undamped release at a coarse step blows up (design, section 1)."""
    with pytest.raises(dj.SimulationError) as error:
        dj.simulate("dropper-release-a-undamped", integrator="theta", gamma=0.5, dt=0.0065, duration=6.5, throw=True)
    solution = error.value.solution
    assert solution.status in ("retry_exhausted", "not_converged", "non_finite")
    bad = solution.first_bad["step"]
    assert 1 < bad < 1000
    assert len(solution.t) == bad
    assert solution.t[-1] == pytest.approx((bad - 1) * 0.0065)
    assert np.all(np.isfinite(solution.positions))
    assert np.max(np.abs(solution.positions)) < 2.0


def test_explicit_schemes_report_infinity_as_non_finite(chain):
    start = {"kind": "positions", "positions": [[0, 0, 0.0], [0.1, 0, -0.1], [0.2, 0, 0.0]]}
    axial = {"law": "elastic", "EA": 1e6}
    scene = chain([0.15, 0.15], 0.01, start, right=[0.2, 0.0, 0.0], axial=axial)
    solution = dj.simulate(scene, integrator="rk4", dt=0.05, duration=5.0)
    assert solution.status == "non_finite"
    assert solution.failed_steps >= 1
    # 2/omega with omega = 2 sqrt(EA/(L m)): sqrt(0.15 * 0.01/1e6) = 3.9e-5 s
    assert solution.failure.endswith("rk4 is explicit; its stability limit with these lines is about 4e-05 s")


def test_links_that_drift_under_explicit_euler_stop_the_run():
    solution = dj.simulate("double-pendulum-chaotic", integrator="theta", gamma=0.0, dt=0.05, duration=20.0)
    assert solution.status != "ok"
    assert solution.max_closure_error < 0.11
