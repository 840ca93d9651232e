"""Steps that follow the snaps: peaks at coarse intervals, extremes between saved times, energy, files, refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.plots.run import readable
from dropper_jax.report.record import record
from dropper_jax.report.settings import Settings
from dropper_jax.report.tension import line_tensions

#: The rope is taut for some 4 ms, within an interval of 20 ms.
CASE = {"period": 0.008, "dt": 0.02, "duration": 0.5}


@pytest.fixture(scope="module")
def followed(falling):
    return dj.simulate(falling(**CASE, step_tolerance=0.02))


def test_a_snap_within_an_interval_has_its_peak_and_its_impulse(followed):
    speed, mass, omega = np.sqrt(2 * 9.81 * 0.2), 100.0, 2 * np.pi / 0.008
    peak = mass * omega * np.sqrt(speed**2 + (9.81 / omega) ** 2) + mass * 9.81
    assert followed.status == "ok"
    assert followed.warnings == ()
    assert followed.tension_max.max() == pytest.approx(peak, rel=0.01)
    assert followed.line_tensions()["rope"]["max"] == followed.tension_max.max()
    # momentum: the mean tensions hold what falls and turn it round
    dt = followed.settings["dt"]
    impulse = np.sum(followed.tension[1:, 0]) * dt
    change = mass * (followed.velocities[-1, 1, 2] - followed.velocities[0, 1, 2])
    assert impulse == pytest.approx(mass * 9.81 * followed.t[-1] + change, rel=1e-9)
    assert followed.energy_drift < 1e-9 * followed.energy_scale


def test_it_takes_many_fewer_steps_than_equal_ones_of_the_same_peak(followed, falling):
    assert followed.settings["steps"] + followed.settings["refused_steps"] < 400
    assert followed.settings["refused_steps"] < 0.3 * followed.settings["steps"]
    even = dj.simulate(falling(**CASE | {"dt": 0.00125}))
    assert abs(even.tension.max() / followed.tension_max.max() - 1.0) > 0.02


def test_extremes_and_squares_are_those_of_the_steps(followed):
    assert np.all(followed.tension_min <= followed.tension + 1e-9)
    assert np.all(followed.tension <= followed.tension_max + 1e-9)
    assert np.all(followed.tension**2 <= followed.tension_square * (1 + 1e-9) + 1e-9)
    np.testing.assert_allclose(np.diff(followed.t), 0.02, rtol=1e-12)


def test_a_report_has_the_extremes_and_deviations_of_the_steps(followed):
    part = record(followed)
    (line,) = line_tensions(part, Settings())
    assert line["max_n"][0] == line["largest"]["n"] == followed.tension_max[1:].max()
    mean = followed.tension[1:, 0].mean()
    assert line["std_n"][0] == pytest.approx(np.sqrt(followed.tension_square[1:, 0].mean() - mean**2), rel=1e-9)
    assert any("means over 0.02 s" in note for note in part.notes)


def test_pictures_and_summary_have_the_extremes(followed):
    run = readable(followed)
    assert run.max_tension.max() == followed.tension_max.max() > run.tension.max()
    assert run.min_tension.min() == followed.tension_min.min()
    summary = followed.summary()
    assert summary["tension_n"]["all"]["max"] == followed.tension_max.max()
    assert summary["step_tolerance"] == 0.02
    assert summary["refused_steps"] == followed.settings["refused_steps"] > 0
    assert followed.us_per_step == 1e6 * followed.run_s / (summary["steps"] + summary["refused_steps"])


@pytest.mark.parametrize("suffix", [".npz", ".nc"])
def test_files_keep_the_extremes_and_repeat_the_run(followed, tmp_path, suffix):
    again = dj.Solution.load(followed.save(tmp_path / f"run{suffix}"))
    for name in ("tension", "tension_min", "tension_max", "tension_square"):
        np.testing.assert_array_equal(getattr(again, name), getattr(followed, name))
    np.testing.assert_array_equal(again.rerun().tension_max, followed.tension_max)


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ({"step_tolerance": 0.0}, "run.step_tolerance: 0.0 is out of range"),
        ({"step_tolerance": -1.0}, "run.step_tolerance"),
        ({"step_tolerance": 0.1, "save_every": 2}, "run.save_every: 2 cannot be combined with run.step_tolerance"),
    ],
)
def test_what_cannot_be_followed_is_refused(falling, run, words):
    with pytest.raises(dj.SceneError, match=words):
        dj.load_scene(falling(**CASE, **run))


@pytest.mark.slow
@pytest.mark.parametrize("checkpoint", [False, pytest.param(True, marks=pytest.mark.check)])
def test_a_run_along_the_steps_taken_is_the_same_and_has_derivatives_in_both_modes(
    followed, falling, checkpoint, both_modes
):
    model, start = dj.build(falling(**CASE))
    stepper = dj.make_stepper(model, track_work=False).plain
    lengths, number = jax.jit(partial(dj.adaptive_step_lengths, stepper, intervals=25, most=2000))(
        model, start, dt=0.02, tolerance=0.02
    )
    number = int(number)
    assert number == followed.settings["steps"]
    assert float(jnp.sum(lengths[:number])) == pytest.approx(0.5, rel=1e-12)

    def height(stiffer):
        axial = replace(model.line.axial, EA=stiffer * model.line.axial.EA)
        changed = replace(model, lines=(replace(model.line, axial=axial),))
        return dj.integrate(stepper, changed, start, lengths[:number], number, checkpoint=checkpoint)[0].r[0, 2]

    run = both_modes(height)
    z, reverse, forward = (float(np.squeeze(x)) for x in run(1.0))
    assert z == pytest.approx(followed.positions[-1, 1, 2], abs=1e-9)
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert forward == pytest.approx(float(run(1 + 1e-6)[0] - run(1 - 1e-6)[0]) / 2e-6, rel=1e-4)


@pytest.mark.check
def test_window_maxima_of_a_chain_that_snaps_are_those_of_small_steps():
    # the chain of case 1, its top driven until it snaps: steps of 5 ms miss a fifth of the peaks
    values = {"line_type.chain.damping_ratio": 0.1}
    table = dj.load_scene("paper-case-1-table-6").with_values(values).to_dict()
    table.pop("buoy")
    table |= {"sea": {"depth": 30.0}, "start": {"kind": "static"}}
    table["point"][1] = {"name": "buoy", "position": [30.0, 0.0, -2.0]}
    table["line"][0]["axial"]["law"] = "damped_rope"
    table["effects"]["end_motion"] = {"point": "buoy", "amplitude": [1.0, 0.0, 1.5], "period": 8.0, "ramp": 8.0}
    table["run"] = {"dt": 0.02, "duration": 44.0, "integrator": "generalized_alpha"}

    def three(run, most, mean, square):
        late = run.t[1:] > 12.0
        mean = mean[1:, -1][late]
        windows = most[1:, -1][late].reshape(4, -1).max(axis=1)
        return np.array([mean.mean(), np.sqrt(square[1:, -1][late].mean() - mean.mean() ** 2), windows.mean()])

    def equal(dt):
        run = dj.simulate({**table, "run": {**table["run"], "dt": dt}})
        return three(run, run.tension, run.tension, run.tension**2)

    run = dj.simulate(table, step_tolerance=0.1)
    followed = three(run, run.tension_max, run.tension, run.tension_square)
    fine = equal(0.0003125)
    assert np.all(np.abs(followed / fine - 1.0) < [5e-3, 2e-2, 3.5e-2]), followed / fine - 1.0
    assert equal(0.005)[2] < 0.9 * fine[2]
