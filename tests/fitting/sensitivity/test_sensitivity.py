"""Sensitivities: exact derivatives against differences, an honest horizon, and global indices with a known answer."""

from copy import copy
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import single_line
from rope_cases import slack_rope

from dropper_jax import SceneError, load_scene, simulate
from dropper_jax.cli import main
from dropper_jax.quantities.quantity_names import quantity
from dropper_jax.quantities.statistics import STATISTICS, excess_kurtosis, statistic
from fitting import sensitivity
from fitting.parameters.parameter import with_parameter_values
from fitting.sensitivity import global_indices, local_derivatives, parameter_ranges, study, window_means
from fitting.sensitivity.differences import central_differences, difference_sizes, slopes_of_runs, statistic_notes
from fitting.sensitivity.study_runs import Run, StudyRuns, error_by_coarser
from fitting.sensitivity.study_steps import saved_times
from fitting.sensitivity.texts import global_text, local_text
from fitting.sensitivity.tornado import path_label

START = {"kind": "static", "release_nodes": [1], "release_force": [[3.0, 1.0, 4.0]]}
SCENE = single_line([0.4] * 3, 1.0, START, [0.6, 0.0, 0.0], {"weight": {}, "linear_damping": {"b_l": 0.3}})
SCENE |= {"name": "pendulum", "run": {"dt": 0.01, "duration": 0.5, "integrator": "rattle"}}


@pytest.fixture(scope="module")
def loop():
    return study(SCENE, "tension.1.max", ["b_l", "line.0.mass.1"])


@pytest.fixture(scope="module")
def found(loop):
    return local_derivatives(loop, check=True)


def test_an_extreme_is_that_of_all_steps_also_of_unsaved_ones(loop):
    thinned = {**SCENE, "run": {**SCENE["run"], "save_every": 5}}
    assert study(thinned, "tension.1.max", ["b_l", "line.0.mass.1"]).scene == loop.scene  # the same run
    assert study(thinned, "tension.1.mean", ["b_l"]).scene.run.save_every == 5


def differences(function, at: np.ndarray) -> np.ndarray:
    """Central differences of fourth order, good to about 1e-9."""
    size = 1e-4 * at

    def along(step: np.ndarray) -> float:
        near, far = function(at + step) - function(at - step), function(at + 2 * step) - function(at - 2 * step)
        return float(8 * near - far) / 12

    return np.array([along(step) for step in np.diag(size)]) / size


def test_local_derivatives_are_central_differences_and_both_modes_agree(loop, found):
    """The static start moves with the mass, so that its derivative is in it."""
    np.testing.assert_allclose(found.forward, differences(jax.jit(loop), loop.values), rtol=1e-6)
    assert found.mismatch < 1e-9
    np.testing.assert_allclose(found.scaled, found.forward * loop.values / found.value)
    assert found.trusted
    assert found.horizon == pytest.approx(0.5)
    assert (found.linear_range, found.warnings) == (0.01, [])
    plain = local_derivatives(loop)  # without a check no reverse pass, and the same derivative
    np.testing.assert_allclose(plain.forward, found.forward, rtol=1e-12)
    assert (plain.reverse, plain.mismatch, plain.exponent) == (None, None, None)
    assert plain.trusted


@pytest.mark.check
@pytest.mark.parametrize("of", ["tension.1.max", "tension.1.mean", "x.2.final"])
def test_exact_derivatives_of_a_run_with_an_accuracy_are_those_along_its_own_steps(of):
    scene = {**SCENE, "run": {"duration": 0.5, "accuracy": 0.01, "save_interval": 0.05}}
    problem = study(scene, of, ["b_l", "line.0.mass.1"])
    steps = problem.steps.length
    assert np.sum(steps) == pytest.approx(0.5, rel=1e-12)
    assert np.ptp(steps) > 1e-3
    found = local_derivatives(problem, check=True)
    np.testing.assert_allclose(found.forward, differences(jax.jit(problem), problem.values), rtol=2e-6)
    assert found.mismatch < 1e-9
    assert found.trusted
    solution = simulate(scene)
    own = {"tension.1.max": np.max(solution.tension_max[:, 0]), "tension.1.mean": np.mean(solution.tension[1:, 0])}
    own["x.2.final"] = solution.positions[-1, 2, 0]
    assert found.value == pytest.approx(own[of], rel=0.01 if of.endswith("max") else 1e-9)
    assert 0.0 < found.value_error < 0.05 * abs(found.value)
    np.testing.assert_allclose(problem.batch(problem.values[None])[0], own[of], rtol=1e-9)


