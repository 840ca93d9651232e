"""Fits of traces that another simulator made: Lagrange's equations of a chain of two rods, integrated by SciPy.

With angles phi from straight down, a_ij = L_j (j < i) or y_i (j = i) the lever of link j on link i's centre of mass,
and p_n the nodes:

    sum_k A_jk cos(phi_j - phi_k) phi_k'' = -sum_k A_jk sin(phi_j - phi_k) phi_k'^2 - g sin(phi_j) sum_i m_i a_ij + Q_j
    A_jk = sum_i m_i a_ij a_ik + I_j delta_jk
    Q_j = -c (w_j - w_{j-1}) + c (w_{j+1} - w_j) - b_q sum_{n >= j} |p_n'| p_n' . dp_n/dphi_j
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from fitting.calibration.advice import advise
from fitting.calibration.comparison import Law, compare, with_bic
from fitting.calibration.energy import energy_check, look_at_energy
from fitting.calibration.fit import estimate, fit, prepare, summarise
from fitting.estimate.gauss_newton import fit_windows
from fitting.estimate.gradient import Projected
from fitting.estimate.loss import StudentT
from fitting.estimate.profile import profile
from fitting.estimate.refinement import LARGEST_BIAS, step_bias
from fitting.estimate.shooting import joined_step
from fitting.estimate.simulator import trusted
from fitting.estimate.uncertainty import bootstrap, uncertainty
from fitting.traces.trace import Convention, Trace

LENGTH, MASS = np.array([0.3, 0.25]), np.array([0.12, 0.09])
CENTRE, INERTIA = np.array([0.2, 0.11]), np.array([7e-4, 4e-4])
VISCOUS, QUADRATIC = 4e-4, 0.02
TRUTH = np.array([VISCOUS, QUADRATIC])
FREE = ["effects.joint_friction.viscous", "effects.quadratic_damping.b_q"]
G, RATE, DURATION, NOISE, WINDOW = 9.81, 30.0, 9.6, 0.005, 1.2


def acceleration(phi, w, quadratic):
    """phi'' of the two rods."""
    lever = np.array([[CENTRE[0], 0.0], [LENGTH[0], CENTRE[1]]])
    square = np.einsum("i,ij,ik->jk", MASS, lever, lever) + np.diag(INERTIA)
    apart = phi[:, None] - phi[None, :]
    force = -(square * np.sin(apart)) @ w**2 - G * np.sin(phi) * (MASS @ lever)
    force -= VISCOUS * np.array([w[0] - (w[1] - w[0]), w[1] - w[0]])
    turn = LENGTH[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    speed = np.cumsum(w[:, None] * turn, axis=0)
    drag = -quadratic * np.linalg.norm(speed, axis=1, keepdims=True) * speed
    force += turn[0] @ drag.sum(axis=0) * np.array([1.0, 0.0]) + turn[1] @ drag[1] * np.array([0.0, 1.0])
    return np.linalg.solve(square * np.cos(apart), force)


def swing(phi0, duration=DURATION, quadratic=QUADRATIC):
    """Times and angles (k, 2) from straight down."""
    t = np.arange(round(duration * RATE) + 1) / RATE
    slope = lambda t, y: np.concatenate([y[2:], acceleration(y[:2], y[2:], quadratic)])  # noqa: E731
    found = solve_ivp(slope, (0, t[-1]), [*phi0, 0, 0], method="DOP853", t_eval=t, rtol=1e-11, atol=1e-12)
    return t, found.y[:2].T


def seen(motion, seed, size=NOISE):
    """The motion as a noisy trace."""
    t, phi = motion
    noise = size * np.random.default_rng(seed).standard_normal(phi.shape)
    return Trace("rods", t, phi + noise, convention=Convention("down", 1, "rad"))


@pytest.fixture(scope="module")
def rods(chain):
    effects = {
        "weight": {},
        "joint_friction": {"viscous": 10 * VISCOUS, "axis": [0.0, 1.0, 0.0]},
        "quadratic_damping": {"b_q": 10 * QUADRATIC},
    }
    start = {"kind": "angles", "zero": "down", "polar": [1.2, 0.6]}
    return chain(
        LENGTH, MASS.tolist(), start, effects=effects, centre_of_mass=CENTRE.tolist(), inertia=INERTIA.tolist()
    )


@pytest.fixture(scope="module")
def motion():
    return swing([1.2, 0.6])


@pytest.fixture(scope="module")
def ready(rods):
    """`ready(traces)`: a prepared fit ten times off; all of them share one compiled simulator."""
    shared = []

    def make(traces, **options):
        prepared = prepare(traces, rods, FREE, window=WINDOW, simulator=shared[0] if shared else None, **options)
        shared[:] = [prepared.simulator]
        return prepared

    return make


@pytest.fixture(scope="module")
def ten(ready, motion):
    found = []
    for seed in range(10):
        prepared = ready(seen(motion, seed))
        found.append(summarise(prepared, "windows", estimate(prepared, "windows")))
    return found


def test_damping_of_another_simulators_traces_is_found_without_bias(ten):
    assert all(result.status == "ok" for result in ten)
    assert all(result.seconds["run"] > 0 for result in ten)  # what another fit compiled is no part of its time
    z = np.array([(result.values - TRUTH) / result.uncertainty.std_error for result in ten])
    assert np.all(np.sqrt(np.mean(z**2, axis=0)) < 1.6)
    assert np.all(np.abs(np.mean(z, axis=0)) < 3 / np.sqrt(10))


def test_ninety_percent_intervals_cover_the_truth_at_least_seven_times_in_ten(ten):
    inside = [(result.uncertainty.low <= TRUTH) & (result.uncertainty.high >= TRUTH) for result in ten]
    assert np.all(np.sum(inside, axis=0) >= 7)
    width = np.median([result.uncertainty.std_error / TRUTH for result in ten], axis=0)
    assert np.all(width < 0.5)


def test_runs_with_gaps_are_fitted_together(ready, motion, ten):
    first = seen(motion, 20)
    first.theta[150:180] = np.nan  # most of a window
    second = seen(swing([-0.9, 0.5], 7.2), 21)
    second.theta[np.random.default_rng(22).random(second.theta.shape) < 0.2] = np.nan
    prepared = ready([first, second])
    result = summarise(prepared, "windows", estimate(prepared, "windows"))
    assert result.status == "ok"
    assert set(prepared.windows.run) == {0, 1}
    assert prepared.windows.samples == sum(np.isfinite(tr.theta[:-1]).sum() for tr in (first, second))
    assert np.all(np.abs(result.values - TRUTH) < 3 * result.uncertainty.std_error)
    alone = np.median([r.uncertainty.std_error for r in ten], axis=0)
    assert np.all(result.uncertainty.std_error < alone)


@pytest.mark.slow
def test_the_gradient_of_the_spectrum_loss_agrees_with_central_differences(ready, motion):
    """Starts are eliminated anew at every point; Gauss-Newton's elimination leaves out the residuals' curvature."""
    prepared = ready(seen(motion, 0))
    loss = Projected(prepared.problem(), prepared.starts, "spectrum")
    at = 1.1 * TRUTH
    gradient = loss(at, inner=12)[1]
    for i, step in enumerate(1e-3 * TRUTH):
        ends = []
        for side in (1, -1):
            moved = at.copy()
            moved[i] += side * step
            ends.append(loss(moved, inner=12)[0])
        assert gradient[i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.05)


def spoiled(motion, seed, how):
    """The motion seen with noise of another kind: links of unlike noise, noise with memory, frames late or early."""
    t, phi = motion
    rng = np.random.default_rng(seed)
    white = NOISE * rng.standard_normal(phi.shape)
    if how == "unlike":
        return Trace("rods", t, phi + white * [1.0, 3.0], convention=Convention("down", 1, "rad"))
    if how == "jitter":
        phi = CubicSpline(t, phi)(t + 0.004 * rng.standard_normal(len(t)))
    if how == "memory":
        for i in range(1, len(white)):
            white[i] = 0.9 * white[i - 1] + np.sqrt(1 - 0.9**2) * white[i]
    return Trace("rods", t, phi + white, convention=Convention("down", 1, "rad"))


@pytest.mark.parametrize(
    ("how", "kind", "wider"), [("unlike", "white", 3.0), ("memory", "correlated", 3.0), ("jitter", "jitter", 1.6)]
)
def test_the_noise_of_a_trace_is_named_and_measured_by_its_own_residuals(ready, motion, ten, how, kind, wider):
    """Two draws of each: their errors cover, and are little larger than those of clean traces."""
    clean = np.median([result.uncertainty.std_error for result in ten], axis=0)
    for seed in (30, 31):
        prepared = ready(spoiled(motion, seed, how))
        result = summarise(prepared, "windows", estimate(prepared, "windows"))
        noise = result.noise_table()
        assert result.status == "ok"
        assert noise["kind"] == kind
        assert not any("does not explain" in w for w in result.warnings)
        assert any("late or early" in w for w in result.warnings) == (how == "jitter")
        assert any("noise is correlated" in w for w in result.warnings) == (how == "memory")
        assert np.all(np.abs(result.values - TRUTH) < 3.5 * result.uncertainty.std_error)
        assert np.all(result.uncertainty.std_error < wider * clean)
        size = noise["sigma_rad"][0] / NOISE
        np.testing.assert_allclose(size, [1, 3] if how == "unlike" else [1, 1], rtol=0.3 if how == "memory" else 0.12)
        if how == "memory":
            np.testing.assert_allclose(noise["kept"], 0.9, atol=0.08)
        if how == "jitter":
            np.testing.assert_allclose(noise["delay_s"], 0.004, rtol=0.25)


def test_a_misfit_that_is_no_noise_is_not_taken_for_noise_and_widens_the_errors(ready, motion):
    """Without its quadratic part the law is wrong: misfits are smooth, the noise stays white, blocks tell the error."""
    trace = seen(motion, 0, NOISE / 5)
    prepared = ready(trace)
    solution = estimate(prepared, "windows", frozen=np.array([False, True]))
    result = summarise(prepared, "windows", solution)
    white = np.sqrt(1 / solution.information[0, 0])
    assert result.noise_table()["kind"] == "white"
    assert result.uncertainty.blocks > 0
    assert result.uncertainty.std_error[0] > 2 * white
    assert any("residuals are not noise" in w for w in result.warnings)


def test_the_energy_that_a_motion_loses_confirms_the_law_and_contradicts_a_wrong_one(ready, ten):
    """Slope 1 within its error where the law is right; a seventh less damping in the truth than in the law is told."""
    checks = [energy_check(result) for result in ten[:3]]
    assert all(abs(check.off) < 3 and check.warning is None for check in checks)
    assert np.mean([check.slope for check in checks]) == pytest.approx(1, abs=0.03)
    weaker = swing([1.2, 0.6], quadratic=0.85 * QUADRATIC)[1]
    trace = ten[0].traces[0]
    held = replace(ten[0], traces=[replace(trace, theta=np.pi / 2 - weaker)], warnings=[])
    assert look_at_energy(held).slope < 0.93
    assert look_at_energy(held).off < -3
    assert held.warnings == [held.energy.warning]


def test_a_program_serves_shorter_windows_and_gives_what_their_own_would(ready, motion):
    """Half of each window, by the program of the whole ones and by the samples that both share."""
    prepared = ready(seen(motion, 0))
    simulator, windows = prepared.simulator, prepared.windows
    whole = simulator(prepared.values, prepared.starts, windows)
    programs = len(simulator._programs)
    slots = windows.theta.shape[1] // 2
    steps = int(windows.index[0, slots])
    fields = ("theta", "weight", "index", "fraction")
    half = replace(windows, steps=steps, **{f: getattr(windows, f)[:, :slots] for f in fields})
    found = simulator(prepared.values, prepared.starts, half)
    assert len(simulator._programs) == programs
    np.testing.assert_allclose(found.residual, whole.residual[:, :slots], atol=1e-12)
    np.testing.assert_allclose(found.jacobian, whole.jacobian[:, :slots], rtol=1e-9, atol=1e-9)
    end = whole.theta[:, slots] - np.pi / 2  # the half's end is the whole's next sample
    assert np.abs(found.end[:, :2] - np.pi / 2 - end).max() < 1e-9


@pytest.mark.check
@pytest.mark.parametrize("method", ["windows", "shooting"])
def test_profile_and_bootstrap_agree_with_the_errors_of_either_method(ready, motion, method):
    prepared = ready(seen(motion, 0))
    solution = estimate(prepared, method)
    u = uncertainty(solution)
    found = profile(solution, FREE[0], float(u.std_error[0]), points=2)
    assert found.converged
    assert [found.low, found.high] == pytest.approx([u.low[0], u.high[0]], abs=0.3 * u.std_error[0])
    spread = bootstrap(solution, draws=400).std(axis=0)
    np.testing.assert_allclose(spread, u.std_error, rtol=0.6)


def test_nothing_of_what_is_held_out_touches_the_fit(ready, motion):
    """Whatever stands in the held-out spans: the same windows, noise, first starts, and so the same fit."""
    trace, other = seen(motion, 0), seen(motion, 0)
    held = ((trace.t >= 4.8) & (trace.t < 6.0)) | (trace.t >= 8.4)
    other.theta[held] += 0.3 * np.random.default_rng(1).standard_normal((held.sum(), 2))
    both = [ready(one, until=8.4, held_out=[(4.8, 6.0), (8.4, 9.6)]) for one in (trace, other)]
    for name in ("theta", "weight", "index", "begin"):
        np.testing.assert_array_equal(*(getattr(prepared.windows, name) for prepared in both))
    np.testing.assert_array_equal(*(prepared.starts.theta for prepared in both))
    np.testing.assert_array_equal(*(prepared.starts.omega for prepared in both))
    known = both[0].windows.times()[both[0].windows.weight[..., 0] > 0]
    assert not np.any((known >= 4.8 - 1e-6) & (known < 6.0 - 1e-6) | (known >= 8.4 - 1e-6))


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {},
        pytest.param({"optimizer": "adam", "steps": 45}, marks=pytest.mark.check),
        pytest.param({"loss": "spectrum", "horizon": (1.0,)}, marks=pytest.mark.check),
    ],
)
def test_gradient_descent_of_every_kind_ends_at_the_same_optimum(ready, motion, ten, settings):
    descent = estimate(ready(seen(motion, 0)), "gradient", settings=settings)
    assert np.all(np.abs(descent.values - ten[0].values) < 0.5 * ten[0].uncertainty.std_error)


def test_a_clock_that_runs_late_is_found_beside_the_damping(rods, motion):
    """Frames 0.5 % further apart than the trace tells; lengths and gravity are known."""
    trace = seen(motion, 4)
    late = replace(trace, t=trace.t / 1.005)
    prepared = prepare(late, rods, [*FREE, "clock.rate"], window=WINDOW, priors={"clock.rate": (1.0, 0.02)})
    result = summarise(prepared, "windows", estimate(prepared, "windows"))
    assert result.status == "ok"
    error = result.uncertainty.std_error
    assert np.all(np.abs(result.values - [*TRUTH, 1.005]) < 3 * error)
    assert error[2] < 5e-4
    # its derivative against a difference
    simulator, values = prepared.simulator, result.values
    starts, windows = result.solution.starts, result.windows
    moved = [simulator(values + [0, 0, d], starts, windows).residual for d in (1e-5, -1e-5)]
    exact = simulator(values, starts, windows).jacobian[..., -1]
    np.testing.assert_allclose((moved[0] - moved[1]) / 2e-5, exact, rtol=1e-5, atol=1e-5 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (lambda trace: trace, None),
        (lambda trace: replace(trace, t=trace.t / 1.005), "rate of the clock"),
        (lambda trace: replace(trace, theta=trace.theta + [0.0, np.deg2rad(1.0)]), "marker of link 1"),
        (lambda trace: replace(trace, theta=trace.theta + np.deg2rad(2.0)), "roll of the camera"),
    ],
)
def test_what_spoils_a_trace_is_named_first(ready, motion, spoil, name):
    prepared = ready(spoil(seen(motion, 6)))
    found = advise(prepared, estimate(prepared, "windows"))
    assert all(candidate.told for candidate in found)
    if name is None:
        assert not any(candidate.named for candidate in found)
        return
    assert found[0].name == name
    assert found[0].named
    if name.startswith("marker"):
        change, error = found[0].changes["marker.offset.1"], found[0].errors["marker.offset.1"]
        assert abs(change) == pytest.approx(np.deg2rad(1.0), abs=4 * error)


@pytest.mark.check
def test_what_spoils_a_trace_is_freed_until_nothing_gains(rods, motion):
    trace = seen(motion, 6)
    late = replace(trace, t=trace.t / 1.005, theta=trace.theta + [0.0, np.deg2rad(1.0)])
    result = fit(late, rods, FREE, window=WINDOW, method="windows", auto_free=True)
    assert {candidate.name for candidate in result.freed} == {"rate of the clock", "marker of link 1"}
    assert result["clock.rate"] == pytest.approx(1.005, abs=5e-4)
    assert np.all(np.abs(result.values[:2] - TRUTH) < 3 * result.uncertainty.std_error[:2])


def test_outliers_pull_a_fit_by_students_loss_less_and_are_named(ready, motion):
    """One sample in fifty is 0.1 to 0.3 rad off."""
    trace = seen(motion, 3)
    rng = np.random.default_rng(5)
    off = rng.random(trace.theta.shape) < 0.02
    theta = trace.theta + np.where(off, rng.uniform(0.1, 0.3, off.shape) * rng.choice([-1, 1], off.shape), 0.0)
    prepared = ready(replace(trace, theta=theta))
    plain = summarise(prepared, "windows", estimate(prepared, "windows"))
    robust = summarise(prepared, "windows", estimate(prepared, "windows", StudentT()))
    assert robust.status == "ok"
    error = robust.uncertainty.std_error
    assert np.all(np.abs(robust.values - TRUTH) < 3 * error)
    assert np.all(error < 0.5 * plain.uncertainty.std_error)
    (line,) = (line for line in robust.warnings if "stand out" in line)
    assert int(line.split()[0]) == pytest.approx(off.sum(), rel=0.2)
    named = re.search(r"link (\d) at ([\d.]+) s", line)
    assert off[np.argmin(np.abs(trace.t - float(named[2]))), int(named[1])]


@pytest.mark.check
def test_the_law_that_made_the_traces_wins_the_comparison(ready):
    prepared = ready(seen(swing([1.2, 0.6], quadratic=0.0), 0))
    laws = {law.name: law for law in compare(prepared, ("none", "linear", "joint viscous", "linear + quadratic"))}
    assert [name for name, law in laws.items() if law.chosen] == ["joint viscous"]
    assert min(laws.values(), key=lambda law: law.bic).name == "joint viscous"
    assert laws["joint viscous"].rms == pytest.approx(NOISE, rel=0.1)
    # a start from a third of a window is less sure than the samples, and grows
    assert NOISE < laws["joint viscous"].held_out < 3 * NOISE
    assert laws["joint viscous"].held_out < 1.05 * min(law.held_out for law in laws.values())
    assert laws["linear + quadratic"].cost <= laws["linear"].cost * (1 + 1e-6)


def test_bic_counts_the_same_samples_for_every_law(ready, motion):
    """Residuals that correlate by a half: a third of the samples count; the worse law's are of its own making."""
    windows = ready(seen(motion, 0)).windows
    rng = np.random.default_rng(0)
    white = rng.standard_normal((*windows.weight.shape[:1], 20_000, 2))
    noise = np.zeros_like(white)
    for i in range(1, noise.shape[1]):
        noise[:, i] = 0.5 * noise[:, i - 1] + white[:, i]
    windows = replace(windows, weight=np.ones_like(noise))
    slow = 3 * np.sin(np.arange(20_000) / 500)[None, :, None]
    rows = [Law("good", 1, 0, 0, 0, "ok", {}, free=3), Law("poor", 0, 0, 0, 0, "ok", {}, free=2)]
    good, poor = with_bic(rows, [noise, noise + slow], windows)
    count = noise.size / 3
    expected = count * np.log(np.sum((noise + slow) ** 2) / np.sum(noise**2)) - np.log(count)
    assert poor.bic - good.bic == pytest.approx(expected, rel=0.02)


