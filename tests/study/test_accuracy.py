"""Work-precision, advice, numerical damping and the choice of the step."""

import contextlib
import io
import json
import tomllib

import numpy as np
import pytest
from hard_scenes import chain

import dropper_jax as dj
from dropper_jax import load_scene
from dropper_jax.cli import main
from dropper_jax.modelling.build import build
from dropper_jax.stepping.stepper import make_stepper
from dropper_jax.study.accuracy import accuracy, advice
from dropper_jax.study.counted_work import evaluation_work, step_work
from dropper_jax.study.damping import numerical_damping
from dropper_jax.study.euler_claims import SINGLE_PENDULUM, euler_claims
from dropper_jax.study.march import march_with_accuracy
from dropper_jax.study.reference import instant_tension
from dropper_jax.study.schemes import Scheme, parse

SCENE = "dropper-release-a-undamped"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    path = tmp_path_factory.mktemp("accuracy") / "work.png"
    out = io.StringIO()
    arguments = ["accuracy", SCENE, "--integrators", "energy_momentum", "rattle", "theta:0.51", "rk4", "--span", "1.0"]
    with contextlib.redirect_stdout(out):
        code = main([*arguments, "--dts", *(str(2.0**-k) for k in range(6, 12)), "--quick", "--json", "--quiet",
                     "--plot", str(path)])  # fmt: skip
    return code, json.loads(out.getvalue()), path


@pytest.mark.check
def test_rows_have_the_contract_and_measured_orders_are_the_design_ones(report) -> None:
    code, found, path = report
    assert code == 0
    keys = {
        "integrator", "solver", "dtype", "dt", "rms_angle_error_rad", "rms_position_error_m", "energy_drift_j",
        "us_per_step", "wall_s_per_simulated_s", "status", "equivalent_linear_damping",
    }  # fmt: skip
    assert all(keys <= set(row) for row in found["rows"])
    assert abs(found["orders"]["energy_momentum"] - 2.0) < 0.1
    assert abs(found["orders"]["rattle"] - 2.0) < 0.1
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [item["scheme"] for item in found["refused"]] == ["rk4"]


@pytest.mark.check
def test_a_system_of_lines_is_measured_and_its_tensions_are_compared_at_one_time(one_line) -> None:
    """Tensions of generalised-alpha belong to two thirds of a step: compared elsewhere they were of first order."""
    kind = {"mass": 2.0, "diameter": 0.03, "law": "elastic", "EA": 4e3, "damping_ratio": 0.1}
    scene = one_line(4.0, 3, [0.0, 0.0, 0.0], [3.9, 0.0, 0.0], kind, {"weight": {}})
    scene["point"][1] = {"name": "b", "kind": "free", "position": [3.9, 0.0, 0.0], "mass": 3.0}
    scene = load_scene({**scene, "start": {"kind": "points"}, "run": {"dt": 0.002, "duration": 0.5}})
    found = accuracy(scene, [Scheme("generalized_alpha")], (2.0**-6, 2.0**-7), 0.5, extras=False)
    equal = [row for row in found["rows"] if row.get("accuracy") is None]
    coarse, fine = sorted(equal, key=lambda row: -row["dt"])
    assert [coarse["status"], fine["status"]] == ["ok", "ok"]
    assert abs(found["orders"]["generalized_alpha"] - 2.0) < 0.15
    assert 3.5 < coarse["rms_tension_error_n"] / fine["rms_tension_error_n"] < 4.5


@pytest.mark.check
def test_the_reference_is_a_hundred_times_better_than_what_it_measures(report) -> None:
    _, found, _ = report
    assert found["reference"]["independent"]
    resolved = [row["rms_angle_error_rad"] for row in found["rows"] if row["resolved"]]
    assert len(resolved) >= 10
    assert found["reference"]["error_estimate_rad"] < 1e-2 * min(resolved)


def test_advice_takes_the_run_of_least_counted_work_that_is_good_enough(report) -> None:
    rows = [row for row in report[1]["rows"] if row["status"] == "ok"]
    for item in advice(rows, (1e-1, 1e-2, 1e-9)):
        good = [row for row in rows if row["rms_angle_error_rad"] <= item["target_rad"]]
        assert item["found"] == bool(good)
        if good:
            least = min(row["operations_per_simulated_s"] for row in good)
            assert any(row["operations_per_simulated_s"] == least and row["dt"] == item["dt"] for row in good)
            assert item["margin"] >= 1.0


def test_advice_does_not_follow_the_load_of_the_machine(report) -> None:
    """Times up to ten times longer, at random, as on a busy machine or in a first run that compiles."""
    rng = np.random.default_rng(0)
    idle = [row for row in report[1]["rows"] if row["status"] == "ok"]
    busy = [
        row | {"wall_s_per_simulated_s": row["wall_s_per_simulated_s"] * factor}
        for row, factor in zip(idle, rng.uniform(1.0, 10.0, len(idle)), strict=True)
    ]
    chosen = [[(item["scheme"], item["dt"]) for item in advice(rows, (1e-1, 1e-2, 1e-3))] for rows in (idle, busy)]
    assert chosen[0] == chosen[1]


