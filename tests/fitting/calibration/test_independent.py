"""Fits of traces that another simulator made (`conftest`): estimates, errors, what warns of them."""

import re
from dataclasses import replace

import numpy as np
import optax
import pytest

from dropper_jax import SceneError
from fitting import bootstrap, fit, predict, profile
from fitting.calibration.comparison import compare_laws
from fitting.calibration.fit import estimate
from fitting.calibration.prediction import DIVERGED_ANGLE
from fitting.calibration.summarise import summarise
from fitting.estimate.descent import CONVERGED_DISTANCE, GradientDescent
from fitting.estimate.least_squares import descend, fit_windows
from fitting.estimate.normal_equations import drop_undefined
from fitting.estimate.objective import objective_at
from fitting.estimate.simulator import Key, Program
from fitting.estimate.step_size import LARGEST_BIAS, step_bias
from fitting.estimate.uncertainty import uncertainty
from fitting.laws.law_bic import with_bic
from fitting.laws.laws import Law
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import LostTarget
from fitting.report.pictures import one_run_picture


@pytest.mark.check
def test_damping_of_another_simulators_traces_is_found_without_bias_and_intervals_cover_it(two, ten):
    """90 % intervals cover the truth at least seven times in ten."""
    assert all(result.status == "ok" for result in ten)
    assert all(result.seconds["run"] > 0 for result in ten)  # what another fit compiled is no part of its time
    z = np.array([(result.values - two.TRUTH) / result.uncertainty.std_error for result in ten])
    assert np.all(np.sqrt(np.mean(z**2, axis=0)) < 1.6)
    assert np.all(np.abs(np.mean(z, axis=0)) < 3 / np.sqrt(10))
    inside = [(result.uncertainty.low <= two.TRUTH) & (result.uncertainty.high >= two.TRUTH) for result in ten]
    assert np.all(np.sum(inside, axis=0) >= 7)
    assert np.all(np.median([result.uncertainty.std_error / two.TRUTH for result in ten], axis=0) < 0.5)


@pytest.mark.check
def test_runs_with_gaps_are_fitted_together(two, ready, fitted, motion, ten):
    first = two.seen(motion, 20)
    first.theta[150:180] = np.nan  # most of a window
    second = two.seen(two.swing([-0.9, 0.5], 7.2), 21)
    second.theta[np.random.default_rng(22).random(second.theta.shape) < 0.2] = np.nan
    result = fitted(ready([first, second]))
    windows = result.prepared.windows
    assert result.status == "ok"
    assert set(windows.run) == {0, 1}
    assert windows.samples == sum(np.isfinite(tr.theta[:-1]).sum() for tr in (first, second))
    assert np.all(np.abs(result.values - two.TRUTH) < 3 * result.uncertainty.std_error)
    assert np.all(result.uncertainty.std_error < np.median([r.uncertainty.std_error for r in ten], axis=0))


@pytest.mark.check
@pytest.mark.parametrize("options", [{"held_out": [(6.0, 9.6)]}, {"until": 6.0}, {}])
def test_a_rig_that_swings_is_never_reported_at_rest(two, ready, motion, options):
    """Samples that a fit does not see, or that are missing at both ends, are no still frames."""
    trace = two.seen(motion, 0)
    if not options:
        trace.theta[[*range(45), *range(-90, 0)]] = np.nan
    assert not [line for line in ready(trace, **options).warnings if "rest" in line]


@pytest.mark.check
def test_a_pose_held_before_the_release_is_found_and_is_no_part_of_the_fit(two, ready, fitted, motion):
    """Two seconds held by hand before the release: the fit and its errors are those of the motion alone."""
    t, phi = motion
    held = round(2.0 * two.RATE)
    moving = two.seen((t[: len(t) - held], phi[: len(t) - held]), 40)
    still = phi[0] + two.NOISE * np.random.default_rng(41).standard_normal((held, 2))
    trace = replace(moving, t=np.r_[t[:held], t[held] + moving.t], theta=np.concatenate([still, moving.theta]))
    prepared = ready(trace)
    assert t[held] - 1 / two.RATE < prepared.windows.begin.min() < t[held] + 8 / two.RATE
    (note,) = (line for line in prepared.warnings if "held still until 2" in line)
    assert "the fit starts there" in note
    assert not [line for line in prepared.warnings if "rest" in line]
    alone = ready(moving.between(prepared.windows.begin.min() - t[held], np.inf))
    result, other = fitted(prepared), fitted(alone)
    assert result.status == "ok"
    assert np.all(np.abs(result.values - two.TRUTH) < 3 * result.uncertainty.std_error)
    np.testing.assert_allclose(result.uncertainty.std_error, other.uncertainty.std_error, rtol=0.02)


