"""Steps that follow an accuracy: errors that go with it, peaks, extremes between saved times, files, refusals."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.evaluation.record import record
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.tension import line_tensions
from dropper_jax.plots.run import readable
from dropper_jax.run.summary import write_tensions
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import begin
from dropper_jax.stepping.step_record import StepRecord

#: The rope is taut for some 4 ms, within an interval of 20 ms.
CASE = {"period": 0.008, "dt": 0.02, "duration": 0.5}
#: What falls [kg], and the largest tension of its swing on the rope [N].
MASS = 100.0
PEAK = MASS * (2 * np.pi / 0.008 * np.sqrt(2 * 9.81 * 0.2 + (9.81 * 0.008 / (2 * np.pi)) ** 2) + 9.81)


def accepted_steps(stepper, model, start, intervals):
    """Lengths of the steps that follow an accuracy of 1 % over intervals of 20 ms."""
    find = jax.jit(partial(dj.step_lengths, stepper, intervals=intervals, most=2000))
    steps = find(model, start, dt=0.02, accuracy=0.01)
    return steps.length[: int(steps.ends[-1])]


def stiffened(model, stiffer):
    axial = replace(model.line.axial, EA=stiffer * model.line.axial.EA)
    return replace(model, lines=(replace(model.line, axial=axial),))


@pytest.fixture(scope="module")
def followed(falling):
    return dj.simulate(falling(**CASE, accuracy=0.01))


def test_the_interval_between_saved_times_is_not_reported_as_a_step(followed, tmp_path):
    facts = followed.summary()["step_facts"]
    assert facts["axial_period_s"] is not None
    assert facts["steps_per_axial_period"] is None
    head = write_tensions(followed, tmp_path / "tensions.csv").read_text().splitlines()[1]
    assert head.endswith("energy_momentum with accuracy 0.01")


@pytest.mark.parametrize("halvings", [0, 6])
def test_tensions_of_rigid_links_stay_smooth_where_a_given_step_is_another_one(halvings):
    model, start = dj.build("double-pendulum-chaotic")
    stepper = dj.make_stepper(model, halvings=halvings)
    dt = np.repeat([0.01, 0.004, 0.01], 20)
    run = jax.jit(lambda model: dj.integrate(stepper, model, start, dt, len(dt), warn=False)[1].tension)
    tension = np.asarray(run(model))
    for first in (20, 40):  # a sawtooth that a change of the step starts does not decay
        after = tension[first : first + 20]
        assert np.abs(np.diff(after, n=2, axis=0)).max() < 0.005 * after.max()


def test_a_snap_within_an_interval_has_its_peak_and_its_impulse(followed):
    assert followed.status == "ok"
    assert followed.warnings == ()
    assert followed.line_tensions()["rope"]["max"] == followed.tension_max.max()
    # momentum: the mean tensions hold what falls and turn it round
    dt = followed.settings["dt"]
    impulse = np.sum(followed.tension[1:, 0]) * dt
    change = MASS * (followed.velocities[-1, 1, 2] - followed.velocities[0, 1, 2])
    assert impulse == pytest.approx(MASS * 9.81 * followed.t[-1] + change, rel=1e-9)
    assert followed.energy_drift < 1e-9 * followed.energy_scale


def test_a_tenth_of_the_equal_steps_gives_a_better_peak(followed, falling):
    tried = followed.settings["steps"] + followed.settings["refused_steps"]
    assert followed.settings["refused_steps"] < 0.3 * followed.settings["steps"]
    even = dj.simulate(falling(**CASE | {"dt": 0.0005}))
    assert tried < 0.1 * (len(even.t) - 1)
    assert abs(even.tension.max() / PEAK - 1.0) > abs(followed.tension_max.max() / PEAK - 1.0)


def test_the_error_of_a_peak_is_within_the_accuracy(followed, falling):
    for run in (dj.simulate(falling(**CASE, accuracy=0.1)), followed):
        assert run.tension_max.max() == pytest.approx(PEAK, rel=run.settings["accuracy"])
        assert run.settings["shortest_steps"] == 0


def test_steps_of_the_shortest_length_are_counted(falling):
    run = dj.simulate(falling(**CASE, accuracy=1e-5))
    assert run.status == "ok"
    assert 0 < run.settings["shortest_steps"] < run.settings["steps"]
    assert run.summary()["shortest_steps"] == run.settings["shortest_steps"]


@pytest.fixture(scope="module")
def releases():
    """A released dropper of rigid links before it is chaotic, by accuracy; equal steps of 0.2 ms."""
    scene = dj.load_scene("dropper-release-a").with_values({"run.duration": 1.0, "run.dt": 0.02})
    fine = dj.simulate(scene, dt=0.0002, save_every=100)
    return fine, {accuracy: dj.simulate(scene, accuracy=accuracy) for accuracy in (1e-1, 1e-2, 1e-3)}


def test_positions_of_a_release_are_within_the_accuracy_and_converge_with_it(releases):
    fine, runs = releases
    travel = np.linalg.norm(np.ptp(fine.positions, axis=0), axis=-1).max()
    errors = []
    for accuracy, run in runs.items():
        np.testing.assert_allclose(run.t, fine.t, atol=1e-12)
        errors.append(np.linalg.norm(run.positions - fine.positions, axis=-1).max() / travel)
        assert errors[-1] < accuracy
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


def test_rejected_steps_leave_no_trace(falling):
    # what a run does is what equal steps of the lengths that it accepted do: state, works and all
    scene = falling(**CASE)
    scene["line"][0]["axial"]["damping"] = 50.0
    model, start = dj.build(scene)
    stepper = dj.make_stepper(model)
    run = dj.simulate(scene, accuracy=0.01)
    lengths = accepted_steps(stepper, model, start, 25)
    assert run.settings["refused_steps"] > 0
    assert len(lengths) == run.settings["steps"]
    last, _ = dj.integrate(stepper.plain, model, start, lengths, len(lengths))
    np.testing.assert_allclose(last.r, run.positions[-1, 1:], atol=1e-9)
    np.testing.assert_allclose(last.work, run.work[-1], atol=1e-8 * np.abs(run.work).max())
    assert np.abs(run.work[-1]).min() > 0.0


def test_a_change_of_the_step_leaves_no_alternating_tensions_in_rigid_links():
    # with the rates of the first steps tensions would alternate by 0.8 N for ever
    model, start = dj.build("dropper-release-a")
    stepper = dj.make_stepper(model).plain
    started, _ = dj.integrate(stepper, model, start, 0.01, 20)
    lengths = jnp.concatenate([jnp.full(1, 0.01), jnp.full(40, 1e-4)])
    _, run = jax.jit(partial(dj.integrate, stepper, steps=41))(model, started, dt=lengths)
    tension = np.asarray(run.tension[1:])
    saw = np.abs(tension[:-2] - 2.0 * tension[1:-1] + tension[2:]).max() / 4.0
    assert saw < 1e-3 * np.abs(tension).max()


def test_a_run_along_the_steps_of_a_release_is_the_same():
    run = dj.simulate("dropper-release-a", duration=0.4)
    model, start = dj.build("dropper-release-a")
    stepper = dj.make_stepper(model)
    lengths = accepted_steps(stepper, model, start, 20)
    assert len(lengths) == run.settings["steps"]
    last, _ = dj.integrate(stepper.plain, model, start, lengths, len(lengths))
    np.testing.assert_allclose(last.r, run.positions[-1, 1:-1], atol=1e-9)
    np.testing.assert_allclose(run.balance, run.balance[0], atol=1e-12 * run.energy_scale)


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
    assert run.tension_range[0].min() == followed.tension_min.min()
    summary = followed.summary()
    assert summary["tension_n"]["all"]["max"] == followed.tension_max.max()
    assert summary["accuracy"] == 0.01
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
        ({"accuracy": 0.0}, "run.accuracy: 0.0 is out of range"),
        ({"accuracy": -1.0}, "run.accuracy: -1.0 is out of range"),
        ({"accuracy": 1.5}, "run.accuracy: 1.5 is out of range"),
        ({"accuracy": float("nan")}, "run.accuracy"),
        ({"accuracy": 0.1, "save_every": 2}, "run.save_every: 2 counts equal steps, which run.accuracy excludes"),
    ],
)
def test_what_cannot_be_followed_is_refused(falling, run, words):
    with pytest.raises(dj.SceneError, match=words) as refused:
        dj.load_scene(falling(**CASE, **run))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("integrator", ["rattle", "theta_midpoint", "energy_momentum_4", "rk4"])
def test_schemes_without_a_known_error_are_refused(integrator, falling):
    scene = "dropper-release-a" if integrator == "rattle" else falling(**CASE)
    with pytest.raises(dj.SceneError, match=f"which integrator '{integrator}' has not. Use run.dt, energy_momentum"):
        dj.simulate(scene, integrator=integrator, accuracy=0.01)


def test_an_accuracy_below_rounding_is_not_reached_and_the_run_reports_it():
    found = dj.simulate("dropper-release-a", duration=0.05, accuracy=1e-13)
    assert found.settings["shortest_steps"] > 0.9 * found.settings["steps"]
    assert any("steps are as short as steps get" in text for text in found.warnings)
    held = dj.simulate("dropper-release-a", duration=0.05, accuracy=0.01)
    assert not any("as short as" in text for text in held.warnings)


def test_a_step_replaces_an_accuracy_and_an_accuracy_a_step():
    scene = dj.load_scene("dropper-release-a")
    assert (scene.run.accuracy, scene.run.dt, scene.run.step) == (0.01, None, 0.005)
    equal = scene.with_values({"run.dt": 0.01})
    assert (equal.run.accuracy, equal.run.dt, equal.run.interval) == (None, 0.01, 0.01)
    again = equal.with_values({"run.accuracy": 0.1})
    assert (again.run.accuracy, again.run.dt, again.run.step, again.run.interval) == (0.1, None, 0.01, 0.01)


def test_a_scheme_without_an_estimate_takes_the_equal_steps_of_the_source():
    scene = dj.load_scene("dropper-release-a").with_values({"run.integrator": "rattle"})
    assert (scene.run.accuracy, scene.run.dt) == (None, 0.005)


def test_a_scene_without_a_step_follows_an_accuracy_and_saves_some_hundred_states(falling):
    scene = falling(**CASE)
    del scene["run"]["dt"]
    run = dj.load_scene(scene).run
    assert run.accuracy == 0.01
    assert (run.interval, run.rows) == (0.005, 100)


@pytest.mark.check
@pytest.mark.slow
@pytest.mark.parametrize("checkpoint", [False, pytest.param(True, marks=pytest.mark.check)])
def test_a_run_along_the_steps_taken_is_the_same_and_has_derivatives_in_both_modes(
    followed, falling, checkpoint, both_modes
):
    model, start = dj.build(falling(**CASE))
    stepper = dj.make_stepper(model, track_work=False).plain
    lengths = accepted_steps(stepper, model, start, 25)
    assert len(lengths) == followed.settings["steps"]
    assert float(jnp.sum(lengths)) == pytest.approx(0.5, rel=1e-12)

    def height(stiffer):
        changed = stiffened(model, stiffer)
        return dj.integrate(stepper, changed, start, lengths, len(lengths), checkpoint=checkpoint)[0].r[0, 2]

    run = both_modes(height)
    z, reverse, forward = (float(np.squeeze(x)) for x in run(1.0))
    assert z == pytest.approx(followed.positions[-1, 1, 2], abs=1e-9)
    assert forward == pytest.approx(reverse, rel=1e-9)
    assert forward == pytest.approx(float(run(1 + 1e-6)[0] - run(1 - 1e-6)[0]) / 2e-6, rel=1e-4)


@pytest.mark.check
def test_a_run_that_finds_its_steps_in_one_program_is_the_same_and_has_derivatives(followed, falling):
    """The steps are held constant: derivatives are those of `integrate` along their lengths."""
    model, start = dj.build(falling(**CASE))
    stepper = dj.make_stepper(model, track_work=False)
    lengths = accepted_steps(stepper, model, start, 25)

    def together(stiffer):
        last, rows = dj.integrate(stepper, stiffened(model, stiffer), start, 0.02, 25, accuracy=0.01, most=2000)
        return last.r[0, 2], rows

    def along(stiffer):
        return dj.integrate(stepper.plain, stiffened(model, stiffer), start, lengths, len(lengths))[0].r[0, 2]

    (z, rows), slope = jax.jit(jax.value_and_grad(together, has_aux=True))(1.0)
    assert float(z) == pytest.approx(followed.positions[-1, 1, 2], abs=1e-9)
    assert float(slope) == pytest.approx(float(jax.jit(jax.jacfwd(along))(1.0)), rel=1e-9)
    np.testing.assert_allclose(rows.tension, followed.tension[1:], rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(rows.r[:, 0], followed.positions[1:, 1], atol=1e-9)
    assert int(rows.first_bad[-1]) == -1
    few = dj.integrate(stepper, model, start, 0.02, 25, accuracy=0.01, most=20)[1]
    assert int(few.first_bad[-1]) >= 0


@pytest.mark.check
def test_means_of_a_run_in_one_program_are_those_of_a_scheme_that_reports_tensions_late(falling):
    scene = falling(**CASE, accuracy=0.01, integrator="generalized_alpha")
    model, start = dj.build(scene)
    stepper = dj.make_stepper(model, "generalized_alpha")
    rows = dj.integrate(stepper, model, start, 0.02, 25, accuracy=0.01, most=2000)[1]
    run = dj.simulate(scene)
    np.testing.assert_allclose(rows.tension, run.tension[1:], rtol=1e-7, atol=1e-7 * np.max(run.tension))


def test_repeated_steps_that_are_far_too_long_are_divided(followed, falling):
    model, start = dj.build(falling(**CASE))
    stepper = dj.make_stepper(model, track_work=False)
    across = StepRecord.empty(model, 32)._replace(length=jnp.full(32, 0.02)).to_repeat()  # five times the snap
    carry = begin(stepper, model, start, follows=True, record=across)
    run = jax.jit(partial(advance, stepper, saves=25))
    after, rows = run(model, carry, jnp.asarray(0.02), accuracy=jnp.asarray(0.01))
    assert int(after.record.number) == 25
    assert int(rows.within.steps.max()) > 5
    assert int(rows.within.steps.min()) == 1
    np.testing.assert_allclose(rows.r[:, 0], followed.positions[1:, 1], atol=0.01 * 0.2)


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

    run = dj.simulate(table, accuracy=0.01)
    followed = three(run, run.tension_max, run.tension, run.tension_square)
    fine = equal(0.0003125)
    assert np.all(np.abs(followed / fine - 1.0) < [5e-3, 2e-2, 3.5e-2]), followed / fine - 1.0
    assert equal(0.005)[2] < 0.9 * fine[2]