@pytest.mark.check
@pytest.mark.parametrize("method", ["windows", pytest.param("shooting", marks=pytest.mark.check)])
def test_a_step_too_coarse_for_small_errors_is_told_and_halved_until_it_is_not(ready, motion, method):
    """A hundredth of the noise: the default step, of second order here, moves the estimate by many standard errors."""
    prepared = ready(seen(motion, 0, NOISE / 100))
    coarse = fit_windows(prepared.problem(), prepared.values, prepared.starts)
    told, _ = step_bias(coarse)
    solution = estimate(prepared, method)
    result = summarise(prepared, method, solution)
    error = result.uncertainty.std_error
    assert result.status == "ok"
    assert abs(coarse.values[0] - TRUTH[0]) > 5 * error[0]
    assert np.all(np.abs(result.values - TRUTH) < 3 * error)
    assert solution.windows.substeps >= 4
    assert np.all(np.abs(solution.step_bias) < LARGEST_BIAS)
    if method == "windows":  # the bias that half the step foretold is the one that a much finer step takes away
        own = uncertainty(coarse).std_error
        assert told[0] * own[0] == pytest.approx(coarse.values[0] - solution.values[0], rel=0.1)
    else:  # the step's error does not hold the gap weight up: errors are near those of one uninterrupted run
        free = np.full(2, np.inf)
        whole = joined_step(replace(solution, gap_weight=1e-6), -free, free)
        bound = np.sqrt(np.diag(np.linalg.inv(whole.information)))
        assert np.all(error < 1.6 * result.uncertainty.noise * bound)  # 2.6 where the step stays as it is


