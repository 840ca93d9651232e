"""A second run states the errors of a run, by the program of the first."""

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.cli import main
from dropper_jax.run import chaos, companion
from dropper_jax.run.companion import SCATTER, finer_values
from dropper_jax.run.stated_errors import errors_in_words

NAME = "conical-pendulum-damped"


@pytest.fixture(scope="module")
def fine():
    """The damped conical pendulum with steps a tenth of the packaged one."""
    return dj.simulate(NAME, dt=0.001, duration=15.0)


@pytest.fixture(scope="module")
def pendulum():
    """The same at 30 times its step, and with an accuracy, each with a companion."""
    coarse = dj.simulate(NAME, dt=0.3, duration=15.0, companion="coarser")
    return coarse, dj.simulate(NAME, accuracy=0.1, duration=15.0, companion="coarser")


def largest_distance(run, fine):
    rows = np.rint(run.t / 0.001).astype(int)
    apart = np.linalg.norm(run.positions - fine.positions[rows], axis=2).max(axis=1)
    travel = np.linalg.norm(np.ptp(fine.positions, axis=0), axis=1).max()
    return np.sqrt(np.mean(apart[1:] ** 2)) / travel


def test_a_pendulum_at_thirty_times_its_step_is_unusable(pendulum, fine):
    coarse, _ = pendulum
    assert coarse.status == "step_too_long"
    found = coarse.summary()["stated_errors"]
    assert found["companion"] == "a run with steps of 0.6 s"
    assert found["positions"] == pytest.approx(largest_distance(coarse, fine), rel=0.6)
    assert any(text.endswith("Use --accuracy 0.01 in place of --dt") for text in coarse.warnings)


def test_errors_of_a_run_with_an_accuracy_are_those_against_a_finer_one(pendulum, fine):
    _, run = pendulum
    assert run.status == "ok"
    found = run.settings["stated_errors"]
    assert found["companion"] == "a run with accuracy 0.4"
    true = largest_distance(run, fine)
    assert true < found["positions"] < 6.0 * true
    (row,) = found["lines"]
    assert abs(row["mean_n"] - fine.tension[1:].mean()) < row["mean_error_n"]


def test_a_run_at_the_coarsest_accuracies_has_a_finer_companion():
    """Four times 0.5 is coarser than any accuracy, and what is clipped at 1 is not four times as far off."""
    run = dj.simulate(NAME, accuracy=0.5, duration=5.0, companion="coarser")
    assert run.settings["stated_errors"]["companion"] == "a run with accuracy 0.12"


def test_a_finer_companion_states_the_error_that_a_coarser_one_covers(pendulum):
    coarser = pendulum[1].settings["stated_errors"]
    run = dj.simulate(NAME, accuracy=0.1, duration=15.0, companion="finer")
    finer = run.settings["stated_errors"]
    assert finer["companion"] == "a run with accuracy 0.025"
    assert SCATTER * finer["positions"] == pytest.approx(coarser["positions"], rel=0.5)
    assert finer["angles_rad"] == pytest.approx(coarser["angles_rad"], rel=0.5)


@pytest.mark.parametrize("settings", [{"accuracy": 0.01, "save_interval": 0.1}, {"dt": 0.1}])
def test_an_odd_number_of_saved_states_adds_no_error(settings):
    """A coarser companion ends before the last of them: the error is over the time that both cover."""
    errors = {}
    for saves in (4, 5):
        run = dj.simulate(NAME, duration=0.1 * saves, companion="coarser", **settings)
        assert len(run.t) == saves + 1
        errors[saves] = run.settings["stated_errors"]["lines"][0]
    for key in ("mean_error_n", "deviation_error_n", "maximum_error_n"):
        assert errors[5][key] == pytest.approx(errors[4][key], rel=0.02)


