"""Wrong trace files are named, refused or not `ok`; right ones are not. Free rods move as SciPy says (`conftest`)."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hard_scenes import single_line

import dropper_jax as dj
from dropper_jax import SceneError, build_model, load_scene
from dropper_jax.cli import main
from fitting import Camera, Convention, Method, Trace, fit, observe, prepare, simulate_truth, write_trace
from fitting.calibration import file_diagnosis
from fitting.calibration.file_diagnosis import name_wrong_file
from fitting.calibration.likely_cause import INTERPOLATED_FRACTION, driven_beginning, interpolated_fraction
from fitting.traces.conventions import settle_convention
from fitting.windows.rising_energy import refuse_rising_energy
from fitting.windows.short_windows import fit_short_windows, moving_pieces
from fitting.windows.wrong_files import refuse_wrong_file

pytestmark = pytest.mark.usefixtures("optimised")
HELD = single_line(
    [0.12, 0.1, 0.09, 0.11],
    0.03,
    {"kind": "static", "release_nodes": [2], "release_force": [[0.1, 0.0, 0.6]]},
    [0.2, 0.0, 0.0],
    {"weight": {}, "linear_damping": {"b_l": 0.02}, "quadratic_damping": {"b_q": 0.01}},
)
HELD["run"] = {"dt": 0.002, "duration": 4.0}


def column(trace, j, change):
    """The trace with one column changed."""
    theta = trace.theta.copy()
    theta[:, j] = change(theta[:, j])
    return replace(trace, theta=theta)


def relative(trace):
    return replace(trace, theta=np.diff(trace.theta, axis=1, prepend=0.0))


def with_mark(trace, mark):
    """Every 23rd sample of the second link replaced by a mark of missing samples."""
    theta = trace.theta.copy()
    theta[::23, 1] = mark
    return replace(trace, theta=theta)


def twice(trace):
    count = len(trace.t)
    return replace(trace, t=np.arange(2 * count) * trace.interval, theta=np.concatenate([trace.theta, trace.theta]))


@pytest.fixture(scope="module")
def scene():
    return load_scene(HELD)


@pytest.fixture(scope="module")
def held_motion(scene):
    return simulate_truth(scene, 4.0, 60.0, 20, "rattle_4")


@pytest.fixture(scope="module")
def held(held_motion):
    return observe(held_motion, Camera(angle_noise=0.004), 0, "run")


def fit_file(folder, trace, scene, capsys, *more):
    """Exit code and JSON of the default command."""
    (folder / "scene.toml").write_text(dj.as_toml(scene))
    file = write_trace(folder / f"{trace.name}.csv", trace)
    code = main(["fit", str(file), "--scene", str(folder / "scene.toml"), "--json", "--quiet", *more])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.check
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda trace: column(trace, 1, np.negative), "theta_2 has the wrong sign"),
        (lambda trace: column(trace, 2, lambda a: np.pi - a), "theta_3 is mirrored"),
        (lambda trace: column(trace, 0, lambda a: a + np.pi), "theta_1 is measured from the link's other end"),
        (lambda trace: replace(trace, theta=trace.theta[:, [0, 3, 2, 1]]), "theta_2 and theta_4 are swapped"),
        (lambda trace: replace(trace, theta=trace.theta[:, ::-1]), "columns are in the reverse order"),
        (relative, "angles are relative to the link before"),
        (lambda trace: replace(trace, theta=np.degrees(trace.theta)), "looks like degrees"),
        (lambda trace: with_mark(trace, -999.0), "theta_2: -999 in 11 rows"),
        (lambda trace: with_mark(trace, 0.0), "theta_2: 0 in 11 rows"),
        (lambda trace: column(trace, 3, lambda a: a + 0.4), "the zero of theta_4 is shifted by 0.4"),
        (lambda trace: column(trace, 3, lambda a: np.r_[a[:9], a[:-9]]), "theta_4 is 9 frames late"),
        (lambda trace: replace(trace, theta=trace.theta[::-1]), "time is reversed"),
        (lambda trace: replace(trace, t=trace.t[::-1], theta=trace.theta[::-1]), "decreases from row to row"),
        (twice, "two runs in one file"),
        (lambda trace: replace(twice(trace), t=np.tile(trace.t, 2)), "two runs in one file"),
    ],
)
def test_a_wrong_file_between_hooks_is_refused_or_named_by_its_mistake(tmp_path, held, capsys, damage, words):
    code, found = fit_file(tmp_path, damage(held), HELD, capsys)
    if code == 2:
        assert words in found["error"]
        advice = ("To correct it: ", "Use one file per run", "Reverse the rows", "Use --unit deg", "allowed: ")
        assert any(text in found["error"] for text in advice)
    else:  # frames that open no more than those of a rolled camera are fitted
        assert code == 3
        assert any(words in line for line in found["warnings"])


def test_two_links_between_hooks_are_refused_because_they_cannot_move(tmp_path, held, capsys):
    start = {**HELD["start"], "release_nodes": [1]}
    two = {**HELD, "line": [{**HELD["line"][0], "links": 2, "length": 0.2}], "start": start}
    code, found = fit_file(tmp_path, replace(held, theta=held.theta[:, [0, 3]]), two, capsys)
    assert code == 2
    assert "cannot move in their plane" in found["error"]
    assert "at least 3 links" in found["error"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"point.1.position.0": 0.33}, "the second hook is -0.13 m in x and "),
        ({"line.0.length": [0.12, 0.14, 0.09, 0.11]}, "wrong lengths (0.12"),
    ],
)
def test_frames_that_do_not_close_name_the_cause_and_the_option_that_tries_it(scene, held, changed, words):
    model = build_model(dj.load_scene(scene.with_values(changed)))
    with pytest.raises(SceneError) as error:
        refuse_wrong_file(held, model, Convention(), ["effects.linear_damping.b_l"])
    cause = str(error.value).split("likeliest cause: ")[1]
    assert words in cause
    option = cause.split("--free ")[1].split(",")
    assert option[0] == "b_l"
    (note,) = refuse_wrong_file(held, model, Convention(), option)
    assert "from the second hook" in note


def test_the_file_of_a_line_of_other_links_is_refused(scene, held):
    other = replace(held, theta=held.theta + np.array([0.0, 1.1, -0.9, 0.4]) * np.sin(np.arange(len(held.t)))[:, None])
    with pytest.raises(SceneError, match="likeliest cause: a line of other links"):
        refuse_wrong_file(other, build_model(dj.load_scene(scene)), Convention(), ["effects.linear_damping.b_l"])


@pytest.mark.parametrize("seed", range(4))
def test_a_right_file_with_gaps_outliers_and_a_still_start_is_not_named(scene, held_motion, seed):
    """At 60 and 30 Hz, counted from another time, 10 % of the samples missing and 2 % off by up to 0.5 rad."""
    camera = Camera(angle_noise=0.006, missing=0.1, outliers=0.02)
    trace = observe(held_motion, camera, seed, "right")
    trace = replace(trace, t=trace.t[:: 1 + seed % 2], theta=trace.theta[:: 1 + seed % 2])
    still = 60 // (1 + seed % 2)
    first = np.nanmedian(trace.theta[:3], axis=0) + 0.006 * np.random.default_rng(seed).standard_normal((still, 4))
    theta = np.concatenate([first, trace.theta])
    trace = replace(trace, t=17.3 + trace.interval * np.arange(len(theta)), theta=theta)
    model = build_model(dj.load_scene(scene))
    assert refuse_wrong_file(trace, model, Convention()) == []
    settled, _ = settle_convention(trace, model, Convention())
    refuse_rising_energy(settled, model, [(float(trace.t[0]), float(trace.t[-1]))], 0.6)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda trace: trace, None),
        # with the other one mirrored instead, the whole motion is: both close to the same chi-square
        (lambda trace: column(trace, 1, np.negative), " has the wrong sign"),
        pytest.param(
            lambda trace: replace(trace, theta=trace.theta[:, ::-1]),
            "theta_1 and theta_2 are swapped",
            marks=pytest.mark.check,
        ),
        (relative, "angles are relative to the link before"),
        pytest.param(
            lambda trace: column(trace, 1, lambda a: a + 0.5),
            "the zero of theta_2 is shifted by 0.",
            marks=pytest.mark.check,
        ),
        pytest.param(
            lambda trace: column(trace, 1, lambda a: np.r_[a[:5], a[:-5]]),
            "theta_2 is 5 frames late",
            marks=pytest.mark.check,
        ),
    ],
)
def test_short_windows_name_a_wrong_file_of_a_free_end(two, ready, motion, damage, words):
    prepared = ready(damage(two.seen(motion, 6)))
    found = name_wrong_file(prepared)
    assert words in found if words else found == ""


@pytest.mark.check
def test_columns_of_two_different_runs_are_not_explained_by_a_change_of_the_file(two, ready, motion):
    first, other = two.seen(motion, 6), two.seen(two.swing([0.4, -1.0]), 7)
    prepared = ready(column(first, 1, lambda _: other.theta[:, 1]))
    assert "likeliest cause: " in name_wrong_file(prepared)


@pytest.mark.check
def test_the_right_rig_with_errors_of_its_model_above_a_low_noise_is_not_called_another(two, ready, motion):
    """A smooth error of 1 mrad, an encoder's noise of 20 microrad: short windows miss the angles by many times that."""
    trace = two.seen(motion, 6, 2e-5)
    error = 1e-3 * np.sin(12 * trace.t)[:, None] * [1.0, -0.7]
    trace = replace(trace, theta=trace.theta + error, se=np.full_like(trace.theta, 2e-5))
    prepared = ready(trace)
    found = fit_short_windows(prepared, moving_pieces(prepared))
    given = float(np.median(found.chi2))
    assert given > file_diagnosis.WRONG_CHI_SQUARE
    assert found.part < file_diagnosis.OTHER_RIG_MISS
    assert name_wrong_file(prepared) == ""


