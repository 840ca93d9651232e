"""Runs that go on from their files: two halves are the whole to the bit, and what cannot go on says so."""

import dataclasses

import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError, Solution
from dropper_jax.cli import main
from dropper_jax.quantities.variables import STEP_EXTREMES
from dropper_jax.run.quality_checks import with_quality_checks

ARRAYS = ("t", "t_tension", "positions", "velocities", "tension", "work", "kinetic")
PENDULUM = "conical-pendulum-damped"
#: A line that hangs and snaps taut, with its drag: steps that follow, work, a held end that moves.
ROPE = scene_of(
    {"top": [0.0, 0.0, 0.0], "load": free_at([0.85, 0, 0])},
    line_of("rope", "top", "load", 3, 0.3, mass=0.5, nodes="shared", axial={"law": "rope", "EA": 2e3, "damping": 5.0}),
    run={"dt": 0.02, "duration": 0.4, "accuracy": 0.01},
    effects={"weight": {}, "end_motion": {"point": "top", "amplitude": [0.05, 0.0, 0.0], "period": 0.5}},
    start={"kind": "points"},
)


def halves(scene, tmp_path, suffix, **settings):
    """The whole run, and its second half after the first one's file."""
    whole = dj.simulate(scene, **settings)
    first = dj.simulate(scene, **{**settings, "duration": 0.5 * whole.settings["duration"]})
    file = first.save(tmp_path / f"first{suffix}")
    return whole, first, Solution.load(file).continued()


@pytest.mark.parametrize(
    ("scene", "suffix", "settings"),
    [
        (PENDULUM, ".npz", {"dt": 0.01, "duration": 1.0}),
        pytest.param(PENDULUM, ".nc", {"dt": 0.01, "duration": 1.2, "save_every": 3}, marks=pytest.mark.check),
        (PENDULUM, ".nc", {"dt": 0.01, "duration": 0.62, "integrator": "tsit5"}),
        (ROPE, ".nc", {}),
        pytest.param("measured-double-pendulum", ".npz", {"dt": 0.01, "duration": 0.4}, marks=pytest.mark.check),
    ],
    ids=["equal", "every-third", "held-error", "following-accuracy", "sticking-joints"],
)
def test_two_halves_are_the_whole_to_the_bit(scene, suffix, settings, tmp_path):
    if suffix == ".nc":
        pytest.importorskip("h5netcdf")
    whole, first, second = halves(scene, tmp_path, suffix, **settings)
    assert whole.status == first.status == second.status == "ok"
    assert (whole.tension_max is not None) == ("save_every" in settings or scene is ROPE)
    extremes = STEP_EXTREMES if whole.tension_max is not None else ()
    for name in (*ARRAYS, *extremes):
        joined = np.concatenate([getattr(first, name), getattr(second, name)[1:]])
        np.testing.assert_array_equal(joined, getattr(whole, name), err_msg=name)
    assert first.settings["steps"] + second.settings["steps"] == whole.settings["steps"]
    assert set(second.last) == set(first.last)
    for name, values in whole.last.items():
        np.testing.assert_array_equal(second.last[name], values, err_msg=name)


def test_a_run_with_an_accuracy_from_an_earlier_version_continues():
    """Its carry had the state under `progress`, and the counts of steps apart from the controller."""
    first = dj.simulate(ROPE)
    earlier = {}
    for name, values in first.last.items():
        field = name.removeprefix("last_carry_")
        if field.startswith("control_") and field.removeprefix("control_") in ("refused", "shortest", "changed"):
            name = name.replace("control_", "")
        elif field != name and not field.startswith("control_"):
            name = f"last_carry_progress_{field}"
        earlier[name] = values
    assert "last_carry_progress_state_r" in earlier
    assert "last_carry_refused" in earlier
    again = dataclasses.replace(first, last=earlier).continued()
    np.testing.assert_array_equal(again.positions, first.continued().positions)


@pytest.fixture(scope="module")
def half():
    return dj.simulate(PENDULUM, dt=0.01, duration=0.5)


def test_times_that_float32_cannot_count_are_warned_of(half):
    early = dataclasses.replace(half, settings=half.settings | {"dtype": "float32"}, warnings=())
    late = dataclasses.replace(early, t=early.t + 1000.0)
    assert with_quality_checks(early).warnings == ()
    none = dataclasses.replace(late, t=late.t[:1], settings=late.settings | {"refused_steps": 6, "steps": 0})
    assert with_quality_checks(none).warnings == ()  # of a run whose first step failed
    (warning,) = with_quality_checks(late).warnings  # a number of 24 bits near 1000 is a multiple of 2^-14
    assert "near 1000 s to 6.1e-05 s: sums of steps of 0.01 s drift by up to 0.3%" in warning


