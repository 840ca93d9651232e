"""Systematic errors of traces of another simulator, reported by name: noise, clocks, markers, outliers, frames."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import dropper_jax as dj
from dropper_jax import build_model
from fitting import Convention, FitSettings, StudentT, Trace, fit, fit_and_free, prepare
from fitting.calibration.advice import score_candidates
from fitting.calibration.candidate import Candidate
from fitting.calibration.fault_groups import fault_groups
from fitting.calibration.fit import estimate
from fitting.calibration.freeing import promising
from fitting.calibration.held_out import window_length
from fitting.calibration.possible_faults import candidate_simulator


@pytest.fixture(scope="module")
def everything():
    """`everything(prepared)`: one simulator that knows the numbers of all candidates."""
    found = []

    def make(prepared):
        found[:] = found or [candidate_simulator(prepared)]
        return found[0]

    return make


def spoiled(two, motion, seed, how):
    """The motion seen with noise of another kind: links of unlike noise, noise with memory, frames late or early."""
    t, phi = motion
    rng = np.random.default_rng(seed)
    white = two.NOISE * rng.standard_normal(phi.shape)
    if how == "unlike":
        return Trace("rods", t, phi + white * [1.0, 3.0], convention=Convention("down", 1, "rad"))
    if how == "jitter":
        phi = CubicSpline(t, phi)(t + 0.004 * rng.standard_normal(len(t)))
    if how == "memory":
        for i in range(1, len(white)):
            white[i] = 0.9 * white[i - 1] + np.sqrt(1 - 0.9**2) * white[i]
    return Trace("rods", t, phi + white, convention=Convention("down", 1, "rad"))


@pytest.fixture(scope="module")
def clean(ten):
    """Standard errors of clean traces: median of three."""
    return np.median([result.uncertainty.std_error for result in ten[:3]], axis=0)


@pytest.mark.check
@pytest.mark.parametrize(
    ("how", "kind", "wider"), [("unlike", "white", 3.0), ("memory", "correlated", 3.0), ("jitter", "jitter", 1.6)]
)
def test_the_noise_of_a_trace_is_named_and_measured_by_its_own_residuals(
    two, ready, fitted, motion, clean, how, kind, wider
):
    """Two draws of each: their errors cover, and are little larger than those of clean traces."""
    for seed in (30, 31):
        result = fitted(ready(spoiled(two, motion, seed, how)))
        noise = result.noise_table()
        assert result.status == "ok"
        assert noise["kind"] == kind
        assert not any("does not explain" in w for w in result.warnings)
        assert any("frame times have random errors" in w for w in result.warnings) == (how == "jitter")
        assert any("noise is correlated" in w for w in result.warnings) == (how == "memory")
        assert np.all(np.abs(result.values - two.TRUTH) < 3.5 * result.uncertainty.std_error)
        assert np.all(result.uncertainty.std_error < wider * clean)
        size = noise["sigma_rad"][0] / two.NOISE
        np.testing.assert_allclose(size, [1, 3] if how == "unlike" else [1, 1], rtol=0.3 if how == "memory" else 0.12)
        if how == "memory":
            np.testing.assert_allclose(noise["kept"], 0.9, atol=0.08)
        if how == "jitter":
            np.testing.assert_allclose(noise["delay_s"], 0.004, rtol=0.25)


@pytest.mark.check
def test_a_misfit_that_is_no_noise_is_not_taken_for_noise_and_widens_the_errors(two, ready, fitted, motion):
    """Without its quadratic part the law is wrong: misfits are smooth, the noise stays white, blocks give the error."""
    result = fitted(ready(two.seen(motion, 0, two.NOISE / 5)), frozen=np.array([False, True]))
    solution = result.solution
    white = np.sqrt(1 / solution.information[0, 0])
    assert result.noise_table()["kind"] == "white"
    assert result.uncertainty.blocks > 0
    assert result.uncertainty.std_error[0] > 2 * white
    # at least that of as many independent samples as the memory of the residuals leaves
    residual = solution.evaluation.residual[solution.windows.weight > 0]
    assert solution.problem.memory > 2
    assert result.uncertainty.std_error[0] > 0.99 * white * np.sqrt(solution.problem.memory * np.mean(residual**2))
    assert any("residuals are not noise" in w for w in result.warnings)


@pytest.mark.check
def test_a_clock_that_runs_late_is_found_together_with_the_damping(two, rods, fitted, motion, difference):
    """Frames 0.5 % further apart than the trace states; lengths and gravity are known."""
    trace = two.seen(motion, 4)
    late = replace(trace, t=trace.t / 1.005)
    prepared = prepare(late, rods, [*two.FREE, "clock.rate"], settings=two.SETTINGS, priors={"clock.rate": (1.0, 0.02)})
    result = fitted(prepared)
    assert result.status == "ok"
    error = result.uncertainty.std_error
    assert np.all(np.abs(result.values - [*two.TRUTH, 1.005]) < 3 * error)
    assert error[2] < 5e-4
    exact = prepared.simulator(result.values, result.solution.starts, result.windows).jacobian[..., -1]
    found = difference(result, "residual")
    np.testing.assert_allclose(found, exact, rtol=1e-5, atol=1e-5 * np.abs(exact).max())


@pytest.mark.check
@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (lambda trace: trace, None),
        (lambda trace: replace(trace, t=trace.t / 1.005), "rate of the clock"),
        (lambda trace: replace(trace, theta=trace.theta + [0.0, np.deg2rad(1.0)]), "marker of link 2"),
        (lambda trace: replace(trace, theta=trace.theta + np.deg2rad(2.0)), "roll of the camera"),
    ],
)
def test_a_systematic_error_of_a_trace_is_named_first(two, ready, motion, everything, damage, name):
    prepared = ready(damage(two.seen(motion, 6)))
    found = score_candidates(prepared, estimate(prepared, "windows"), everything(prepared))
    assert all(candidate.identifiable for candidate in found)
    if name is None:
        assert not any(candidate.worth_naming for candidate in found)
        return
    assert found[0].name == name
    assert found[0].worth_naming
    if name.startswith("rate"):  # angles of a chain that hangs freely hold no length and no force
        assert found[0].alike == ("scale of the rig", "gravity")
    if name.startswith("marker"):
        change, error = found[0].changes["marker.offset.1"], found[0].errors["marker.offset.1"]
        assert abs(change) == pytest.approx(np.deg2rad(1.0), abs=4 * error)


@pytest.mark.check
@pytest.mark.parametrize("gone", [156, 177])
def test_frames_that_are_missing_are_found_and_named(two, rods, motion, difference, gone):
    """Twelve frames left out, the times of the others closed up: 0.4 s that the clock does not show.

    Early and late in the window from 4.8 to 6 s.
    """
    trace = two.seen(motion, 6)
    theta = np.delete(trace.theta, slice(gone, gone + 12), axis=0)
    short = replace(trace, t=trace.t[: len(theta)], theta=theta)
    result = fit_and_free(short, rods, two.FREE, settings=two.SETTINGS, method="windows")
    (candidate,) = result.freed
    assert candidate.free == (f"clock.lost.0.{gone}",)
    assert candidate.name.startswith("12.0 lost frames")
    error = result.uncertainty.std_error
    assert result[f"clock.lost.0.{gone}"] == pytest.approx(12 / two.RATE, abs=3 * error[2])
    assert candidate.errors[f"clock.lost.0.{gone}"] == pytest.approx(error[2], rel=0.2)  # with the others free
    assert np.all(np.abs(result.values[:2] - two.TRUTH) < 3 * error[:2])
    exact = result.solution.problem.simulator(result.values, result.solution.starts, result.windows)
    for field, slope in (("residual", "jacobian"), ("end", "end_jacobian")):
        expected = getattr(exact, slope)[..., -1]
        np.testing.assert_allclose(difference(result, field), expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@pytest.mark.check
def test_systematic_errors_of_a_trace_are_freed_until_nothing_gains(two, rods, motion):
    trace = two.seen(motion, 6)
    late = replace(trace, t=trace.t / 1.005, theta=trace.theta + [0.0, np.deg2rad(1.0)])
    result = fit_and_free(late, rods, two.FREE, settings=two.SETTINGS, method="windows")
    assert {candidate.name.split(" or ")[0] for candidate in result.freed} == {"rate of the clock", "marker of link 2"}
    assert result["clock.rate"] == pytest.approx(1.005, abs=5e-4)
    assert np.all(np.abs(result.values[:2] - two.TRUTH) < 3 * result.uncertainty.std_error[:2])
    # a hanging chain does not distinguish the clock from gravity or size: the clock's own rate may as well be right
    error = dict(zip((p.name for p in result.parameters), result.uncertainty.std_error, strict=True))
    assert any(" or " in candidate.name for candidate in result.freed)
    assert error["clock.rate"] >= abs(result["clock.rate"] - 1)
    assert error["marker.offset.1"] < 0.2 * abs(result["marker.offset.1"])


@pytest.mark.check
def test_outliers_pull_a_fit_by_students_loss_less_and_are_named(two, ready, fitted, motion):
    """One sample in fifty is 0.1 to 0.3 rad off."""
    trace = two.seen(motion, 3)
    rng = np.random.default_rng(5)
    off = rng.random(trace.theta.shape) < 0.02
    theta = trace.theta + np.where(off, rng.uniform(0.1, 0.3, off.shape) * rng.choice([-1, 1], off.shape), 0.0)
    prepared = ready(replace(trace, theta=theta))
    plain, robust = fitted(prepared), fitted(prepared, "windows", StudentT())
    assert robust.status == "ok"
    error = robust.uncertainty.std_error
    assert np.all(np.abs(robust.values - two.TRUTH) < 3 * error)
    assert np.all(error < 0.5 * plain.uncertainty.std_error)
    (line,) = (line for line in robust.warnings if "stand out" in line)
    assert int(line.split()[0]) == pytest.approx(off.sum(), rel=0.2)
    named = re.search(r"link (\d) at ([\d.]+) s", line)
    assert off[np.argmin(np.abs(trace.t - float(named[2]))), int(named[1]) - 1]


@pytest.mark.check
def test_held_out_spans_are_scored_by_the_same_windows_however_the_fit_is_cut(rods, two, ready, motion):
    """Shorter windows of the fit alone must not lower the score; the span itself is cut where errors grow too far."""
    trace = two.seen(motion, 6)
    options = {"held_out": [(7.2, 9.6)], "simulator": ready(trace).simulator}
    sizes = two.SETTINGS, FitSettings(window=0.6)
    long, short = (prepare(trace, rods, two.FREE, settings=size, **options) for size in sizes)
    assert short.windows.length < long.windows.length
    assert window_length(short, (7.2, 9.6)) == window_length(long, (7.2, 9.6)) == pytest.approx(2.4)
    chaotic = replace(long, lyapunov=5.0)  # 12 e-folds over the span, of which a window's start bears 6
    assert window_length(chaotic, (7.2, 9.6)) == pytest.approx(1.2)


@pytest.fixture(scope="module")
def wrong_model(two, rods):
    """Rods with wrong inertias, a turned marker and no quadratic drag, seen sixty times a second with little noise."""
    t, phi = two.swing([1.2, 0.6], rate=60.0)
    noise = 2e-4 * np.random.default_rng(3).standard_normal(phi.shape)
    trace = Trace("rods", t, phi + noise + [0.0, 0.03], convention=Convention("down", 1, "rad"))
    scene = copy.deepcopy(rods)
    line = scene["line"][0]
    line["inertia"] = (np.array(line["inertia"]) * [0.9, 1.1]).tolist()
    line["centre_of_mass"] = (np.array(line["centre_of_mass"]) * [1.03, 0.97]).tolist()
    del scene["effects"]["quadratic_damping"]
    return trace, scene


@pytest.mark.check
def test_a_model_that_is_wrong_as_a_whole_is_freed_in_groups_that_halve_the_held_out_error(two, wrong_model):
    """Geometry and clock are right, and no sample is an outlier; nothing of the held-out end is seen by the choice."""
    trace, scene = wrong_model
    options = {"settings": two.SETTINGS, "method": "windows", "held_out": [(7.2, 9.6)]}
    plain = fit(trace, scene, two.FREE[:1], **options)
    freed = fit_and_free(trace, scene, two.FREE[:1], **options)
    names = [candidate.name.split(" (")[0] for candidate in freed.freed]
    assert {"markers", "inertia", "quadratic drag"} <= set(names)
    assert not any("outliers" in name for name in names)
    assert freed.held_out[0].windows.count == plain.held_out[0].windows.count
    assert freed.held_out[0].rms < 0.5 * plain.held_out[0].rms
    assert freed[two.FREE[1]] == pytest.approx(two.QUADRATIC, rel=0.1)


@pytest.mark.check
def test_two_errors_are_both_named_where_a_third_candidate_hides_them():
    """Wrong lengths and a rolled camera: the second end explains the poses at rest at the expense of the motion."""
    import spoilers as study

    _, trace = study.draw("lengths and roll", 16)
    result = fit_and_free(trace, study.scene(), study.FREE, settings=study.SETTINGS)
    assert result.status == "ok"
    names = {candidate.name.split(" (")[0] for candidate in result.freed}
    assert names == {"lengths of links", "roll of the camera"}
    assert np.all(np.abs(result.values[:2] - study.TRUTH) < 3 * result.uncertainty.std_error[:2])
    assert np.all(result.uncertainty.std_error[:2] < 0.02 * study.TRUTH)


def test_groups_try_lengths_before_the_end_that_they_can_replace():
    """The end cannot replace lengths: with lengths tried first, wrong lengths and a wrong end are distinguished."""
    model = build_model(dj.load_scene("dropper-release-a"))
    names = [group.name for group in fault_groups(model, [], [])]
    assert names.index("lengths of links") < names.index("position of the second end")


def test_a_candidate_that_gains_less_than_its_parameters_cost_is_not_tried():
    """It is neither freed nor refused by a fit, so that a search that went on with it would not end."""
    costly = Candidate("lengths of links", ("line.0.length",), {"a": 1.0}, {"a": 0.1}, gain=9.0, p=1e-4, worth=-6.0)
    cheap = replace(costly, name="rate of the clock", worth=4.0)
    assert costly.worth_naming
    assert promising([costly]) == []
    assert promising([costly, cheap]) == [cheap]
    assert promising([cheap], refused={cheap.name}) == []