@pytest.mark.check
def test_one_run_follows_the_trace_and_reports_how_long(two, ten, motion, tmp_path):
    """Against SciPy's motion without its noise; with twice the damping the run leaves the trace early."""
    found = predict(ten[0])
    t, phi = motion
    good = t <= min(found.trusted, t[-1] - 2 / two.RATE)
    turned = np.pi / 2 - phi[good]  # from the horizontal, positive downwards
    apart = (found.simulated[good[: len(found.t)]] - turned + np.pi) % (2 * np.pi) - np.pi
    assert good.sum() > 30
    assert np.sqrt(np.mean(apart**2, axis=1)).max() < DIVERGED_ANGLE
    assert found.diverged_at >= found.trusted
    assert "of the trace for" in found.text
    wrong = replace(ten[0], solution=replace(ten[0].solution, values=2 * ten[0].values))
    assert predict(wrong).diverged_at < found.diverged_at
    assert one_run_picture(found, "rods", tmp_path / "run.png").stat().st_size > 10_000


def test_a_program_serves_shorter_windows_and_gives_what_their_own_would(prepared):
    """Half of each window, by the program of the whole ones and by the samples that both share."""
    simulator, windows = prepared.simulator, prepared.windows
    whole = simulator(prepared.values, prepared.starts, windows)
    programs = len(simulator._programs)
    assert programs == 1, "short windows, by which the preparation looks at the motion, have the same program"
    slots = windows.theta.shape[1] // 2
    steps = int(windows.index[0, slots])
    fields = ("theta", "weight", "index", "fraction")
    counts = np.minimum(windows.step_counts, steps)
    half = replace(windows, steps=steps, step_counts=counts, **{f: getattr(windows, f)[:, :slots] for f in fields})
    found = simulator(prepared.values, prepared.starts, half)
    assert len(simulator._programs) == programs
    np.testing.assert_allclose(found.residual, whole.residual[:, :slots], atol=1e-12)
    np.testing.assert_allclose(found.jacobian, whole.jacobian[:, :slots], rtol=1e-9, atol=1e-9)
    end = whole.theta[:, slots] - np.pi / 2  # the half's end is the whole's next sample
    longer = windows.step_counts > steps  # not what is left at the end of the trace
    assert np.abs(found.end[:, :2] - np.pi / 2 - end)[longer].max() < 1e-9


def test_the_time_that_a_view_of_a_simulator_compiles_counts(prepared, monkeypatch):
    before = prepared.simulator.compile_s
    view = prepared.simulator.view_of_starts()
    monkeypatch.setitem(view._programs, Key(False, 1.0, True, 1, 1), Program(None, 2.0))
    assert prepared.simulator.compile_s == pytest.approx(before + 2.0)


@pytest.mark.check
@pytest.mark.parametrize("method", ["windows", "shooting"])
def test_profile_and_bootstrap_agree_with_the_errors_of_either_method(two, prepared, fitted, method):
    result = fitted(prepared, method)
    u = result.uncertainty
    found = profile(result, two.FREE[0], points=2)
    assert found.converged
    assert [found.low, found.high] == pytest.approx([u.low[0], u.high[0]], abs=0.3 * u.std_error[0])
    spread = bootstrap(result, draws=400).draws.std(axis=0)
    np.testing.assert_allclose(spread, u.std_error, rtol=0.6)


@pytest.mark.check
def test_a_bootstrap_of_few_windows_is_as_wide_as_the_noise_makes_it_and_warns(ten):
    """Eight windows, of which the first few determine most, of ten traces with white noise of known size."""
    drawn = [bootstrap(result, draws=400) for result in ten]
    ratio = [d.draws.std(axis=0) / result.uncertainty.std_error for d, result in zip(drawn, ten, strict=True)]
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(ratio), axis=0)), 1.0, atol=0.15)
    assert all(1 < d.blocks < 15 for d in drawn)
    assert all("blocks of time, fewer than 15" in d.warning for d in drawn)


