"""Poses at rest: against balance of forces, differences, and the closed form of a pendulum with a dry joint."""

import numpy as np
import pytest
from scipy.optimize import fsolve

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import Trace
from fitting.estimate.noise import Noise
from fitting.estimate.rest import rests, static_pose
from fitting.estimate.simulator import Simulator
from fitting.parameters.paths import resolve
from fitting.windows.still_spans import advice_on_rest, still_spans

LENGTH, MASS, END = np.array([0.15, 0.14, 0.16, 0.15]), np.array([0.05, 0.06, 0.05, 0.05]), 0.38
NAMES = ["effects.linear_damping.b_l", "line.0.length", "point.1.position.0", "camera.offset", "marker.node.2.1"]


def hanging(length, end):
    """Angles of links at rest: masses between them in balance under weight and the links' pull, lengths kept."""

    def balance(x):
        p = np.concatenate([[[0, 0]], x[:6].reshape(3, 2), [[end, 0]]])
        d = np.diff(p, axis=0)
        pull = x[6:, None] * d
        force = pull[1:] - pull[:-1] + MASS[:3, None] * np.array([0, -9.81])
        return np.concatenate([force.ravel(), np.sum(d**2, axis=1) - length**2])

    guess = np.array([0.07, -0.13, 0.19, -0.2, 0.3, -0.13, 5, 5, 5, 5], float)
    x = fsolve(balance, guess, xtol=1e-13)
    assert np.abs(balance(x)).max() < 1e-10
    d = np.diff(np.concatenate([[[0, 0]], x[:6].reshape(3, 2), [[end, 0]]]), axis=0)
    return np.arctan2(-d[:, 1], d[:, 0])


@pytest.fixture(scope="module")
def simulator(chain):
    effects = {"weight": {}, "linear_damping": {"b_l": 0.01}}
    model, _ = dj.build(chain(LENGTH, MASS.tolist(), {"kind": "static"}, [END, 0.0, 0.0], effects))
    return Simulator(model, resolve(model, NAMES))


def test_the_pose_at_rest_is_that_of_forces_in_balance_and_moves_with_the_rig(simulator):
    values = np.array([0.01, *LENGTH, END, 0.02, 0.001])
    pose, slope = static_pose(simulator, values)
    turned = np.array([0, 0.001 / LENGTH[1], 0, 0])
    still = hanging(LENGTH, END)
    turned[2] = -0.001 * np.cos(still[2] - still[1]) / LENGTH[2]
    np.testing.assert_allclose(pose, still + 0.02 + turned, atol=3e-5)  # to first order in the marker
    np.testing.assert_array_equal(slope[:, 0], 0.0)
    np.testing.assert_allclose(slope[:, 6], 1.0)
    for i in range(1, 6):
        moved = [np.array([*LENGTH, END]) + side * 1e-6 * np.eye(5)[i - 1] for side in (1, -1)]
        difference = (hanging(moved[0][:4], moved[0][4]) - hanging(moved[1][:4], moved[1][4])) / 2e-6
        exact = static_pose(simulator, np.array([0.01, *LENGTH, END, 0.02, 0.0]))[1]
        np.testing.assert_allclose(exact[:, i], difference, atol=1e-5 * np.abs(difference).max())


def test_a_rest_weighs_its_mean_by_its_frames_and_what_the_noise_remembers(simulator):
    values, still = np.array([0.01, *LENGTH, END, 0.0, 0.0]), hanging(LENGTH, END)
    rng = np.random.default_rng(0)
    t = np.arange(100) / 50
    theta = still + 0.004 * rng.standard_normal((100, 4))
    theta[7, 2] += 0.5  # one frame is far off
    rest = rests([Trace("film", t, theta)], [np.full(4, 0.004)], [(0.0, 2.0)])
    prior = rest.with_noise(None, simulator, values).prior(simulator, values)
    assert prior.curvature[6, 6] == pytest.approx(4 * 100 / 0.004**2, rel=1e-9)
    assert prior.cost < 8  # half the chi-square of four means
    kept = Noise(np.full((1, 4), 2.0), np.full((1, 4), -50 * np.log(0.8)), np.zeros(1))
    less = rest.with_noise(kept, simulator, values).prior(simulator, values)
    assert less.cost / prior.cost == pytest.approx(0.2 / 1.8 / 4, rel=1e-9)
    moved = [rest.prior(simulator, values + side * 1e-6 * np.eye(8)[2]).cost for side in (1, -1)]
    assert prior.gradient[2] == pytest.approx((moved[0] - moved[1]) / 2e-6, rel=1e-4)
    theta[:, 0] += 0.3 * t
    with pytest.raises(SceneError, match=r"rest: 0:2 of film moves by .* Use a span in which the line is at rest"):
        rests([Trace("film", t, theta)], [np.full(4, 0.004)], [(0.0, 2.0)])
    with pytest.raises(SceneError, match="has 5 frames; allowed: at least 10"):
        rests([Trace("film", t, theta)], [np.full(4, 0.004)], [(0.0, 0.1)])


def test_a_dry_joint_leaves_a_pendulum_at_rest_anywhere_in_its_band(chain):
    """m g l theta = torque up to dry, uniform: deviation dry/(sqrt(3) m g l) of the angle."""
    effects = {"weight": {}, "joint_friction": {"dry": 2e-3, "axis": [0.0, 1.0, 0.0]}}
    start = {"kind": "angles", "zero": "down", "polar": [0.5]}
    model, _ = dj.build(chain([0.3], 0.1, start, None, effects))
    simulator = Simulator(model, resolve(model, ["effects.joint_friction.dry"]))
    theta = np.full((40, 1), np.pi / 2)
    rest = rests([Trace("film", np.arange(40) / 50, theta)], [np.array([1e-9])], [(0.0, 1.0)])
    found = rest.with_noise(None, simulator, np.array([2e-3])).precision[0, 0] ** -0.5
    assert found == pytest.approx(2e-3 / np.sqrt(3) / (0.1 * 9.81 * 0.3), rel=1e-6)


def test_a_trace_that_rests_before_and_after_is_recognised():
    """A pendulum held by its hook alone, pushed at 1.5 s and at rest again from 6 s on, in noise and with a gap."""
    t = np.arange(0, 8, 1 / 60)
    swing = np.where((t > 1.5) & (t < 6.0), 0.4 * np.sin(4 * (t - 1.5)) * np.sin(np.pi * (t - 1.5) / 4.5) ** 2, 0.0)
    theta = np.stack([0.3 + swing, -0.2 + 0.5 * swing], axis=1)
    theta += np.random.default_rng(0).normal(0, [0.004, 0.002], theta.shape)
    theta[20:24] = np.nan
    sigma = np.array([0.004, 0.002])
    (low, first), (second, high) = still_spans(Trace("swing", t, theta), sigma, 0.9)
    assert (low, high) == (t[0], t[-1])
    assert 1.3 < first < 1.9
    assert 5.6 < second < 6.2
    assert "--rest 0:" in advice_on_rest(Trace("swing", t, theta), sigma, 0.9)[0]
    moving = (t > 1.9) & (t < 5.5)
    assert still_spans(Trace("swing", t[moving], theta[moving]), sigma, 0.9) == []