def test_line_at_rest_is_not_chaotic_though_its_mass_moves_it_more_than_its_motion():
    found = local_derivatives(study({**SCENE, "start": {"kind": "static"}}, "tension.1.max", ["b_l", "line.0.mass.1"]))
    assert found.trusted
    assert found.exponent is None


@pytest.fixture(scope="module")
def snapping():
    """A mass that falls into a rope, for 0.6 s, with an accuracy; and its own run."""
    scene = slack_rope().with_values({"run.duration": 0.6, "run.accuracy": 0.01})
    problem = study(scene, "tension.mean", ["effects.point_bodies.gravity", "line_type.rope.mass"])
    return problem, StudyRuns(problem)


def test_runs_of_a_study_take_the_steps_of_its_own_run(snapping):
    problem, runs = snapping
    assert problem.scene.run.accuracy == 0.01
    again = runs.run(problem.values)
    assert again.value == runs.value
    assert again.at_most == 0.0
    steps = np.asarray(runs.record.length)
    assert np.sum(steps) == pytest.approx(0.6, rel=1e-12)
    assert np.ptp(steps[steps > 0.0]) > 1e-4


@pytest.mark.check
def test_slopes_of_a_snapping_rope_are_differences_with_an_error(snapping):
    problem, runs = snapping
    reported = []
    found = local_derivatives(problem, lambda share, text: reported.append(text))
    assert (found.method, found.reverse, found.horizon, found.value) == ("differences", None, 0.6, runs.value)
    gravity = problem.values[0]
    slopes = []
    for size in (0.01, 0.003):
        low, high = (runs.run(problem.values * [1.0 + sign * size, 1.0]).value for sign in (-1, 1))
        slopes.append((high - low) / (2 * size * gravity))
    assert found.forward[0] == pytest.approx(slopes[0], rel=1e-9)
    noise = found.noise / (0.01 * gravity)
    assert found.error[0] >= np.hypot(slopes[0] - slopes[1], noise) * (1.0 - 1e-9)
    fresh = [runs.run(problem.values * [1.0 + sign * 0.005, 1.0]).value for sign in (-1, 1)]
    assert abs((fresh[1] - fresh[0]) / (0.01 * gravity) - found.forward[0]) <= 2.0 * found.error[0]
    assert sum(text.startswith("differences") for text in reported) == 9  # one of all parameters, four of each
    assert "error of dQ/dp" in local_text(found)


def made_up_runs(values, moved):
    """The run with all parameters changed, and those of two parameters, by changes of quantity and displacements [m]:
    of -1, +1, -0.3, +0.3 % each."""
    return [Run(values[0], 0.0, 1e-9), *(Run(*pair) for pair in zip(values[1:], [0.0] * 8, moved, strict=True))]


def test_runs_that_move_much_farther_than_others_are_on_another_branch(snapping):
    """By the first parameter one of four, by the second both larger changes, by the same displacement."""
    _, base = snapping
    q = base.value
    straight = [q, 0.99 * q, 1.01 * q, 0.997 * q, 1.003 * q, 0.99 * q, 1.01 * q, 0.997 * q, 1.003 * q]
    usual = [0.01, 0.01, 0.003, 0.003]
    found = slopes_of_runs(base, made_up_runs(straight, usual + usual))
    assert found.slope_status == ("known", "known")
    np.testing.assert_allclose(found.scaled, 1.0, rtol=1e-6)
    found = slopes_of_runs(base, made_up_runs(straight, [0.01, 0.5, 0.003, 0.003] + [0.5, 0.5, 0.003, 0.003]))
    assert found.slope_status == ("other_branch", "other_branch")
    assert not found.trusted
    notes = [text for text in found.warnings if "is on another branch" in text]
    assert len(notes) == 2
    assert "at +1 % is" in notes[0]
    assert "at -1 %, +1 % is" in notes[1]
    assert "other branch" in local_text(found)


