"""Calibration of dry friction: a set-valued law in the fit's simulator. Truth: SciPy on the pendulum's own equation."""

import numpy as np
import pytest
from hard_scenes import rods
from scipy.integrate import solve_ivp

from fitting import Convention, FitSettings, Trace, prepare
from fitting.calibration.fit import estimate
from fitting.calibration.summarise import summarise
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.windows import Starts

LENGTH, MASS, G = 0.5, 0.4, 9.81
B_L, DRY = 0.02, 5e-3
RATE, DURATION, NOISE = 60.0, 12.0, 0.003
FREE = ["effects.linear_damping.b_l", "effects.joint_friction.dry"]
TRUTH = np.array([B_L, DRY])
EFFECTS = {"linear_damping": {"b_l": B_L}, "joint_friction": {"dry": DRY, "axis": [0.0, 1.0, 0.0]}}
SCENE = rods([1.3], LENGTH, MASS, EFFECTS) | {"run": {"dt": 0.01, "duration": DURATION}}


@pytest.fixture(scope="module")
def ready():
    """m L^2 a'' = -m g L sin a - b_l L^2 a' - tau sign a', half swing by half swing."""
    t = np.arange(0.0, DURATION, 1 / RATE)
    angle, now, y, way = np.zeros_like(t), 0.0, np.array([1.3, 0.0]), -1.0

    def rate(_, y):
        torque = MASS * G * LENGTH * np.sin(y[0]) + B_L * LENGTH**2 * y[1] + DRY * way
        return [y[1], -torque / (MASS * LENGTH**2)]

    def turns(time, y):
        return y[1] if time > now + 1e-6 else way

    turns.terminal = True
    while now < DURATION:
        part = solve_ivp(rate, (now, DURATION), y, events=turns, dense_output=True, rtol=1e-10, atol=1e-12)
        inside = (t >= now) & (t <= part.t[-1])
        angle[inside] = part.sol(t[inside])[0]
        now, y, way = part.t[-1], np.array([part.y[0, -1], 0.0]), -way
    seen = angle + NOISE * np.random.default_rng(0).standard_normal(len(t))
    trace = Trace("swing", t, seen[:, None], convention=Convention("down", 1, "rad"))
    start = {FREE[0]: 0.1, FREE[1]: 5e-4}
    return prepare(trace, SCENE, FREE, start=start, settings=FitSettings(window=DURATION))


@pytest.mark.check
def test_dry_friction_and_linear_damping_are_distinguished(ready):
    result = summarise(ready, "windows", estimate(ready, "windows"))
    assert result.status == "ok"
    assert result.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    assert np.all(result.uncertainty.std_error < 0.1 * TRUTH)
    assert np.all(np.abs(result.values - TRUTH) < 3 * result.uncertainty.std_error)


@pytest.mark.check
def test_the_derivative_of_windows_in_which_the_joint_turns_round_is_that_of_differences(ready):
    simulator = ready.simulator
    at = simulator(TRUTH, ready.starts, ready.windows)
    assert not at.failed.any()
    for i, step in enumerate(1e-5 * TRUTH):
        ends = [simulator(TRUTH + s * step * np.eye(2)[i], ready.starts, ready.windows).residual for s in (1, -1)]
        exact = at.jacobian[..., simulator.freedoms + i]
        np.testing.assert_allclose(exact, (ends[0] - ends[1]) / (2 * step), atol=1e-4 * np.abs(exact).max())


@pytest.mark.check
def test_starts_that_are_far_off_are_found_though_all_parameters_are_held(ready):
    """Steps that are too long do not count as a rough cost, however little the held parameters move."""
    held = np.ones(2, bool)
    near = fit_windows(ready.problem(frozen=held), TRUTH, ready.starts)
    for angle, rate in ((0.3, 0.0), (0.0, 2.0)):
        off = Starts(ready.starts.theta + angle, ready.starts.omega + rate)
        far = fit_windows(ready.problem(frozen=held), TRUTH, off)
        assert far.status == "ok"
        assert far.cost == pytest.approx(near.cost, rel=1e-3)
        assert near.cost == pytest.approx(0.5 * ready.windows.samples, rel=0.15)