def test_a_step_that_stays_too_coarse_is_warned_of(ready, motion):
    prepared = ready(seen(motion, 0, NOISE / 100))
    coarse = fit_windows(prepared.problem(), prepared.values, prepared.starts)
    coarse.step_bias = np.array([0.4, -0.1])
    warnings = summarise(prepared, "windows", coarse).warnings
    assert [w for w in warnings if "the time step moves" in w] == [
        f"the time step moves {FREE[0]} by +0.4 standard errors; a smaller dt mends it"
    ]


def test_one_window_without_a_derivative_does_not_hold_the_parameters(ready, motion, ten):
    """A joint at its switch gave 1e20 for one window: its part is left out and told, the others decide."""
    simulator, windows, best = ready(seen(motion, 0)).simulator, ready(seen(motion, 0)).windows, ten[0].solution
    sound = simulator(best.values, best.starts, windows)
    broken = sound._replace(jacobian=sound.jacobian.copy())
    broken.jacobian[3, 5:] *= 1e18
    found = trusted(broken)
    assert not found.jacobian[3].any()
    assert not found.end_jacobian[3].any()
    assert found.failed.tolist() == [k == 3 for k in range(windows.count)]
    np.testing.assert_array_equal(found.jacobian[:3], sound.jacobian[:3])
    assert trusted(sound) is sound