def test_a_bootstrap_of_one_block_is_refused(first_fit):
    """Every draw would be the fit itself, and its intervals of no width."""
    with pytest.raises(SceneError, match="bootstrap: blocks of 1000 stretches; allowed: 1 to"):
        bootstrap(first_fit, block=1000)
    with pytest.raises(SceneError, match="bootstrap: blocks of 0 stretches"):
        bootstrap(first_fit, block=0)


@pytest.mark.filterwarnings("ignore:overflow encountered", "ignore:invalid value encountered")
def test_a_prediction_whose_neighbouring_run_fails_is_not_trusted(first_fit):
    """One standard error away the parameters overflow: that run has no motion."""
    errors = np.full_like(first_fit.values, 1e300)
    found = predict(replace(first_fit, uncertainty=replace(first_fit.uncertainty, std_error=errors)))
    assert found.trusted == found.begin
    assert np.isfinite(found.simulated).all()


def test_a_jump_of_the_clock_before_its_first_window_does_not_end_a_prediction(first_fit):
    problem, u = first_fit.solution.problem, first_fit.uncertainty
    jump = Parameter("clock.lost.0.1", LostTarget(0, 1, -1.0), 0.0)
    problem = replace(problem, parameters=(*problem.parameters, jump))
    solution = replace(first_fit.solution, problem=problem, values=np.append(first_fit.values, 0.0))
    found = predict(
        replace(first_fit, solution=solution, uncertainty=replace(u, std_error=np.append(u.std_error, 0.0)))
    )
    assert found.t[-1] == first_fit.traces[0].t[-1]


def test_nothing_of_what_is_held_out_touches_the_fit(two, ready, motion):
    """With any samples in the held-out spans: the same windows, noise, first starts, and so the same fit."""
    trace, other = two.seen(motion, 0), two.seen(motion, 0)
    held = ((trace.t >= 4.8) & (trace.t < 6.0)) | (trace.t >= 8.4)
    other.theta[held] += 0.3 * np.random.default_rng(1).standard_normal((held.sum(), 2))
    both = [ready(one, until=8.4, held_out=[(4.8, 6.0), (8.4, 9.6)]) for one in (trace, other)]
    windows = both[0].windows
    for name in ("theta", "weight", "index", "begin"):
        np.testing.assert_array_equal(getattr(windows, name), getattr(both[1].windows, name))
    np.testing.assert_array_equal(both[0].starts, both[1].starts)
    known = windows.times()[windows.weight[..., 0] > 0]
    assert not np.any((known >= 4.8 - 1e-6) & (known < 6.0 - 1e-6) | (known >= 8.4 - 1e-6))


@pytest.fixture(scope="module")
def joined(prepared, fitted):
    """The default's fit of the first trace."""
    return fitted(prepared, "shooting")


@pytest.mark.parametrize(
    "settings",
    [
        {"optimizer": "lbfgs"},
        {"optimizer": "adam"},
        pytest.param({"optimizer": "sgd"}, marks=pytest.mark.check),
        pytest.param({"optimizer": optax.adam(0.3, b1=0.5, b2=0.9)}, marks=pytest.mark.check),
        pytest.param({"preconditioner": "size"}, marks=pytest.mark.check),
    ],
)
def test_gradient_descent_ends_at_the_defaults_estimate_gap_weight_and_errors(prepared, fitted, joined, settings):
    """From ten times off; a tenth of a standard error is twice what descent may leave in every direction."""
    result = fitted(prepared, GradientDescent(**settings))
    error = joined.uncertainty.std_error
    assert result.status == "ok"
    assert result.solution.gap_weight == joined.solution.gap_weight
    weights = [{row.gap_weight for row in each.solution.history} for each in (result, joined)]
    assert weights[0] == weights[1]  # chosen by the linear model of the motion
    assert np.all(np.abs(result.values - joined.values) < 0.1 * error)
    np.testing.assert_allclose(result.uncertainty.std_error, error, rtol=0.05)
    np.testing.assert_allclose(result.solution.problem.noise.factor, joined.solution.problem.noise.factor, rtol=0.02)
    assert np.all(np.abs(result.solution.step_bias) < LARGEST_BIAS)