def test_a_slope_with_an_error_of_100_times_the_quantity_is_no_number(snapping):
    problem, base = snapping
    q = base.value
    wild = [q, 0.99 * q, 1.01 * q, 0.997 * q, 1.003 * q, -3.0 * q, 5.0 * q, 0.9 * q, 1.1 * q]
    found = slopes_of_runs(base, made_up_runs(wild, [0.01, 0.01, 0.003, 0.003] * 2))
    assert found.slope_status == ("known", "not_resolved")
    assert found.unclear == (problem.names[1],)
    assert np.isfinite(found.forward[0])
    assert np.isnan(found.forward[1])
    assert found.finite
    text = local_text(found)
    assert "not resolved" in text
    assert f"{400.0:.4g}" not in text
    assert any("the slope is not resolved" in line for line in found.warnings)


def test_exact_derivatives_are_checked_by_two_runs_along_them(loop, found):
    signs = np.sign(found.forward)
    ends = [float(loop(loop.values * (1.0 + 0.01 * sign * signs))) for sign in (1.0, -1.0)]
    assert found.along.measured == pytest.approx(ends[0] - ends[1], rel=1e-9)
    assert found.along.predicted == pytest.approx(0.02 * float(np.abs(found.forward) @ loop.values), rel=1e-9)
    assert found.along.status == "trusted"
    assert "of what they predict: trusted" in local_text(found)


@pytest.mark.parametrize(
    ("method", "growth", "motion", "grows"),
    [
        ("differences", 11.6, 4.6, "motion"),
        ("differences", 8.6, 3.1, "tangent"),
        ("differences", 0.1, 0.4, "nothing"),
        ("tangent", 6.9, 3.9, "motion"),  # half of the motion by 1 %
        ("tangent", 6.9, 0.5, "tangent"),
        ("tangent", 3.5, 3.5, "nothing"),  # a phase that drifts, as the derivative predicts
    ],
)
def test_growth_of_small_and_of_large_changes_are_distinguished(found, method, growth, motion, grows):
    assert replace(found, method=method, growth=growth, motion_growth=motion).grows == grows


@pytest.mark.check
def test_a_parameter_without_effect_has_slope_zero_with_error_zero():
    scene = load_scene(
        {**SCENE, "anchor": [{"point": "left", "kind": "tested", "capacity": 5.0, "safety_factor": 1.5}]}
    )
    problem = study(scene, "tension.1.mean", ["anchor.0.capacity", "b_l"])
    found = local_derivatives(problem)
    assert (found.forward[0], found.error[0]) == (0.0, 0.0)
    assert found.forward[1] != 0.0
    by_differences = central_differences(problem)
    assert (by_differences.forward[0], by_differences.error[0]) == (0.0, 0.0)
    assert by_differences.forward[1] == pytest.approx(found.forward[1], abs=5.0 * by_differences.error[1])


def test_a_single_step_maximum_and_samples_that_are_not_gaussian_are_reported(snapping):
    problem, base = snapping
    of = {"tension.max": "is the value of a single step", "tension.1.mpm": "are not Gaussian (excess kurtosis"}
    runs = copy(base)
    for name, words in of.items():
        runs.problem = replace(problem, of=quantity(name, problem.model))
        (warning,) = statistic_notes(runs)
        assert warning.startswith(f"{name}: ")
        assert words in warning


