"""Steps that are too long: a run at half the step shows them, and needs no program of its own.

The lab dropper at 30 times its step is in `test_pieces.py`, whose program it takes.
"""

import time
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.cli import main
from dropper_jax.run import chunks, step_check


def warned(run):
    return [text for text in run.warnings if text.startswith("time step")]


@pytest.fixture(scope="module")
def pendulum():
    """The damped conical pendulum at its packaged step, and at 30 times it."""
    return {dt: dj.simulate("conical-pendulum-damped", dt=dt, duration=15.0, step_check=True) for dt in (0.01, 0.3)}


def test_a_pendulum_at_thirty_times_its_step_is_warned_of(pendulum):
    fine, coarse = pendulum[0.01], pendulum[0.3]
    assert (fine.status, coarse.status) == ("ok", "step_too_long")
    (text,) = warned(coarse)
    assert "mean tensions" in text
    assert "positions" in text
    found = coarse.summary()["step_check"]
    true = coarse.tension[1:].mean() / fine.tension[1:].mean() - 1.0
    assert found["mean_tension"] == pytest.approx(abs(true), rel=0.5)
    apart = np.linalg.norm(coarse.positions - fine.positions[::30], axis=2).max(axis=1)
    travel = np.linalg.norm(np.ptp(fine.positions, axis=0), axis=1).max()
    assert found["positions"] == pytest.approx(np.sqrt(np.mean(apart[1:] ** 2)) / travel, rel=0.5)


def test_the_advised_step_has_an_error_of_about_a_percent(pendulum):
    advised = pendulum[0.3].summary()["step_check"]["dt_for_1_percent_s"]
    run = dj.simulate("conical-pendulum-damped", dt=advised, duration=15.0, step_check=True)
    assert not warned(run)
    assert max(run.settings["step_check"][name] for name in step_check.WARNED) < 0.02


def test_the_packaged_step_is_not_warned_of(pendulum):
    assert not warned(pendulum[0.01])
    assert max(pendulum[0.01].settings["step_check"][name] for name in step_check.WARNED) < 0.002


def test_the_angle_error_is_that_of_a_short_run_from_the_same_start():
    """Of half a period, 1 s, against steps a tenth as long; on a circle all stretches are alike."""
    circle = dj.load_scene("conical-pendulum-damped").with_values({"effects.linear_damping.b_l": 0.0})
    found = {dt: dj.simulate(circle, dt=dt, duration=3.2, step_check=True) for dt in (0.004, 0.04, 0.08)}
    stated = {dt: run.settings["step_check"]["angles_rad"] for dt, run in found.items()}
    off = np.linalg.norm(found[0.04].positions[1:26, 1] - found[0.004].positions[10:251:10, 1], axis=1)  # link of 1 m
    assert stated[0.04] == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.3)
    assert stated[0.08] == pytest.approx(4.0 * stated[0.04], rel=0.3)


@pytest.mark.parametrize("dt", [0.01, 0.3])
def test_stretches_of_a_long_run_find_the_same(pendulum, monkeypatch, dt):
    monkeypatch.setattr(step_check, "WHOLE_RUN_WORK", 0)
    run = dj.simulate("conical-pendulum-damped", dt=dt, duration=15.0, step_check=True)
    assert "stretches" in run.settings["step_check"]["repeated"]
    assert bool(warned(run)) == bool(warned(pendulum[dt]))


def test_stretches_warn_of_maxima_that_last_a_step(monkeypatch):
    """At 20 times its packaged step the lab dropper's largest tension belongs to one step."""
    monkeypatch.setattr(step_check, "WHOLE_RUN_WORK", 0)
    run = dj.simulate("dropper-release-a", dt=0.1, duration=10.0, step_check=True)
    assert any("lasts only one or two steps" in text for text in run.warnings)
    (text,) = warned(run)
    assert "largest tensions" in text


@pytest.mark.parametrize("whole_run_work", [0, step_check.WHOLE_RUN_WORK])
def test_the_verdict_does_not_depend_on_the_time_that_a_run_takes(monkeypatch, whole_run_work):
    """Chunks of a save each, and start-up and chunks that take no time, as from a warm cache."""
    monkeypatch.setattr(step_check, "WHOLE_RUN_WORK", whole_run_work)
    found = []
    for seconds, clock in ((0.0, time.perf_counter), (1e9, lambda: 0.0)):
        monkeypatch.setattr(chunks, "SECONDS", seconds)
        monkeypatch.setattr(chunks.time, "perf_counter", clock)
        run = dj.simulate("conical-pendulum-damped", dt=0.3, duration=60.0, step_check=True)
        found.append((run.status, run.warnings, run.settings["step_check"]))
    assert found[0] == found[1]


def test_a_farm_is_repeated_completely():
    """Its stretches show 1.3 % where its maxima are off by 30 %: 92 links and 6000 steps."""
    line = SimpleNamespace(links=92)
    farm = SimpleNamespace(lines=[line], run=SimpleNamespace(steps=6000, saves=6000))
    assert step_check.stretch_starts(farm) == []
    longer = SimpleNamespace(lines=[line], run=SimpleNamespace(steps=60000, saves=60000))
    assert len(step_check.stretch_starts(longer)) == step_check.REPEATED_STRETCHES


def test_simulate_warns_of_an_unusable_step_without_being_asked(pendulum):
    run = dj.simulate("conical-pendulum-damped", dt=0.3, duration=15.0)
    assert run.status == "ok"
    assert warned(run) == warned(pendulum[0.3])
    assert not warned(dj.simulate("conical-pendulum-damped", dt=0.3, duration=15.0, step_check=False))