def test_counted_work_grows_with_steps_and_stages_and_with_a_dense_jacobian() -> None:
    model, s = dj.build("conical-pendulum")
    evaluation = evaluation_work(model, s)
    work = {
        name: step_work(model, dj.make_stepper(model, name, solver), evaluation)
        for name, solver in (("energy_momentum", "condensed"), ("energy_momentum_4", "condensed"), ("rattle", "dense"))
    }
    assert evaluation > 0.0
    assert work["energy_momentum_4"] == 5 * work["energy_momentum"]
    assert work["rattle"] == 4 * work["energy_momentum"]  # a column for each of 4 unknowns


def test_an_interrupted_comparison_keeps_its_rows(monkeypatch, capsys) -> None:
    """Rows are on standard error as they come; after Ctrl-C the exit code and status are those of a stopped run."""
    errors = ("rms_angle_error_rad", "rms_position_error_m", "rms_tension_error_n", "energy_drift_j")
    costs = ("us_per_step", "wall_s_per_simulated_s", "operations_per_simulated_s")
    row = {"label": "rattle", "integrator": "rattle", "gamma": None, "dtype": "float64", "solver": "condensed"}
    row |= {"dt": 0.01, "status": "ok", "resolved": False, **dict.fromkeys((*errors, *costs), 1.0)}

    def stop(*_):
        yield row
        raise KeyboardInterrupt

    monkeypatch.setattr("dropper_jax.study.accuracy.Comparison.rows", stop)
    assert main(["accuracy", SCENE, "--span", "1.0", "--dts", "0.015625", "--integrators", "rattle", "--json"]) == 130
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found["status"] == "interrupted"
    assert [kept["label"] for kept in found["rows"]] == ["rattle"]
    assert found["reference"]["horizon_s"] == 1.0
    assert "rattle" in printed.err


def test_failed_runs_have_no_numbers(report) -> None:
    failed = [row for row in report[1]["rows"] if row["status"] != "ok"]
    assert failed
    assert all(row["rms_angle_error_rad"] is None and row["us_per_step"] is None for row in failed)


def test_equivalent_damping_of_a_damped_run_is_its_coefficient() -> None:
    """The measure itself: implicit Euler's loss shrinks with the step, the conserving scheme's is nothing."""
    schemes = (Scheme("theta", 1.0), Scheme("energy_momentum"))
    rows = numerical_damping(schemes, (2.0**-8, 2.0**-9), duration=1.0)["rows"]
    implicit = [row["equivalent_linear_damping"] for row in rows if row["label"] == "theta 1"]
    assert implicit[0] > implicit[1] > 0.002  # both larger than what the thesis fitted to the water
    assert all(abs(row["equivalent_linear_damping"]) < 1e-9 for row in rows if row["label"] == "energy_momentum")


def test_the_path_of_a_motion_of_constant_speed_is_that_speed_squared_times_the_time() -> None:
    """The integral of |v|^2 includes the start, also for steps that follow an accuracy."""
    table = tomllib.loads(SINGLE_PENDULUM)
    table["effects"]["weight"]["gravity"] = 0.0
    table["start"] = {"kind": "angles", "zero": "down", "polar": [0.0], "polar_rate": [3.0]}
    model, s = build(load_scene(table), "float64")
    run = march_with_accuracy(make_stepper(model, "energy_momentum"), model, s, 0.25, 1e-3, 4).run
    np.testing.assert_allclose(run.path, 9.0 * 0.25 * np.arange(1, 5), rtol=1e-6)


def test_the_thesis_own_scheme_has_no_numerical_damping_at_its_own_step_because_it_fails() -> None:
    found = numerical_damping((Scheme("thesis_angles", 0.51),), (0.0065,), duration=3.0)["thesis"]
    assert found["status"] in ("non_finite", "not_converged")
    assert found["equivalent_linear_damping"] is None
    assert "no share" in found["text"]


@pytest.mark.check
def test_euler_schemes_behave_as_in_the_thesis_on_the_pendulums() -> None:
    assert all(row["holds"] for row in euler_claims(dts=(0.005,)))


def test_instant_tension_of_a_pendulum_is_weight_and_centripetal_force() -> None:
    """T = m g cos(theta) + m v^2 / L."""
    model, s = dj.build(chain("pendulum", [0.7], 2.0, polar_rate=[1.5]))
    found = instant_tension(model, np.asarray(s.r)[None], np.asarray(s.v)[None], np.zeros(1))[0, 0]
    np.testing.assert_allclose(found, 9.81 * np.cos(0.7) + 2.0 * 1.5**2, rtol=1e-12)


def test_schemes_are_named_with_their_weight() -> None:
    assert parse("theta:0.6") == Scheme("theta", 0.6)
    for text, message in (("thetta", "unknown"), ("theta:half", "not a number")):
        with pytest.raises(dj.SceneError, match=message):
            parse(text)
