"""`dropper fit`: its JSON, its report and its exit codes."""

import json

import numpy as np
import pytest
from hard_scenes import rods

from dropper_jax import as_toml, load_scene
from fitting import Camera, observe, simulate_truth, write_trace
from fitting.cli.fit_options import read_spans

PENDULUM = rods([np.pi / 2], effects={"linear_damping": {"b_l": 0.1}, "quadratic_damping": {"b_q": 0.05}})
GUESS = {"weight": {}, "linear_damping": {"b_l": 1.0}, "quadratic_damping": {"b_q": 0.5}}
KEYS = {
    "schema", "status", "parameters", "correlation", "rms_rad", "held_out_rms_rad", "chi2_per_dof", "noise_rad",
    "iterations", "seconds", "warnings",
}  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fit")
    trace = observe(simulate_truth(PENDULUM, 20.0, 30.0), Camera(rate=30.0, angle_noise=0.005), 0)
    write_trace(folder / "run.csv", trace)
    (folder / "scene.toml").write_text(as_toml({**PENDULUM, "effects": GUESS}))
    return folder


@pytest.fixture
def call(files):
    """The command up to the options of a test."""
    return ["fit", str(files / "run.csv"), "--scene", str(files / "scene.toml")]


@pytest.mark.slow
def test_fit_prints_the_agreed_json_and_writes_the_report(files, call, printed):
    more = ["--until", "16", "--held-out", "16:20", "--report", str(files / "report"), "--json"]
    out, err = printed([*call, *more])
    found = json.loads(out)
    assert set(found) >= KEYS
    assert found["status"] == "ok"
    b_l = found["parameters"]["effects.linear_damping.b_l"]
    assert set(b_l) >= {"value", "std_error", "low", "high", "at_bound"}
    assert abs(b_l["value"] - 0.1) < 4 * b_l["std_error"]
    assert found["held_out_rms_rad"][0] == pytest.approx(0.005, rel=0.3)
    assert "100 %" in err
    text = (files / "report" / "report.md").read_text()
    assert "dry friction in the joints" in [test["name"] for test in found["laws"]]
    headings = "Parameters", "Tests of the law", "Errors along the trace", "Correlation", "What was not identifiable"
    for heading in headings:
        assert f"## {heading}" in text
    assert len(list((files / "report").glob("*.png"))) == 5
    fitted = load_scene(files / "report" / "fitted.toml")
    assert fitted.value("effects.linear_damping.b_l") == pytest.approx(b_l["value"], rel=1e-12)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--free", "b_x"], "'b_x' does not exist"),
        (["--free", "b_l,release.force"], "releases no node"),
        (["--window", "100"], "longer than the trace"),
        (["--dt", "3"], "dt: 3 s is longer than the sampling interval; allowed: at most 0.03333 s"),
        (["--held-out", "3-5"], "is not lo:hi"),
        (["--held-out", "30:40"], "has fewer than 3 measured frames"),
        (["--zero", "up"], "allowed: horizontal, down"),
        (["--unit", "deg"], "looks like radians"),
        (["--iterations", "0"], "--iterations: '0' is not a whole number >= 1"),
        (["--prior", "b_l=0.1+-0"], "has standard deviation 0; allowed: > 0"),
        (["--prior", "b_l=0.1"], "has no width; allowed: NAME=MEAN+-SD"),
        (["--prior", "b_x=1+-1"], "'b_x' does not exist"),
        (["--bounds", "b_l=3"], "is not a range; allowed: NAME=LOW:HIGH"),
        (["--bounds", "b_l=2:1"], "empty interval 2 to 1"),
        (["--bounds", "line.0.mass=1:2"], "'line.0.mass' is not a free parameter"),
        (["--start", "b_l=fast"], "is not a finite number; allowed: NAME=VALUE"),
        (["--start", "b_l"], "has no value"),
        (["--start", "b_l=-1"], "is out of bounds"),
        (["--start", "b_l=1", "--start", "b_l=2"], "'b_l' is given twice"),
        (["--bootstrap", "0"], "--bootstrap: '0' is not a whole number >= 1"),
        (["--huber", "2", "--student"], "argument --student: not allowed with argument --huber"),
        (["--from", "8", "--until", "3"], "--until: 3 is not after --from 8; allowed: > 8 s"),
        (["--bootstrap", "1"], "are too few; allowed: 0 or at least 2"),
        (["--method", "gradient", "--optimizer", "adm"], "optimizer: 'adm' is unknown; did you mean 'adam'"),
        (["--optimizer", "adam"], "optimizer: 'adam' is not a setting of method 'shooting'. Use method gradient"),
        (["--set", "run.solver=network"], "run.solver: 'network' cannot serve this fit: it is for systems of lines"),
    ],
)
def test_what_a_user_can_correct_is_one_line_and_exit_code_2(call, refused, more, words):
    assert words in refused([*call, "--quiet", *more])