def test_differences_of_lengths_are_smaller_and_end_at_bounds(loop):
    from_bound = replace(loop.parameters[0], value=1.0, low=1.0)
    length = replace(loop.parameters[1], name="line.leg.length")
    assert [difference_sizes(p) for p in (from_bound, length)] == [(0.01, 0.003), (0.006, 0.002)]
    problem = replace(loop, parameters=(from_bound,))
    found = central_differences(problem)
    one_sided = np.diff([StudyRuns(problem).run(np.array([x])).value for x in (1.0, 1.01)])[0] / 0.01
    assert found.forward[0] == pytest.approx(one_sided, rel=1e-12)


@pytest.mark.check
def test_slope_of_a_packaged_longline_predicts_its_runs():
    """Its tangent predicts 3.85e16 N for 1 % of a leg; the runs differ by -206 N."""
    scene = load_scene("edulis-longline").with_values({"run.duration": 30.0})
    found = local_derivatives(study(scene, "tension.west-leg.max", ["line.west-leg.length"]))
    change, error = (0.01 * 44.0 * x[0] for x in (found.forward, found.error))
    assert abs(change + 206.0) < 2.0 * error
    assert error < 50.0


def test_growth_of_the_derivatives_finds_a_chaotic_motion():
    run = {"run.duration": 12.0, "run.dt": 0.01, "run.integrator": "rattle"}
    found = local_derivatives(
        study(load_scene("double-pendulum-chaotic").with_values(run), "angle.2.final", ["line.0.mass.1"])
    )
    assert found.exponent > 0.3
    assert found.horizon < 12.0
    assert np.isfinite(found.window_mean).all()


def test_window_as_long_as_the_run_is_the_run_from_a_held_start(loop):
    @jax.jit
    def held(p):
        model = with_parameter_values(loop.model, loop.parameters, p)
        run = loop.plan.march(model, loop.start, loop.steps)
        return loop.plan.measure(model, loop.start, run, saved_times(loop.steps))

    mean, _, length = window_means(loop, 0.5, None)  # one window needs no states of the run
    assert length == pytest.approx(0.5)
    np.testing.assert_allclose(mean, differences(held, loop.values), rtol=1e-6)


def ishigami(x: np.ndarray) -> np.ndarray:
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def test_sobol_indices_of_the_ishigami_function():
    """Closed form: V1 = (1 + b pi^4/5)^2/2, V2 = a^2/8, V13 = b^2 pi^8 (1/18 - 1/50), with a = 7, b = 0.1."""
    pytest.importorskip("SALib")
    a, b = 7.0, 0.1
    v1, v2, v13 = 0.5 * (1 + b * np.pi**4 / 5) ** 2, a**2 / 8, b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    total = v1 + v2 + v13
    box = [(-np.pi, np.pi)] * 3
    found = global_indices(ishigami, ["x1", "x2", "x3"], box, samples=2048)
    np.testing.assert_allclose(found.first, [v1 / total, v2 / total, 0.0], atol=0.05)
    np.testing.assert_allclose(found.total, [(v1 + v13) / total, v2 / total, v13 / total], atol=0.05)
    assert found.runs == 2048 * 5
    assert "wide" not in global_text(found, "f")
    assert "--samples 32 halves them" in global_text(global_indices(ishigami, ["x1", "x2", "x3"], box, samples=8), "f")


def test_morris_ranks_a_function_with_known_effects():
    pytest.importorskip("SALib")
    found = global_indices(
        lambda x: 5 * x[:, 0] + x[:, 1] + x[:, 1] * x[:, 2], list("abcd"), [(0, 1)] * 4, "morris", 32
    )
    assert np.argsort(-found.first)[0] == 0
    assert found.first[0] == pytest.approx(5.0)
    assert found.total[0] == pytest.approx(0.0, abs=1e-9)  # linear: no spread
    assert found.total[1] > 0.1
    assert found.first[3] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("method", "samples", "message"),
    [
        ("sobol", 8, "2 of 40 cases failed"),
        ("sobol", 100, "samples: 100; allowed: a power of 2"),
        ("sobol", 4, "samples: 4; allowed: a whole number >= 8"),
        ("morris", 1, "samples: 1; allowed: a whole number >= 2"),
    ],
)
def test_global_study_refuses_what_it_cannot_do(method, samples, message):
    pytest.importorskip("SALib")
    fails = lambda x: np.where(np.arange(len(x)) < 2, np.nan, 1.0)  # noqa: E731
    with pytest.raises(SceneError, match=message):
        global_indices(fails, ["a", "b", "c"], [(0, 1)] * 3, method, samples)