class Rough:
    """A simulator that makes every point but the first worse: what a cost with jumps looks like where it is lowest."""

    def __init__(self, smooth, size):
        self.smooth, self.size, self.calls = smooth, size, 0

    def __getattr__(self, name):
        return getattr(self.smooth, name)

    def __call__(self, values, starts, windows):
        found = self.smooth(values, starts, windows)
        self.calls += 1
        jump = self.size * min(self.calls, 2) * np.random.default_rng(self.calls).standard_normal(found.residual.shape)
        return found._replace(residual=found.residual + jump * (windows.weight > 0))


@pytest.mark.parametrize(("off", "status"), [(0.0, "ok"), (1.0, "not_converged")])
def test_where_no_step_lowers_the_cost_a_fit_says_how_far_its_minimum_is(ready, motion, ten, off, status):
    """0.3 standard errors are converged; the windows' own optimum tells how far the point really is."""
    prepared, best = ready(seen(motion, 0)), ten[0]
    begin = best.values + off * best.uncertainty.std_error
    rough = replace(prepared.problem(), simulator=Rough(prepared.simulator, 0.3))
    found = fit_windows(rough, begin, best.solution.starts, iterations=30)
    left = float(re.search(r"is (\S+) standard errors away", found.message).group(1))
    assert found.status == status
    assert (left < 0.3) == (status == "ok")
    np.testing.assert_array_equal(found.values, begin)