def test_a_bootstrap_of_one_draw_is_refused_before_a_file_without_a_scene_is_read(refused):
    assert "bootstrap: 1 draws are too few" in refused(["fit", "no-such-file.csv", "--bootstrap", "1"])


def test_a_file_given_twice_is_not_counted_as_two_runs(call, refused):
    assert "run.csv' is given twice; allowed: every file once" in refused([call[0], call[1], *call[1:], "--quiet"])


@pytest.mark.check
@pytest.mark.slow
def test_a_gradient_fit_lists_its_descent_and_draws_it(files, call, json_of):
    options = ["--method", "gradient", "--optimizer", "adam", "--learning-rate", "0.4", "--steps", "80", "--until", "8"]
    found = json_of([*call, *options, "--fixed", "--report", str(files / "descent"), "--json"])
    assert abs(found["parameters"]["effects.linear_damping.b_l"]["value"] - 0.1) < 0.02
    loss = [point["loss"] for point in found["descent"]]
    assert loss[0] > 10 * loss[-1]
    assert loss[-1] == pytest.approx(1.0, abs=0.2)
    assert found["descent"][0]["values"] == [1.0, 0.5]
    weights = [point["gap_weight"] for point in found["descent"]]
    assert weights[0] is None
    assert weights[-1] == found["gap_weight"]
    assert "![descent](descent.png)" in (files / "descent" / "report.md").read_text()
    assert (files / "descent" / "descent.png").stat().st_size > 10_000


@pytest.mark.check
def test_intervals_by_profile_and_bootstrap_are_listed_with_the_errors_and_priors_hold(call, json_of):
    more = ["--method", "windows", "--start", "b_l=0.5", "--bounds", "b_l=:0.8", "--prior", "b_q=0.05+-1e-6"]
    found = json_of([*call, *more, "--profile", "b_l", "--bootstrap", "100", "--json"])
    b_l = found["parameters"]["effects.linear_damping.b_l"]
    assert found["parameters"]["effects.quadratic_damping.b_q"]["value"] == pytest.approx(0.05, abs=4e-6)
    assert list(found["profile"]) == ["effects.linear_damping.b_l"]
    profile = found["profile"]["effects.linear_damping.b_l"]
    assert [profile["low"], profile["high"]] == pytest.approx([b_l["low"], b_l["high"]], abs=0.3 * b_l["std_error"])
    spread = found["bootstrap"]["effects.linear_damping.b_l"]["std_error"]
    assert 0.4 < spread / b_l["std_error"] < 2.5
    assert found["noise"]["kind"] == "white"
    assert found["noise"]["sigma_rad"][0][0] == pytest.approx(0.005, rel=0.1)


@pytest.mark.check
def test_a_fit_that_does_not_converge_keeps_its_best_point_and_exits_with_3(files, call, json_of):
    more = ["--iterations", "1", "--method", "windows", "--report", str(files / "short"), "--json"]
    found = json_of([*call, *more], 3)
    assert found["status"] == "not_converged"
    best = found["parameters"]["effects.linear_damping.b_l"]
    assert np.isfinite(best["value"])
    assert best["std_error"] is best["low"] is best["high"] is None  # no error of a failed fit
    assert "best_determined" not in found
    row = next(row for row in (files / "short" / "report.md").read_text().splitlines() if "b_l" in row)
    assert row.count("| - ") == 3


def test_held_out_spans_are_read_in_order():
    assert read_spans("1:2,3.5:4") == [(1.0, 2.0), (3.5, 4.0)]