def test_stretches_take_their_share_of_the_steps(monkeypatch):
    taken = []
    advance_at_half_step = chunks._EqualSteps.advance_at_half_step

    def counted(self, carry, saves):
        taken.append(2 * saves)
        return advance_at_half_step(self, carry, saves)

    monkeypatch.setattr(chunks._EqualSteps, "advance_at_half_step", counted)
    monkeypatch.setattr(step_check, "WHOLE_RUN_WORK", 0)
    dj.simulate("conical-pendulum-damped", duration=20.0, step_check=True)
    assert len(taken) == step_check.REPEATED_STRETCHES
    assert sum(taken) <= step_check.REPEATED_SHARE * 2000


@pytest.mark.parametrize("whole_run_work", [0, step_check.WHOLE_RUN_WORK])
def test_nothing_is_compiled_for_the_check(pendulum, monkeypatch, whole_run_work):
    monkeypatch.setattr(step_check, "WHOLE_RUN_WORK", whole_run_work)
    dj.simulate("conical-pendulum-damped", duration=15.0, step_check=False)
    compiled = []

    def note(event, _, **__):
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    run = dj.simulate("conical-pendulum-damped", duration=15.0, step_check=True)
    jax.monitoring.unregister_event_duration_listener(note)
    assert "step_check" in run.settings
    assert not compiled


def test_a_run_without_the_check_has_the_same_numbers(pendulum):
    run = dj.simulate("conical-pendulum-damped", duration=15.0, step_check=False)
    assert run.summary()["step_check"] is None
    np.testing.assert_array_equal(run.positions, pendulum[0.01].positions)


def test_a_stop_during_the_check_leaves_the_run_complete(pendulum, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(step_check, "check_full_run", stop)
    run = dj.simulate("conical-pendulum-damped", duration=15.0, step_check=True)
    assert run.status == "ok"
    assert "step_check" not in run.settings


def test_chaos_is_not_taken_for_a_long_step():
    """Two distances that reach 30 % of the travel: by a phase that drifts, and by chaos."""
    t = np.linspace(0.0, 20.0, 2001)
    nodes = np.stack([np.sin(t), 0 * t, 0 * t], axis=-1)[:, None]
    assert step_check._chaos(0.02 * t, nodes) is None
    chaotic = step_check._chaos(1e-6 * np.exp(0.7 * t), nodes)
    assert chaotic is not None
    assert t[chaotic] == pytest.approx(np.log(1e4) / 0.7, abs=0.02)
    assert step_check._chaos(1e-6 * np.exp(0.1 * t), nodes) is None


@pytest.mark.parametrize(("dt", "unresolved"), [(0.02, True), (0.002, False)])
def test_maxima_of_a_snap_within_a_step_longer_than_the_axial_period_are_unresolved(dt, unresolved):
    """A link of 4 m, 20 kg and 20 MN: its axial period is `pi sqrt(L m/EA)` = 6.3 ms."""
    line = SimpleNamespace(length=np.array([4.0]), mass=np.array([20.0]), EA=np.array([2e7]), rigid=False)
    scene = SimpleNamespace(lines=[line])
    settings = {"dt": dt, "save_every": 1, "integrator": "energy_momentum"}
    solution = SimpleNamespace(scene=scene, settings=settings)
    same = {"mean_tension": 0.0, "window_maxima": 0.0}  # the run at half the step misses the peak as well
    snap, rising = (SimpleNamespace(tension=np.array(rows)[:, None]) for rows in ([0, 900, 0], [0, 9, 300, 900]))
    found = {**step_check._with_peaks(solution, snap, same), "positions": 0.0, "repeated": step_check.FULL_RUN}
    assert step_check.is_warned(found, "window_maxima") == unresolved
    assert step_check._advise_step(solution, found) == (0.00063 if unresolved else dt)  # a tenth of the period
    assert step_check._with_peaks(solution, rising, same)["window_maxima"] == 0.0
    line.EA = None  # a rigid link
    assert step_check._with_peaks(solution, snap, same)["snap_period_s"] is None


def test_a_wrong_path_in_stretches_leaves_the_mean_unknown():
    """A stretch starts from a state of the run, so it does not show what the path before it did to the mean."""
    found = {"repeated": "32 stretches of 3 steps", "mean_tension": 0.008, "window_maxima": 0.0, "chaotic_from_s": None}
    assert step_check.is_warned({**found, "positions": 0.15}, "mean_tension")
    assert "mean tensions are off by at least 0.8 %" in step_check.step_words({**found, "positions": 0.15})
    assert not step_check.is_warned({**found, "positions": 0.05}, "mean_tension")
    assert not step_check.is_warned({**found, "positions": 0.15, "repeated": step_check.FULL_RUN}, "mean_tension")


def test_a_run_at_rest_is_not_warned_of(falling):
    run = dj.simulate({**falling(0.2, 0.01), "start": {"kind": "static"}}, step_check=True)
    assert not warned(run)
    assert run.settings["step_check"]["positions"] is None
    assert run.summary()["step_check"]["mean_tension"] < 1e-6


@pytest.mark.parametrize("option", [[], ["--no-step-check"]])
def test_the_command_checks_its_step_by_default(option, capsys):
    code = main(["run", "conical-pendulum-damped", "--dt", "0.3", "--duration", "15", *option])
    assert code == (0 if option else 3)  # 12 % off, if that is looked at
    assert ("0.3 s is too long" in capsys.readouterr().err) == (not option)
