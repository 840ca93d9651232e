"""Windows that follow the motion: a small dropper that is lifted and released."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hard_scenes import single_line

from dropper_jax import load_scene, simulate
from dropper_jax.run.summary import write_angles
from fitting import Camera, fit, observe, prepare, read_trace, simulate_truth
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.windows import Starts, fill
from fitting.windows.lost_windows import lost_windows
from fitting.windows.method import estimate
from fitting.windows.recover_windows import recover_windows
from fitting.windows.sound_windows import with_sound_windows

pytestmark = [pytest.mark.usefixtures("optimised"), pytest.mark.check]
NAMES = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
TRUTH, NOISE, RATE = np.array([0.0015, 0.001]), 0.004, 100.0


def rig(mass=0.02, **fit):
    effects = {"weight": {}, "linear_damping": {"b_l": TRUTH[0]}, "quadratic_damping": {"b_q": TRUTH[1]}}
    start = {"kind": "static", "release_nodes": [1], "release_force": [[0, 0, 0.7]]}
    table = single_line([0.06] * 4, mass, start, [0.12, 0.0, 0.0], effects, dt=0.002, duration=3.0)
    return load_scene(table | ({"fit": fit} if fit else {}))


@pytest.fixture(scope="module")
def trace():
    motion = simulate_truth(rig(), 3.0, RATE, 40, "rattle_4")
    return observe(motion, Camera(rate=RATE, angle_noise=NOISE), 3, "whip")


@pytest.fixture(scope="module")
def prepared(trace):
    return prepare([trace], rig(), start=dict(zip(NAMES, 5 * TRUTH, strict=True)))


def fit_by(simulator, traces, scene, start):
    """The fit of both coefficients from this start, by a compiled simulator of the scene; None: by its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fitting.calibration.fit.prepare", partial(prepare, simulator=simulator))
        return fit(traces, scene, NAMES, start=dict(zip(NAMES, start, strict=True)))


@pytest.fixture(scope="module")
def result(trace, prepared):
    return fit_by(prepared.simulator, [trace], rig(), 5 * TRUTH)


def test_the_fit_of_a_lifted_dropper_finds_its_damping(result):
    assert result.status == "ok"
    assert np.all(np.abs(result.values - TRUTH) < 3.5 * result.uncertainty.std_error)
    assert 0.93 < result.rms / NOISE < 1.05


def test_windows_are_short_where_errors_grow_and_leave_no_sample_out(prepared, trace):
    windows = prepared.windows
    assert windows.length > 2 * windows.lengths.min()
    assert windows.samples >= 0.98 * trace.theta.size
    np.testing.assert_allclose(windows.ends[:-1], windows.begin[1:], atol=1e-9)


def test_a_window_that_ends_early_is_the_one_that_is_cut_there(prepared, trace):
    windows = prepared.windows
    k = int(np.argmax(windows.lengths))
    early = windows.end_early(k, trace.t[np.searchsorted(trace.t, windows.begin[k] - 1e-9) + 7])
    cut = fill(prepared.traces, [early.piece(k)], windows.dt, prepared.sigma)
    np.testing.assert_array_equal(early.weight[k], np.pad(cut.weight[0], ((0, early.weight.shape[1] - 7), (0, 0))))
    assert early.samples == windows.samples - (windows.weight[k, 7:] > 0).sum()


def test_the_best_determined_combination_is_surer_than_linear_damping_alone(result):
    best = result.to_json()["best_determined"]
    assert best["std_error"] < 0.5 * result.uncertainty.std_error[0]
    value = TRUTH[0] + best["speed_m_per_s"] * TRUTH[1]
    assert abs(best["value"] - value) < 3.5 * best["std_error"]


def test_no_combination_is_best_determined_at_a_speed_at_which_nothing_moves(result):
    """A covariance that would put it at -3190 or 3190 m/s; the nodes of the dropper move at some metres per second."""
    assert 0.1 < result.fastest < 100.0
    for speed in (-3190.0, 3190.0):
        covariance = np.array([[2.0 * speed**2, -speed], [-speed, 1.0]])
        uncertainty = replace(result.uncertainty, covariance=covariance)
        assert replace(result, uncertainty=uncertainty).best_combination is None


def test_windows_of_unlike_lengths_run_together_as_each_alone(prepared):
    values, starts, windows = prepared.values, prepared.starts, prepared.windows
    together = prepared.simulator(values, starts, windows)
    for k in (int(np.argmin(windows.step_counts)), int(np.argmax(windows.step_counts))):
        which = np.arange(windows.count) == k
        alone = prepared.simulator(values, Starts(*(part[which] for part in starts)), windows.pick(which))
        for one, whole in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], whole[k], rtol=1e-9, atol=1e-9 * np.abs(whole[k]).max(initial=1.0))