def test_a_range_is_the_given_one_and_not_empty(loop):
    assert parameter_ranges(loop, {"b_l": (0.1, 0.2)})[0] == (0.1, 0.2)
    for wrong in ({"b_l": (2.0, 1.0)}, {"b_l": (0.1, 0.2), loop.names[0]: (0.1, 0.3)}):
        with pytest.raises(SceneError, match="allowed: low < high, once"):
            parameter_ranges(loop, wrong)
    with pytest.raises(SceneError, match=r"b_l = -0.1:0.2 is out of bounds; allowed: >= 0 kg/s"):
        parameter_ranges(loop, {"b_l": (-0.1, 0.2)})


def test_statistics_of_a_sine_are_its_amplitude():
    t = np.arange(400) * 0.01
    x = jnp.asarray(2.0 + 1.5 * np.sin(2 * np.pi * t))[:, None]
    assert STATISTICS["peak"](x) == pytest.approx(1.5, rel=1e-6)
    assert STATISTICS["std"](x) == pytest.approx(1.5 / np.sqrt(2))
    assert STATISTICS["fatigue"](x) == pytest.approx(1.5 * (4 / (3 * np.pi)) ** (1 / 3), rel=1e-4)
    for name, function in STATISTICS.items():
        assert np.isfinite(jax.grad(function)(jnp.ones((8, 1)))).all(), name


def test_a_sustained_maximum_is_that_of_means_over_a_fifth_of_a_second():
    """The mean of a sine over a time T around its top is `sin(w T/2)/(w T/2)` of it."""
    t = 0.01 * (1 + np.arange(1000))
    half = 0.5 * 2.0 * np.pi / 2.5 * 0.2
    x = np.stack([3.0 + 2.0 * np.sin(2.0 * np.pi * t / 2.5), np.zeros_like(t)], axis=1)
    assert float(statistic("sustained", x, 0.01)) == pytest.approx(3.0 + 2.0 * np.sin(half) / half, rel=1e-4)


def test_a_most_probable_maximum_follows_from_the_rate_of_crossings():
    """Harmonics of known amplitudes: `s^2` is half the sum of their squares, `s'^2` that of `(w a)^2`."""
    rng = np.random.default_rng(0)
    cycles, amplitude, phase = np.arange(40, 80), rng.uniform(0.1, 1.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40)
    t = np.arange(1, 12001) * 0.05
    w = 2.0 * np.pi * cycles / 600.0
    x = 7.0 + np.cos(w * t[:, None] + phase) @ amplitude
    s, rate = np.sqrt(np.sum(amplitude**2) / 2.0), np.sqrt(np.sum((w * amplitude) ** 2) / 2.0)
    expected = 7.0 + s * np.sqrt(2.0 * np.log(10800.0 * rate / (2.0 * np.pi * s)))
    assert float(statistic("mpm", x[:, None], 0.05)) == pytest.approx(expected, rel=1e-4)
    assert abs(excess_kurtosis(x[:, None])) < 0.5
    assert float(statistic("mpm", np.full((10, 2), 4.0), 0.05)) == 4.0


def test_labels_name_links_and_effects():
    assert path_label("line.0.mass.2") == "mass of link 3"
    assert path_label("line.leg.length") == "line.leg.length"
    assert path_label("effects.linear_damping.b_l") == "linear damping: b_l"