def test_the_angle_error_is_that_of_a_short_run_from_the_same_start():
    """Of half a period, 1 s, against steps a tenth as long; on a circle all windows are alike.

    With a quarter of the gravity all times are twice as long, and the angles are the same.
    """
    circle = dj.load_scene(NAME).with_values({"effects.linear_damping.b_l": 0.0})
    runs = {dt: dj.simulate(circle, dt=dt, duration=3.2, companion="coarser") for dt in (0.004, 0.04)}
    off = np.linalg.norm(runs[0.04].positions[1:26, 1] - runs[0.004].positions[10:251:10, 1], axis=1)  # link of 1 m
    stated = runs[0.04].settings["stated_errors"]["angles_rad"]
    assert stated == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.3)
    slow = circle.with_values(
        {"effects.weight.gravity": 0.25 * circle.gravity, "start.azimuth_rate": 0.5 * circle.start.azimuth_rate}
    )
    run = dj.simulate(slow, dt=0.08, duration=6.4, companion="coarser")
    assert run.settings["stated_errors"]["angles_rad"] == pytest.approx(stated, rel=1e-6)


@pytest.mark.parametrize("settings", [{"dt": 0.05}, {"accuracy": 0.1}])
def test_nothing_is_compiled_for_the_companion(settings, caplog):
    dj.simulate(NAME, duration=5.0, **settings)
    with jax.log_compiles():
        run = dj.simulate(NAME, duration=5.0, companion="coarser", **settings)
    assert not [record for record in caplog.records if "Finished XLA compilation" in record.getMessage()]
    assert "stated_errors" in run.settings


def test_runs_in_python_have_none_unless_asked_for():
    run = dj.simulate(NAME, duration=1.0)
    assert run.summary()["stated_errors"] is None
    with pytest.raises(dj.SceneError, match="companion: 'finest' is unknown; allowed: None, 'coarser', 'finer'"):
        dj.simulate(NAME, duration=1.0, companion="finest")


def test_an_interrupted_companion_leaves_the_run_complete(monkeypatch):
    def stop(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(companion, "state_errors", stop)
    run = dj.simulate(NAME, duration=1.0, companion="coarser")
    assert run.status == "ok"
    assert "stated_errors" not in run.settings


def test_a_slow_drift_is_no_chaos_and_a_sudden_one_is():
    t = np.linspace(0.0, 20.0, 2001)
    nodes = np.stack([np.sin(t), np.zeros_like(t), np.cos(t)], axis=-1)[:, None]
    assert chaos.start_of_chaos(0.02 * t, nodes) is None
    off = chaos.start_of_chaos(1e-6 * np.exp(0.7 * t), nodes)
    assert t[off] == pytest.approx(np.log(1e4) / 0.7, rel=0.01)
    assert chaos.start_of_chaos(1e-6 * np.exp(0.1 * t), nodes) is None


def test_one_saved_state_has_errors_and_shows_no_chaos():
    scene = dj.load_scene(NAME).with_values({"run.dt": 0.1, "run.duration": 0.5, "run.save_every": 10})
    run = dj.simulate(scene, companion="coarser")
    assert len(run.t) == 2
    assert run.settings["stated_errors"]["companion"] == "a run with steps of 0.05 s"
    finer = dj.simulate(scene.with_values(finer_values(scene.run)))
    assert chaos.time_of_divergence(run, finer) is None


def test_a_run_at_rest_has_no_error_of_positions(falling):
    run = dj.simulate({**falling(0.2, 0.01), "start": {"kind": "static"}}, companion="coarser")
    found = run.settings["stated_errors"]
    assert found["positions"] is None
    assert found["lines"][0]["mean_error_n"] < 1e-6 * found["lines"][0]["mean_n"]
    assert "of the travel" not in errors_in_words(found)


@pytest.mark.parametrize("option", [[], ["--no-companion"], ["--verify"]])
def test_the_command_states_errors_by_default(option, capsys):
    code = main(["run", NAME, "--dt", "0.3", "--duration", "15", *option])
    out, err = capsys.readouterr()
    assert code == (0 if option == ["--no-companion"] else 3)
    assert ("may be off by" in err) == (option != ["--no-companion"])
    assert ("from a run with steps of 0.15 s" in out) == (option == ["--verify"])