def test_a_third_piece_with_a_step_of_its_own_counts_on(half):
    second = half.continued(0.1).continued(0.2, dt=0.005)
    np.testing.assert_allclose(second.t[[0, 1, -1]], [0.6, 0.605, 0.8], atol=1e-12)
    fine = dj.simulate(PENDULUM, dt=0.005, duration=0.8)
    assert np.abs(second.positions[-1] - fine.positions[-1]).max() < 1e-3  # errors of the coarser step


def test_a_run_with_an_accuracy_continues_with_other_saved_times_but_not_with_equal_steps():
    first = dj.simulate(PENDULUM, accuracy=0.001, duration=0.2, save_interval=0.1)
    second = first.continued(0.1, save_interval=0.05)
    np.testing.assert_allclose(second.t, [0.2, 0.25, 0.3], atol=1e-12)
    whole = dj.simulate(PENDULUM, accuracy=0.001, duration=0.3, save_interval=0.1)
    assert np.abs(second.positions[-1] - whole.positions[-1]).max() < 1e-4
    with pytest.raises(SceneError, match=r"was saved with accuracy 0\.001; allowed: one with steps of 0\.01 s"):
        first.continued(0.1, dt=0.01)


@pytest.mark.parametrize("steps", [{"dt": 0.01}, {"accuracy": 0.001}])
def test_an_interrupted_run_continues_to_its_end(steps):
    def stop(share, text):
        if text.startswith("t =") and share > 0.3:
            raise KeyboardInterrupt

    whole = dj.simulate(PENDULUM, **steps, duration=0.5)
    part = dj.simulate(PENDULUM, **steps, duration=0.5, progress=stop)
    rest = part.continued()
    assert part.status == "interrupted"
    assert 0.3 < part.t[-1] / whole.t[-1] < 0.6
    np.testing.assert_array_equal(part.positions, whole.positions[: len(part.t)])
    np.testing.assert_array_equal(rest.positions[-1], whole.positions[-1])
    assert rest.t[-1] == whole.t[-1]


def test_the_command_continues_with_or_without_its_scene(half, tmp_path, json_of):
    file = str(half.save(tmp_path / "first.npz"))
    for scene in ([], [PENDULUM]):
        argv = ["run", *scene, "--continue", file, "--duration", "0.1", "--dt", "0.01", "--quiet", "--json"]
        out = tmp_path / "second.npz"
        found = json_of([*argv, "--out", str(out), "--plot", str(tmp_path / "p.png")])
        assert (found["continued_from_s"], found["status"]) == (0.5, "ok")
        np.testing.assert_array_equal(Solution.load(out).positions, half.continued(0.1).positions)


def reported(half, tmp_path, printed, *argv, **last):
    run = dj.Solution(**{**vars(half), "last": {k: v for k, v in (half.last | last).items() if v is not None}})
    file = str(run.save(tmp_path / "edited.npz"))
    message = printed(["run", *argv, "--continue", file, "--quiet"], 2).err.strip()
    assert "\n" not in message
    return message


def test_what_cannot_continue_is_reported_in_one_line(half, tmp_path, printed):
    ask = lambda *argv, **last: reported(half, tmp_path, printed, *argv, **last)  # noqa: E731
    assert "lacks 'last_carry_state_v'" in ask(last_carry_state_v=None)
    assert "float64[2, 3]; allowed: float64[1, 3]" in ask(last_carry_state_r=np.zeros((2, 3)))
    assert "non-finite values in 'last_row_r'" in ask(last_row_r=np.full((1, 3), np.nan))
    assert "is of another scene" in ask("double-pendulum-chaotic")
    assert "differs from 'conical-pendulum-damped' in line.0" in ask("--set", "line.0.mass=0.7")
    assert "run.integrator" in ask("--integrator", "rk4")
    assert "shorter than the step" in ask("--duration", "0.001")
    assert "has no final state" in ask(**dict.fromkeys(half.last))
    assert main(["run", "--continue", str(tmp_path / "none.nc")]) == 2
    assert main(["run", "--quiet"]) == 2


def test_a_run_that_failed_does_not_continue(half):
    bad = {"step": 7, "time_s": 0.07, "residual": 1.0, "reason": "of a test"}
    failed = dataclasses.replace(half, status="not_converged", first_bad=bad)
    with pytest.raises(SceneError, match=r"the run to continue failed, not_converged: step 7"):
        failed.continued()


def test_a_continued_run_is_not_run_again_from_its_start(half):
    with pytest.raises(SceneError, match=r"rerun: this run continued another run at 0\.5 s"):
        half.continued(0.05).rerun()