@pytest.mark.check
def test_descent_stops_near_the_minimum_along_every_combination_of_the_parameters(prepared):
    """g' S^-1 g of separate windows at its end, by the normal equations of Gauss-Newton."""
    problem = replace(prepared.problem(), descent=GradientDescent("adam"))
    found = fit_windows(problem, prepared.values, prepared.starts)
    assert found.status == "ok"
    left = found.gradient @ np.linalg.solve(found.information, found.gradient)
    assert left < CONVERGED_DISTANCE**2 * found.chi2 / found.windows.samples * 1.01
    apart = found.values - fit_windows(prepared.problem(), prepared.values, prepared.starts).values
    assert apart @ found.information @ apart < (2 * CONVERGED_DISTANCE) ** 2
    losses = [point.loss for point in found.history[1:]]
    assert len(losses) == found.iterations - 1
    assert losses[-1] == pytest.approx(2 * found.cost / found.windows.samples)


def test_a_coefficient_whose_minimum_is_below_zero_ends_on_its_bound(two, ready):
    """A motion without quadratic drag, fitted by a descent and by Gauss-Newton steps."""
    for seed in range(4):
        prepared = ready(two.seen(two.swing([1.2, 0.6], quadratic=0.0), seed))
        expected = fit_windows(prepared.problem(), prepared.values, prepared.starts)
        if expected.values[1] == 0.0:
            break
    problem = replace(prepared.problem(), descent=GradientDescent("lbfgs"))
    found = fit_windows(problem, prepared.values, prepared.starts)
    assert expected.values[1] == 0.0
    assert found.status == "ok"
    assert found.values[1] == 0.0
    error = 1 / np.sqrt(expected.information[0, 0])
    assert abs(found.values[0] - expected.values[0]) < 0.1 * error


def test_a_learning_rate_that_diverges_and_steps_too_few_say_what_to_do(prepared):
    wild = estimate(prepared, GradientDescent("adam", learning_rate=1e4))
    assert wild.status == "not_converged"
    assert re.fullmatch(
        r"the loss (grew from \S+ to \S+|is not finite) after \d+ steps of adam with learning rate 10000. Use 0.3",
        wild.message,
    )
    assert np.isfinite(wild.cost)
    short = estimate(prepared, GradientDescent(steps=1))
    assert (short.status, short.message) == ("not_converged", "no convergence in 1 steps of lbfgs. Use more steps")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"optimizer": "adm"}, "optimizer: 'adm' is unknown; did you mean 'adam'"),
        ({"steps": 0}, "steps: 0 is not positive; allowed: at least 1"),
        ({"learning_rate": -1.0}, "learning_rate: -1 is not positive; allowed: > 0, such as 1"),
        ({"learning_rate": np.nan}, "learning_rate: nan is not positive"),
        ({"learning_rate": 0.1, "optimizer": optax.adam(0.1)}, "is part of a transformation of optax"),
        ({"preconditioner": "siz"}, "preconditioner: 'siz' is unknown; did you mean 'size'"),
    ],
)
def test_settings_of_a_descent_that_make_no_sense_are_refused_before_anything_runs(settings, words, refusal):
    assert words in refusal(lambda: fit("no-such-file.csv", "dropper-release-a", method=GradientDescent(**settings)))


@pytest.mark.check
def test_the_law_that_made_the_traces_wins_the_comparison(two, ready):
    prepared = ready(two.seen(two.swing([1.2, 0.6], quadratic=0.0), 0))
    laws = {law.name: law for law in compare_laws(prepared, ("none", "linear", "joint viscous", "linear + quadratic"))}
    assert [name for name, law in laws.items() if law.chosen] == ["joint viscous"]
    assert min(laws.values(), key=lambda law: law.bic).name == "joint viscous"
    assert laws["joint viscous"].rms == pytest.approx(two.NOISE, rel=0.1)
    # a start from a third of a window is less sure than the samples, and grows
    assert two.NOISE < laws["joint viscous"].held_out < 3 * two.NOISE
    assert laws["joint viscous"].held_out < 1.05 * min(law.held_out for law in laws.values())
    assert laws["linear + quadratic"].cost <= laws["linear"].cost * (1 + 1e-6)


def test_bic_counts_the_same_samples_for_every_law(prepared):
    """Residuals that correlate by a half: a third of the samples count; the worse law's are of its own making."""
    windows = prepared.windows
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


@pytest.fixture(scope="module")
def exact(two, ready, motion):
    """A preparation whose noise is a hundredth."""
    return ready(two.seen(motion, 0, two.NOISE / 100))


