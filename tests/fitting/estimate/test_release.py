"""Runs that the model itself begins: the static pose, let go at an unknown instant by a force that is not known well.

Truth: the scene's own static pose and run at a 20 times finer step, by another integrator where there is one.
"""

from dataclasses import replace

import numpy as np
import pytest
from hard_scenes import single_line

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import Camera, FitSettings, Trace, observe, prepare, simulate_truth
from fitting.calibration.comparison import compare_laws
from fitting.calibration.fit import estimate
from fitting.calibration.summarise import summarise
from fitting.laws.cross_validation import blocks, with_released_fitted

#: Two links, the lower one held aside by a force at the free end.
START = {"kind": "static", "release_nodes": [2], "release_force": [[1.6, 0.0, 0.0]]}
EFFECTS = {"weight": {}, "linear_damping": {"b_l": 0.02}}
SCENE = single_line([0.3, 0.3], [0.1, 0.2], START, effects=EFFECTS, duration=8.0)
FREE = ["b_l", "line.0.mass.0", "release.time", "release.force"]
NAMES = ("effects.linear_damping.b_l", "line.0.mass.0", "release.time.0", "release.force.0.2.x")
RATE, RESTING, NOISE = 60.0, 6, 0.003
TRUTH = np.array([0.02, 0.1, RESTING / RATE - 0.0041, 1.6])


@pytest.fixture(scope="module")
def motion():
    return simulate_truth(SCENE, 8.0, RATE)


def seen(motion, seed):
    """The camera runs before the release, and its clock is off the frames by 4.1 ms."""
    run = observe(motion, Camera(rate=RATE), 0)
    theta = np.concatenate([np.repeat(run.theta[:1], RESTING, axis=0), run.theta])
    theta = theta + NOISE * np.random.default_rng(seed).standard_normal(theta.shape)
    t = np.arange(len(theta)) / RATE
    return Trace("released", np.concatenate([t[:RESTING], t[RESTING:] - 0.0041]), theta, convention=run.convention)


@pytest.fixture(scope="module")
def ready(motion):
    far = {NAMES[0]: 0.1, NAMES[1]: 0.12, NAMES[3]: 1.4}
    return prepare(seen(motion, 0), SCENE, FREE, start=far)


@pytest.mark.check
def test_release_time_force_and_damping_are_found_from_far_off(ready):
    for method in ("windows", "shooting"):
        result = summarise(ready, method, estimate(ready, method))
        assert [p.name for p in result.parameters] == list(NAMES)
        assert result.status == "ok"
        assert result.chi2_per_dof == pytest.approx(1.0, abs=0.15)
        z = (result.values - TRUTH) / result.uncertainty.std_error
        assert np.abs(z).max() < 3.5
        assert result.uncertainty.std_error[2] < 0.005  # a third of a frame
    assert result["release.time.0"] == pytest.approx(TRUTH[2], abs=1e-3)


@pytest.mark.check
def test_the_derivative_by_force_mass_and_release_is_that_of_differences(ready):
    simulator, windows = ready.simulator, ready.windows
    at = simulator(TRUTH, ready.starts, windows)
    first = np.flatnonzero(windows.released)
    assert len(first) == 1
    assert not at.jacobian[first, ..., : simulator.freedoms].any()
    for i, step in enumerate((1e-6, 1e-6, 1e-6, 1e-5)):
        moved = [simulator(TRUTH + side * step * np.eye(4)[i], ready.starts, windows) for side in (1, -1)]
        for exact, ends in (
            (at.jacobian[first][..., simulator.freedoms + i], [m.residual[first] for m in moved]),
            (at.end_jacobian[first][..., simulator.freedoms + i], [m.end[first] for m in moved]),
        ):
            slope = (ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(exact, slope, atol=2e-6 * np.abs(exact).max())


@pytest.mark.check
def test_before_its_release_a_run_rests_in_the_scenes_static_pose(ready):
    at = ready.simulator(TRUTH, ready.starts, ready.windows)
    k = int(np.flatnonzero(ready.windows.released)[0])
    _, start = dj.build(SCENE)
    nodes = np.concatenate([np.zeros((1, 3)), np.asarray(start.r)])
    link = np.diff(nodes, axis=0)
    pose = np.arctan2(-link[:, 2], link[:, 0])
    before = ready.windows.times()[k] < TRUTH[2]
    resting = at.theta[k, before & (ready.windows.weight[k, :, 0] > 0)]
    assert len(resting) == RESTING
    np.testing.assert_allclose(resting, np.broadcast_to(pose, resting.shape), rtol=1e-9)


@pytest.mark.check
def test_a_known_release_needs_no_free_parameter(motion):
    """Let go at t = 0 from the scene's pose."""
    trace = observe(motion, Camera(rate=RATE, angle_noise=NOISE), 1)
    prepared = prepare(trace, SCENE, ["b_l"], start={NAMES[0]: 0.1}, settings=FitSettings(static_start=True))
    result = summarise(prepared, "windows", estimate(prepared, "windows"))
    assert result.windows.released.sum() == 1
    assert result.status == "ok"
    assert result.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    assert abs(result.values[0] - TRUTH[0]) < 3.5 * result.uncertainty.std_error[0]


@pytest.mark.check
def test_laws_are_compared_with_the_release_free_in_each(ready):
    """The law that made the trace wins, and finds the same release as the fit."""
    laws = compare_laws(ready, ("none", "linear"))
    assert [law.name for law in laws if law.chosen] == ["linear"]
    assert laws[0].rms > 1.5 * laws[1].rms
    assert [law.free for law in laws] == [3, 4]
    found = laws[1].values
    assert found["release.time.0"] == pytest.approx(TRUTH[2], abs=1e-3)
    assert found["release.force.0.2.x"] == pytest.approx(TRUTH[3], rel=5e-3)
    assert found[NAMES[0]] == pytest.approx(TRUTH[0], rel=0.1)


@pytest.mark.check
def test_the_laws_are_not_judged_on_windows_that_the_model_starts():
    """Two runs with four windows each."""
    released = np.arange(8) % 4 == 0
    folds = with_released_fitted(blocks(np.arange(8) // 4), released)
    assert all(not scored[released].any() and used[released].all() for scored, used in folds)
    assert np.all(sum(scored.astype(int) for scored, _ in folds) == ~released)


@pytest.mark.parametrize(
    ("change", "free", "late", "words"),
    [
        ({"start": {"kind": "static"}}, "release.time", 0.0, "static start: the scene releases no node"),
        ({"start": {"kind": "angles", "polar": [0.9, 0.5]}}, "release.force", 0.0, "the scene releases no node"),
        ({}, "release.speed", 0.0, "did you mean 'release.time'"),
        ({}, "release.time.3", 0.0, "does not exist in the scene"),
        pytest.param({}, "release.time", 9.0, "starts at 9 s; allowed", marks=pytest.mark.check),
    ],
)
def test_a_release_that_the_scene_or_the_trace_does_not_have_is_refused(motion, change, free, late, words):
    trace = seen(motion, 0)
    with pytest.raises(SceneError, match=words):
        prepare(replace(trace, t=trace.t + late), {**SCENE, **change}, ["b_l", free])
