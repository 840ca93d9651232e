"""Synthetic data: the estimators find the truth, and their errors cover it.

The truth is integrated by another scheme at a 20 times finer step; fits start ten times off. The full statistics
(20 and 60 noise seeds) are in docs/checked-against.md.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hard_scenes import rods
from scipy.optimize import least_squares

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import Camera, FitSettings, Huber, observe, prepare, simulate_truth
from fitting.calibration.fit import estimate
from fitting.calibration.summarise import summarise
from fitting.estimate import shooting
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.normal_equations import bounded_step
from fitting.estimate.shooting import fit_shooting, loosest, solve_to_end
from fitting.estimate.windows import Starts
from fitting.traces import planar

SCENE = "dropper-release-a"
FREE = ["effects.linear_damping.b_l", "effects.quadratic_damping.b_q"]
TRUTH = np.array([0.002, 0.001])
FAR = dict.fromkeys(FREE, 0.02)
SECOND = FitSettings(window=1.0)


@pytest.fixture(scope="module")
def motion():
    return simulate_truth(SCENE, 24.0)


@pytest.fixture(scope="module")
def prepared(motion):
    """A fit from ten times off."""
    return prepare(observe(motion, Camera(angle_noise=0.005), 0), SCENE, FREE, start=FAR, settings=SECOND)


@pytest.fixture(scope="module")
def separate(prepared):
    """Its estimate from separate windows."""
    return estimate(prepared, "windows")


@pytest.mark.check
def test_windows_by_a_scheme_that_holds_its_own_error_give_the_same_estimates(motion, prepared, separate):
    trace = observe(motion, Camera(angle_noise=0.005), 0)
    other = prepare(trace, SCENE, FREE, start=FAR, settings=FitSettings(window=1.0, integrator="tsit5"))
    held = estimate(other, "windows")
    assert held.status == "ok"
    error = summarise(prepared, "windows", separate).uncertainty.std_error
    assert np.all(np.abs(held.values - separate.values) < 0.05 * error)


@pytest.mark.check
def test_joining_the_windows_makes_the_errors_several_times_smaller(prepared, separate):
    apart = summarise(prepared, "windows", separate)
    assert apart.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    assert np.all(np.abs(apart.values - TRUTH) < 4 * apart.uncertainty.std_error)
    joined = summarise(prepared, "shooting", estimate(prepared, "shooting"))
    assert joined.status == "ok"
    assert np.all(joined.uncertainty.std_error < apart.uncertainty.std_error / 5)
    assert np.all(np.abs(joined.values - TRUTH) < 4 * joined.uncertainty.std_error)


@pytest.mark.check
def test_scipy_least_squares_with_our_jacobian_finds_the_same_optimum(prepared, separate):
    """Fewer windows, all unknowns in one dense vector, trust region of SciPy."""
    few = prepared.windows.pick(np.arange(8))
    starts = Starts(*(part[:8] for part in separate.starts))
    simulator, m2 = prepared.simulator, prepared.simulator.freedoms
    bases = planar.chart(simulator.model_at(separate.values), starts.theta)
    scale = np.array([1e-3, 1e-3])

    def evaluate(x):
        z = x[2:].reshape(8, 2, m2 // 2)
        at = Starts(
            starts.theta + np.einsum("kij,kj->ki", bases, z[:, 0]),
            starts.omega + np.einsum("kij,kj->ki", bases, z[:, 1]),
        )
        return simulator(x[:2] * scale, at, few)

    def residual(x):
        return evaluate(x).residual.ravel()

    def jacobian(x):
        """By the chart at the moved start, turned to the chart at the first one (equal to first order in the move)."""
        found = evaluate(x)
        rows = found.jacobian.reshape(8, -1, m2 + 2)
        moved = planar.chart(simulator.model_at(x[:2] * scale), found.starts.theta)
        turn = np.einsum("kij,kil->kjl", moved, bases)
        full = np.zeros((8, rows.shape[1], 2 + 8 * m2))
        for k in range(8):
            both = np.kron(np.eye(2), turn[k])
            full[k, :, 2 + k * m2 : 2 + (k + 1) * m2] = rows[k, :, :m2] @ both
        full[:, :, :2] = rows[:, :, m2:] * scale
        return full.reshape(-1, 2 + 8 * m2)

    x0 = np.concatenate([separate.values / scale, np.zeros(8 * m2)])
    theirs = least_squares(residual, x0, jacobian, method="trf", x_scale="jac", max_nfev=30)
    ours = fit_windows(replace(prepared.problem(), windows=few), separate.values, starts)
    errors = np.sqrt(np.diag(np.linalg.inv(ours.information)))
    assert np.all(np.abs(theirs.x[:2] * scale - ours.values) < 0.02 * errors)
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-5)


@pytest.mark.check
def test_window_jacobian_agrees_with_central_differences(prepared):
    few = prepared.windows.pick(np.arange(4))
    starts = Starts(prepared.starts.theta[:4], prepared.starts.omega[:4])
    at = prepared.simulator(TRUTH, starts, few)
    for i in range(2):
        step = np.zeros(2)
        step[i] = 1e-6
        ahead, behind = (prepared.simulator(TRUTH + s * step, starts, few) for s in (1, -1))
        slope = (ahead.residual - behind.residual) / 2e-6
        exact = at.jacobian[..., prepared.simulator.freedoms + i]
        np.testing.assert_allclose(exact, slope, atol=1e-5 * np.abs(exact).max())


@pytest.mark.check
def test_a_damping_of_zero_is_reached_and_reported(prepared):
    """The truth has linear damping alone; noise pushes the quadratic coefficient against its bound."""
    truth = simulate_truth(dj.load_scene(SCENE).with_values({FREE[0]: 0.004, FREE[1]: 0.0}), 8.0)
    results = []
    for seed in range(3):
        trace = observe(truth, Camera(angle_noise=0.005), seed)
        other = prepare(trace, SCENE, FREE, settings=SECOND, simulator=prepared.simulator)
        results.append(summarise(other, "windows", estimate(other, "windows")))
    assert all(r.values[1] >= 0 for r in results)
    for r in results:
        assert r.uncertainty.at_bound[1] == (r.values[1] == 0)
        assert r.uncertainty.low[1] == 0 or r.values[1] > 0
        assert any("bound" in w for w in r.warnings) == bool(r.uncertainty.at_bound.any())
    assert any(r.uncertainty.at_bound[1] for r in results)


@pytest.mark.check
def test_huber_resists_outliers(motion, prepared):
    trace = observe(motion, Camera(angle_noise=0.005, outliers=0.02, missing=0.05), 7)
    other = prepare(trace, SCENE, FREE, settings=SECOND, simulator=prepared.simulator)
    plain = estimate(other, "shooting")
    robust = estimate(other, "shooting", Huber(2.0))
    assert robust.status == "ok"
    assert np.abs(robust.values[0] - TRUTH[0]) < 0.02 * TRUTH[0]
    assert np.abs(robust.values - TRUTH).max() <= np.abs(plain.values - TRUTH).max()


@pytest.mark.parametrize("option", ["window", "dt"])
@pytest.mark.parametrize("length", [0.0, -1.0, np.nan, np.inf])
def test_a_window_or_a_step_that_is_not_positive_and_finite_is_refused(option, length):
    with pytest.raises(SceneError, match=f"{option}: {length} is .*; allowed: > 0 s"):
        FitSettings(**{option: length})


def test_the_bounded_step_solves_its_quadratic_problem():
    rng = np.random.default_rng(0)
    for _ in range(20):
        root = rng.standard_normal((4, 4))
        square, slope = root @ root.T + 0.1 * np.eye(4), rng.standard_normal(4)
        low, high = -rng.random(4), rng.random(4)
        step = bounded_step(square, slope, low, high)
        rest = slope + square @ step
        inside = (step > low + 1e-9) & (step < high - 1e-9)
        assert np.all(np.abs(rest[inside]) < 1e-7)
        assert np.all(rest[step <= low + 1e-9] >= -1e-7)
        assert np.all(rest[step >= high - 1e-9] <= 1e-7)


def test_a_parameter_that_does_nothing_is_named():
    """A camera that looks along y does not see where the pivot is in depth."""
    pendulum = rods([np.pi / 2])
    trace = observe(simulate_truth(pendulum, 4.0), Camera(angle_noise=0.005), 0)
    with pytest.raises(SceneError, match="'point.0.position.1' does not affect"):
        prepare(trace, pendulum, ["point.0.position.1"])


def test_of_gap_weights_of_equal_evidence_the_loosest_is_taken():
    found = [SimpleNamespace(evidence=e) for e in (-9.0, -3.15, -3.1, -3.0)]
    assert loosest(found) is found[1]
    assert loosest(found[:1]) is found[0]


@pytest.mark.check
def test_the_gap_weight_of_the_linear_model_is_that_of_a_descent_through_all_weights(prepared, separate, monkeypatch):
    at_once = fit_shooting(separate)
    monkeypatch.setattr(shooting, "follow_linear_model", lambda *_: None)
    stepwise = fit_shooting(separate)
    assert at_once.gap_weight == stepwise.gap_weight
    assert at_once.evidence == pytest.approx(stepwise.evidence, abs=0.5)
    assert at_once.iterations - separate.iterations < 0.5 * (stepwise.iterations - separate.iterations)
    ends = [solve_to_end(point) for point in (at_once, stepwise)]
    error = summarise(prepared, "shooting", ends[1]).uncertainty.std_error
    assert np.all(np.abs(ends[0].values - ends[1].values) < 0.01 * error)