@pytest.mark.parametrize("step", [0.0, 0.0016], ids=["clicked", "encoder"])
def test_readings_of_an_encoder_are_not_taken_for_interpolated_ones(step):
    """Every fifth frame is clicked; or readings in steps, of which many lie in a row too."""
    t = np.arange(2500) / 500
    theta = 1.2 * np.cos(5 * t)
    readings = step * np.round(theta / step) if step else np.interp(t, t[::5], theta[::5])
    found = interpolated_fraction(Trace("x", t, readings[:, None]))
    assert (found > INTERPOLATED_FRACTION) == (not step)


def test_a_beginning_that_a_hand_moves_is_named_by_the_time_of_the_clock(two, ready, motion):
    """The first 2 s of a trace whose clock starts at 5 s are shaken."""
    trace = two.seen(motion, 6)
    shaken = 0.3 * np.sin(25 * trace.t)[:, None] * (trace.t < 2.0)[:, None]
    prepared = ready(replace(trace, t=trace.t + 5.0, theta=trace.theta + shaken))
    first = moving_pieces(prepared)[0]
    found = driven_beginning(prepared, first.high - first.low)
    until = float(re.search(r"until ([\d.]+) s", found.words)[1])
    assert 6.5 < until < 8.0
    assert found.remedy == f"leave them out: --held-out 5:{until:.3g}"