@pytest.mark.check
@pytest.mark.parametrize("method", ["windows", "shooting"])
def test_a_step_too_coarse_for_small_errors_is_reported_and_halved_until_it_is_not(two, exact, fitted, method):
    """A hundredth of the noise: the default step, of second order here, moves the estimate by many standard errors."""
    coarse = fit_windows(exact.problem(), exact.values, exact.starts)
    reported, _ = step_bias(coarse)
    result = fitted(exact, method)
    solution = result.solution
    error = result.uncertainty.std_error
    assert result.status == "ok"
    assert abs(coarse.values[0] - two.TRUTH[0]) > 5 * error[0]
    assert np.all(np.abs(result.values - two.TRUTH) < 3 * error)
    assert solution.windows.substeps >= 4
    assert np.all(np.abs(solution.step_bias) < LARGEST_BIAS)
    if method == "windows":  # the bias that half the step predicted is the one that a much finer step takes away
        own = uncertainty(coarse).std_error
        assert reported[0] * own[0] == pytest.approx(coarse.values[0] - solution.values[0], rel=0.1)
    else:  # the step's error does not hold the gap weight up: errors are near those of one uninterrupted run
        level = objective_at(solution.problem, 1e-6)
        whole = level.undamped_step(solution.evaluation, solution.values, np.inf)
        bound = np.sqrt(np.diag(np.linalg.inv(whole.information)))
        assert np.all(error < 1.6 * result.uncertainty.noise * bound)  # 2.6 where the step stays as it is


@pytest.mark.check
@pytest.mark.parametrize("part", [1.0, 0.1, 0.03])
def test_without_noise_a_fit_ends_within_a_fifth_of_its_stated_errors(two, ready, motion, part):
    """The samples of a fit lose their noise; its weights, joins and step stay, so that the step's error remains."""
    trace = two.seen(motion, 0, part * two.NOISE)
    prepared = ready(trace)
    solution = estimate(prepared, "shooting")
    windows = solution.windows
    noise = motion[1] - trace.theta  # the model's angles from the horizontal grow the other way round
    frame = np.clip(np.rint(windows.times() * two.RATE).astype(int), 0, len(noise) - 1)
    clean = np.where(windows.weight > 0, windows.theta - noise[frame], 0.0)
    problem = replace(solution.problem, windows=replace(windows, theta=clean))
    begin = replace(solution, problem=problem, evaluation=problem.evaluate(solution.values, solution.starts))
    found = descend(objective_at(problem, solution.gap_weight), begin, 40)
    assert np.all(np.abs(found.values - two.TRUTH) < 0.2 * uncertainty(solution).std_error)


def test_a_step_that_stays_too_coarse_is_warned_of(two, exact):
    coarse = fit_windows(exact.problem(), exact.values, exact.starts)
    coarse.step_bias = np.array([0.4, -0.1])
    warnings = summarise(exact, "windows", coarse).warnings
    assert [w for w in warnings if "the time step shifts" in w] == [
        f"the time step shifts {two.FREE[0]} by +0.4 standard errors. Use a smaller dt"
    ]


def test_one_window_without_a_derivative_does_not_hold_the_parameters(prepared, first_fit):
    """A joint at its switch gave 1e20 for one window: its part is left out and reported, the others decide."""
    windows, best = prepared.windows, first_fit.solution
    sound = prepared.simulator(best.values, best.starts, windows)
    broken = sound._replace(jacobian=sound.jacobian.copy())
    broken.jacobian[3, 5:] *= 1e18
    found = drop_undefined(broken)
    assert not found.jacobian[3].any()
    assert not found.end_jacobian[3].any()
    assert found.failed.tolist() == [k == 3 for k in range(windows.count)]
    np.testing.assert_array_equal(found.jacobian[:3], sound.jacobian[:3])
    assert drop_undefined(sound) is sound
    few = sound._replace(jacobian=np.where(np.arange(windows.count)[:, None, None, None] < 2, sound.jacobian, 0.0))
    assert drop_undefined(few) is few  # most windows without samples


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
def test_where_no_step_lowers_the_cost_a_fit_reports_how_far_its_minimum_is(prepared, first_fit, off, status):
    """0.3 standard errors are converged; the windows' own optimum shows how far the point really is."""
    best = first_fit
    begin = best.values + off * best.uncertainty.std_error
    rough = replace(prepared.problem(), simulator=Rough(prepared.simulator, 0.3))
    found = fit_windows(rough, begin, best.solution.starts, iterations=30)
    left = float(re.search(r"is (\S+) standard errors away", found.message).group(1))
    assert found.status == status
    assert (left < 0.3) == (status == "ok")
    np.testing.assert_array_equal(found.values, begin)
