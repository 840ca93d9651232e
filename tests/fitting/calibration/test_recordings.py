"""Several recordings of one motion: their biases, what they disagree about, and the command. Truth by SciPy."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hard_scenes import rods
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax.cli import main
from fitting import Convention, FitSettings, Trace, fit
from fitting.parameters.recording_delay import convention_distance, find_delay
from fitting.parameters.recordings import merge_recordings
from fitting.report.report import write_report
from fitting.traces.conventions import settle_convention

LENGTH, MASS, G, B_L = (0.10, 0.08), (0.030, 0.020), 9.81, 0.002
SETTINGS = FitSettings(same_motion=True)
SCENE = rods([0.9, -0.6], list(LENGTH), list(MASS), {"linear_damping": {"b_l": 0.001}})
SCENE["run"] = {"dt": 0.002, "duration": 5.0}


def rates(t, state):
    """Two point masses on rods, with drag b_l v of each, angles from straight down."""
    a, b, u, v = state
    (l1, l2), (m1, m2) = LENGTH, MASS
    c, s = np.cos(a - b), np.sin(a - b)
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2 * c], [m2 * l1 * l2 * c, m2 * l2**2]])
    first = l1 * u * np.array([np.cos(a), np.sin(a)])
    second = first + l2 * v * np.array([np.cos(b), np.sin(b)])
    force = [
        -m2 * l1 * l2 * s * v**2
        - (m1 + m2) * G * l1 * np.sin(a)
        - B_L * l1 * (first + second) @ [np.cos(a), np.sin(a)],
        m2 * l1 * l2 * s * u**2 - m2 * G * l2 * np.sin(b) - B_L * l2 * second @ [np.cos(b), np.sin(b)],
    ]
    return [u, v, *np.linalg.solve(mass, force)]


@pytest.fixture(scope="module")
def motion():
    """Angles (2,) from straight down as a function of time."""
    solved = solve_ivp(rates, (0, 7), [0.9, -0.6, 0, 0], dense_output=True, rtol=1e-10, atol=1e-12).sol
    return lambda t: solved(t)[:2].T


def recorded(motion, name="A", rate=100, span=(0.0, 4.0), noise=0.003, seed=0, zero=(0, 0), scale=1.0, delay=0.0):
    t = np.arange(*span, 1 / rate)
    theta = zero + scale * motion(t) + noise * np.random.default_rng(seed).standard_normal((len(t), 2))
    return Trace(name, t + delay, theta, convention=Convention("down", 1, "rad"))


def biased(motion):
    """A slower and noisier recording that starts later, ends later, and has biases."""
    return recorded(motion, "B", 60, (1.0, 6.0), 0.006, 1, (0.02, -0.03), 1.01, 1.2371)


#: Of the biased recording, in the model's convention: from the horizontal, positive downwards.
TRUTH = {"zero.0": -0.02, "zero.1": 0.03, "scale": 1.01, "delay": 1.2371}


def deviations(result):
    """Estimates minus truth, in standard errors, by name."""
    truth = {f"recording.B.{key}": value for key, value in TRUTH.items()} | {"effects.linear_damping.b_l": B_L}
    errors = result.uncertainty.std_error
    return {p.name: (result[p.name] - truth[p.name]) / e for p, e in zip(result.parameters, errors, strict=True)}


@pytest.fixture(scope="module")
def fitted(motion):
    """`fitted(*recordings)`: their fit as one motion."""
    return lambda *recordings: fit(recordings, SCENE, ["b_l"], settings=SETTINGS)


@pytest.mark.check
def test_biases_and_noise_of_a_second_recording_are_found_within_their_errors_and_none_disagrees(motion, fitted):
    found = fitted(recorded(motion), biased(motion))
    assert found.status == "ok", found.message
    off = deviations(found)
    assert len(off) == 5
    assert max(map(abs, off.values())) < 3, off
    assert found.uncertainty.std_error[-1] < 1e-4  # of the delay, a hundredth of its sampling interval
    noise = {(row.recording, row.link): row.noise for row in found.recordings}
    assert noise["A", 1] == pytest.approx(0.003, rel=0.15)
    assert noise["B", 2] == pytest.approx(0.006, rel=0.15)
    assert not any(row.disagrees for row in found.recordings)
    assert [row["recording"] for row in found.to_json()["recordings"]] == ["A", "A", "B", "B"]


@pytest.mark.check
def test_a_link_that_only_one_recording_shows_is_fitted_from_it(motion, fitted):
    first = recorded(motion)
    first.theta[:, 1] = np.nan
    found = fitted(first, biased(motion))
    assert found.status == "ok", found.message
    assert max(map(abs, deviations(found).values())) < 3
    assert any("A: shows nothing of link 2" in warning for warning in found.warnings)


@pytest.mark.check
def test_the_table_names_the_recording_and_the_time_that_disagree(motion, fitted):
    slipped = recorded(motion, "B", span=(0.0, 5.0), seed=1)
    slipped.theta[slipped.t > 4.0, 1] += 0.03
    found = fitted(recorded(motion, span=(0.0, 5.0)), slipped, recorded(motion, "C", 50, (0.0, 5.0), seed=2))
    worst = max(found.recordings, key=lambda row: abs(row.mean) / row.std_error)
    assert (worst.recording, worst.link) == ("B", 2)
    assert any(warning.startswith("B disagrees") for warning in found.warnings)


def test_the_delay_is_found_before_any_fit_and_another_period_is_named(motion):
    first = recorded(motion).in_model_convention(Convention("down", 1, "rad"))
    second = biased(motion).in_model_convention(Convention("down", 1, "rad"))
    assert find_delay(first, second).value == pytest.approx(1.2371, abs=2e-3)
    t = np.arange(0, 20, 0.01)
    swing = Trace("swing", t, np.pi / 2 + 0.3 * np.sin(2 * np.pi * t)[:, None])
    again = find_delay(swing, replace(swing, name="again", t=t + 0.2))
    assert again.value == pytest.approx(0.2, abs=1e-3)  # the smallest of 0.2, 1.2, -0.8 ...
    assert any(abs(other - 1.2) < 0.02 for other in again.alike)
    chosen = merge_recordings([swing, replace(swing, name="again", t=t + 0.2)], {"recording.again.delay": 1.21})
    assert chosen.parameters[-1].value == pytest.approx(1.2, abs=1e-3)


def test_the_delay_of_a_recording_much_longer_than_the_first_is_found():
    t = np.arange(0.0, 60.0, 0.01)
    whole = Trace("whole", t, np.pi / 2 + 0.3 * np.sin(2 * np.pi * t + 0.1 * t**2)[:, None])
    first = Trace("first", t[:500], whole.theta[3000:3500])
    assert find_delay(first, whole).value == pytest.approx(30.0, abs=5e-3)


def test_recordings_at_rest_fit_at_any_delay():
    t = np.arange(0.0, 5.0, 0.01)
    rest = Trace("rest", t, np.full((len(t), 1), np.pi / 2))
    assert find_delay(rest, replace(rest, name="again")).misfit == 0.0


@pytest.mark.parametrize("sign", [1, -1])
def test_the_sign_of_a_recording_that_starts_within_the_swing_is_that_of_the_first_one(motion, sign):
    """A hanging chain has no sign of its own: a file that states none is read as the first recording shows it."""
    model, _ = dj.build(SCENE)
    first = recorded(motion).in_model_convention(Convention("down", 1, "rad"))
    second = biased(motion)
    for begin in (1.5, 1.8, 2.1, 2.4):
        kept = second.t > begin
        later = Trace("B", second.t[kept], sign * second.theta[kept])
        found, warnings = settle_convention(later, model, Convention(), partial(convention_distance, first))
        assert (found.convention.zero, found.convention.sign) == ("down", sign)
        assert any("inferred from the first recording" in warning for warning in warnings)


def test_wrong_recordings_are_refused_in_one_line(motion, refusal):
    first, both = recorded(motion), [recorded(motion), biased(motion)]
    assert "one recording; needed: two" in refusal(fit, [first], SCENE, ["b_l"], settings=SETTINGS)
    assert "same name" in refusal(merge_recordings, [first, first], {})
    static = refusal(fit, both, SCENE, ["b_l", "release.time"], settings=SETTINGS)
    assert "cannot be combined with a static start" in static
    assert "Use --same-motion" in refusal(fit, both, SCENE, ["b_l", "recording.B.delay"])
    unknown = refusal(fit, both, SCENE, ["b_l", "recording.B.offset"], settings=SETTINGS)
    assert re.search(r"recording\.B\.offset.*does not exist", unknown)


@pytest.mark.check
@pytest.mark.slow
def test_a_report_shows_recordings_that_miss_a_link_and_frames_of_the_same_times(motion, fitted, tmp_path):
    first = recorded(motion)
    second = recorded(motion, "B", seed=1)
    theta = second.theta.copy()
    theta[:, 1] = np.nan
    result = fitted(first, replace(second, theta=theta))
    assert result.status == "ok"
    write_report(result, tmp_path)
    assert (tmp_path / "phase_space_1.png").is_file()


@pytest.mark.check
def test_the_command_takes_files_of_two_programs_as_one_motion_or_as_two_runs(tmp_path, monkeypatch, capsys, printed):
    monkeypatch.chdir(tmp_path)

    def pendulum(t, state):
        return [state[1], -G / 0.5 * np.sin(state[0]) - 0.3 * state[1]]

    angle = solve_ivp(pendulum, (0, 25), [0.5, 0.0], dense_output=True, rtol=1e-10, atol=1e-12).sol
    noise = np.random.default_rng(3)
    t = np.arange(0, 20, 0.01)
    rows = np.stack([t, angle(t)[0] + 0.001 * noise.standard_normal(len(t))], axis=1)
    np.savetxt("encoder.csv", rows, ("%.3f", "%.6f"), ",", header="time [s],angle [rad]", comments="")
    t = np.arange(2, 24, 1 / 30)
    rows = np.stack([t - 2, np.degrees(1.02 * angle(t)[0] + 0.004 * noise.standard_normal(len(t)))], axis=1)
    np.savetxt("film.csv", rows, "%.4f", ";", header="time [s];angle [deg]", comments="")
    text = printed(["fit", "encoder.csv", "film.csv", "--same-motion", "--quiet"]).out
    for name in ("recording.film.scale", "recording.film.delay", "--same-motion", "farthest off"):
        assert name in text
    scale = next(line for line in text.splitlines() if "recording.film.scale" in line).split()
    assert abs(float(scale[1]) - 1.02) < 4 * float(scale[2])
    assert main(["fit", "encoder.csv", "film.csv", "--quiet"]) in (0, 3)
    assert "recording." not in capsys.readouterr().out