@pytest.mark.check
def test_a_fit_of_a_wrong_file_is_not_ok_and_names_the_reason(two, rods, ready, motion, monkeypatch):
    trace = relative(two.seen(motion, 6))
    # by the simulator of the other tests, whose windows are compiled
    monkeypatch.setattr("fitting.calibration.fit.prepare", partial(prepare, simulator=ready(trace).simulator))
    result = fit(trace, rods, two.FREE, settings=two.SETTINGS, method=Method("windows", iterations=3))
    assert result.status != "ok"
    assert "angles are relative to the link before" in result.message
    assert result.wrong_file not in result.warnings  # it is the error line already
    assert "angles are relative" in result.to_json()["error"]


def test_the_energy_of_a_link_that_is_seen_only_after_the_fitted_samples_is_not_judged():
    chain = single_line([0.2, 0.2], 0.05, {"kind": "angles", "polar": [0.6, 0.6], "zero": "down"}, None)
    t = 0.02 * np.arange(400)
    theta = np.tile(0.5 * np.pi + 0.5 * np.cos(7 * t), (2, 1)).T
    theta[t < 6.0, 1] = np.nan
    refuse_rising_energy(Trace("late", t, theta), build_model(load_scene(chain)), [(0.0, 4.0)], 0.9)


@pytest.mark.parametrize(("amplitude", "refused"), [(0.004, False), (0.2, True)])
def test_a_gap_at_the_end_of_a_decay_is_no_second_run_unless_the_swing_is_large(amplitude, refused):
    """A link that swings by 0.6 rad at first, and after a gap by more than before it: by rounding, or a second run."""
    model = build_model(load_scene(single_line([0.2], 0.05, {"kind": "angles", "polar": [0.6], "zero": "down"}, None)))
    t = np.arange(0.0, 60.0, 0.01)
    size = np.where(t < 50.1, 0.6 * np.exp(-t / 9.0), amplitude)
    theta = 0.5 * np.pi + size * np.cos(np.sqrt(9.81 / 0.2) * t)
    kept = (t < 50.0) | (t > 50.2)
    trace = Trace("decay", t[kept], theta[kept][:, None])
    judge = partial(refuse_rising_energy, trace, model, [(0.0, 60.0)], 2 * np.pi * np.sqrt(0.2 / 9.81))
    if refused:
        with pytest.raises(SceneError, match="two runs in one file"):
            judge()
    else:
        judge()