def test_command_prints_a_table_and_draws(tmp_path, printed, json_of, monkeypatch, found):
    picture = tmp_path / "tornado.png"
    argv = ["sensitivity", "double-pendulum-chaotic", "--duration", "1", "--of", "tension.1.max", "--quiet"]
    argv += ["--to", "line.0.mass"]
    with monkeypatch.context() as patch:
        patch.setattr(sensitivity, "local_derivatives", lambda problem, say, check: found)
        assert "p/Q dQ/dp" in printed([*argv, "--plot", str(picture)]).out
        assert picture.stat().st_size > 5000
        reported = json_of([*argv, "--json"])
    assert reported["forward"] == found.forward.tolist()
    assert reported["trusted"] is True
    assert (reported["method"], reported["grows"]) == ("tangent", "nothing")
    assert reported["error"] == found.error.tolist()
    assert "to: 'line.0.mas' does not exist" in json_of([*argv[:-1], "line.0.mas", "--json"], 2)["error"]


def test_command_has_the_verdict_of_a_run_on_its_step(json_of, monkeypatch, found):
    """A derivative through steps that `dropper run` calls unusable is not ok."""
    argv = ["conical-pendulum-damped", "--dt", "0.3", "--duration", "15", "--quiet"]
    monkeypatch.setattr(sensitivity, "local_derivatives", lambda problem, say, check: found)
    printed = json_of(["sensitivity", *argv, "--of", "tension.max", "--to", "b_l", "--json"], 3)
    assert printed["status"] == "step_too_long"
    assert any(text.startswith("the run: mean tension") for text in printed["warnings"])
    assert main(["run", *argv]) == 3


def test_command_screens_globally(tmp_path, json_of):
    """Nothing but the ratio of the two masses matters to the angles, so that both have effects of about one size."""
    pytest.importorskip("SALib")
    argv = ["sensitivity", "double-pendulum-chaotic", "--duration", "0.3", "--dt", "0.02", "--integrator", "rattle"]
    argv += ["--of", "angle.2.final", "--to", "line.0.mass", "--global", "morris", "--samples", "8", "--json"]
    found = json_of([*argv, "--plot", str(tmp_path / "morris.png")])
    assert found["runs"] == 24
    assert found["first"][0] == pytest.approx(found["first"][1], rel=0.2)


@pytest.mark.parametrize("statistic", ["max", "min"])
def test_extremes_move_with_the_signal_and_not_with_where_the_samples_fall(statistic):
    """Of `a sin(w t + p)` sampled 20 times a period: d max/dp = 0, d max/da = 1, the same of the least value."""
    t = jnp.arange(40) * (2 * jnp.pi / 20)
    sign = 1.0 if statistic == "max" else -1.0

    def extreme(a, p):
        return STATISTICS[statistic](jnp.stack([a * jnp.sin(t + p), 0.3 * jnp.cos(t)], axis=1))

    for p in jnp.linspace(0.0, 0.3, 7):
        value, (by_a, by_p) = jax.value_and_grad(extreme, argnums=(0, 1))(2.0, p)
        np.testing.assert_allclose(value, sign * 2.0, atol=1e-3)
        np.testing.assert_allclose(by_a, sign, atol=1e-3)
        assert abs(by_p) < 0.006  # of the samples alone up to 0.31


def test_extremes_at_the_ends_of_a_signal_and_of_flat_ones_are_the_samples():
    for x in ([3.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 2.0, 2.0], [3.0], [1.0, 3.0]):
        value, slope = jax.value_and_grad(lambda x: STATISTICS["max"](x[:, None]))(jnp.array(x))
        assert value == max(x)
        np.testing.assert_allclose(jnp.sum(slope), 1.0)


@pytest.mark.parametrize(("accuracy", "error"), [(0.1, 1.0), (0.5, 3.0), (1.0, np.nan)])
def test_the_error_by_the_steps_allows_for_a_coarser_run_that_is_not_four_times_as_coarse(loop, accuracy, error):
    of = replace(loop.of, statistic="mean")
    np.testing.assert_allclose(error_by_coarser(of, 10.0, 13.0, accuracy), error)