def test_a_view_of_starts_has_their_derivatives_and_none_by_parameters(prepared):
    values, starts, windows = prepared.values, prepared.starts, prepared.windows
    whole = prepared.simulator(values, starts, windows)
    found = prepared.simulator.view_of_starts()(values, starts, windows)
    m2 = prepared.simulator.freedoms
    np.testing.assert_allclose(found.residual, whole.residual, rtol=1e-9, atol=1e-9)
    assert found.jacobian.shape == whole.jacobian.shape
    np.testing.assert_allclose(found.jacobian[..., :m2], whole.jacobian[..., :m2], rtol=1e-9, atol=1e-9)
    assert not found.jacobian[..., m2:].any()
    assert whole.jacobian[..., m2:].any()


@pytest.fixture(scope="module")
def sound(prepared):
    return with_sound_windows(prepared)


@pytest.fixture(scope="module")
def solution(sound):
    return estimate(sound, "windows")


def test_a_single_outlier_makes_no_window_lost(solution):
    """Of every fourth window one sample is half a radian off."""
    residual = solution.evaluation.residual.copy()
    slot, link = np.argwhere((solution.windows.weight > 0).all(axis=0))[-1]
    residual[::4, slot, link] += 0.5 / NOISE
    spoiled = replace(solution, evaluation=solution.evaluation._replace(residual=residual))
    assert not lost_windows(spoiled).any()


def test_windows_on_a_wrong_branch_are_found_and_start_again(sound, solution):
    assert not lost_windows(solution).any()
    turned = Starts(*(part.copy() for part in solution.starts))
    turned.theta[[3, 7]] += np.array([2.0, -2.0, 2.0, -2.0])
    turned.omega[[3, 7]] *= -1
    evaluation = solution.problem.evaluate(solution.values, turned)
    wrong = replace(solution, starts=turned, evaluation=evaluation)
    assert set(np.flatnonzero(lost_windows(wrong))) == {3, 7}
    again = lambda problem, point: fit_windows(problem, point.values, point.starts)  # noqa: E731
    _, found = recover_windows(sound, wrong, again)
    assert found.status == "ok"
    assert not lost_windows(found).any()
    assert found.windows.samples == solution.windows.samples
    np.testing.assert_allclose(found.values, solution.values, atol=0.05 * np.abs(solution.values).max())


@pytest.fixture(scope="module")
def swapped(trace):
    """The trace with 0.3 s in which two links were mistaken for each other."""
    theta, wrong = trace.theta.copy(), (trace.t >= 1.6) & (trace.t < 1.9)
    theta[wrong] = theta[wrong][:, [1, 0, 3, 2]]
    return replace(trace, theta=theta)


def test_a_stretch_that_no_start_explains_is_left_out_and_listed(swapped, prepared):
    result = fit_by(prepared.simulator, [swapped], rig(), 2 * TRUTH)
    table = result.to_json()
    assert result.status == "lost_windows"
    assert "samples lie in windows that no start explains" in table["error"]
    assert all(row["to_s"] > 1.5 and row["from_s"] < 2.0 for row in table["left_out"])
    assert any("left out: whip" in line for line in result.warnings)
    assert np.all(np.abs(result.values - TRUTH) < 4 * result.uncertainty.std_error)


def test_a_model_that_misses_its_trace_is_no_ok_until_its_error_is_stated(trace):
    heavy = {"mass": [0.02, 0.02, 0.025, 0.02]}
    missed = fit_by(None, [trace], rig(**heavy), TRUTH)
    assert missed.status in ("misfit", "lost_windows")
    assert missed.chi2_per_dof > 2
    simulator = missed.solution.problem.simulator
    stated = fit_by(simulator, [trace], rig(**heavy, model_error=float(missed.rms)), TRUTH)
    assert stated.status == "ok"
    assert stated.chi2_per_dof < 2


def test_angles_of_a_run_are_explained_up_to_the_error_of_its_step(tmp_path, prepared):
    path = write_angles(simulate(rig(), save_every=5, companion="coarser"), tmp_path / "angles.csv")
    result = fit_by(prepared.simulator, [path], rig(), 2 * TRUTH)
    assert result.status == "ok"
    assert result.chi2_per_dof > 0.1
    assert np.all(np.abs(result.values - TRUTH) < 3 * result.uncertainty.std_error)
    assert abs(result.values[0] - TRUTH[0]) < 0.05 * TRUTH[0]
    assert any("model error as stated by the traces" in line for line in result.warnings)
    unstated = fit_by(prepared.simulator, [replace(read_trace(path), model_error=0.0)], rig(), 2 * TRUTH)
    assert unstated.status == "misfit"
    assert "model_error" in unstated.message


def test_the_speeds_of_links_that_are_seen_every_second_frame_are_known(result, trace):
    odd = np.add.outer(np.arange(len(trace.t)), np.arange(trace.links)) % 2 == 1
    seldom = replace(result, traces=[replace(trace, theta=np.where(odd, np.nan, trace.theta))])
    assert seldom.fastest == pytest.approx(result.fastest, rel=0.4)
