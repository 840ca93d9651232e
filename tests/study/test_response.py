"""The response of a pendulum to regular waves, against a SciPy integration of its own equation of motion."""

import numpy as np
import pytest
import sea_cases

from dropper_jax import as_toml
from dropper_jax.study.response import responses


@pytest.mark.check
def test_mean_amplitude_and_phase_are_those_of_scipy(tmp_path, json_of):
    scene = sea_cases.pendulum().with_values({"run.duration": 36.0})
    period = 6.0
    t = np.arange(24.01, 36.005, 0.01)
    angle = sea_cases._pendulum_by_scipy(np.concatenate([[0.0], t]))[1:]
    wave = np.exp(-2j * np.pi * t / period)
    swing = 2 * np.mean((angle - angle.mean()) * wave)
    surface = 2 * np.mean(sea_cases.SWELL * np.cos(2 * np.pi * t / period) * wave)
    (found,) = responses(scene, [period], more=False)
    assert found["status"] == "ok"
    assert found["mean_rad"] == pytest.approx(angle.mean(), abs=2e-3)
    assert found["amplitude_rad"] == pytest.approx(abs(swing), rel=0.01)
    assert found["phase_rad"] == pytest.approx(np.angle(swing / surface), abs=0.02)
    file = tmp_path / "scene.toml"
    file.write_text(as_toml(scene.to_dict()))
    reported = json_of(["response", str(file), "--periods", "6:6:1", "--no-higher-waves", "--json", "--quiet"])
    assert reported["rows"][0]["amplitude_rad"] == found["amplitude_rad"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["wet-pendulum-wave", "--periods", "2:3"], "is not LO:HI:N"),
        (["wet-pendulum-wave", "--periods", "0:3:4"], "is out of range"),
        (["dropper-north-sea", "--periods", "5:6:2"], "needs regular waves"),
        (["string", "--periods", "3:3:1"], "sea.waves: a response needs"),
        (["wet-pendulum-wave", "--periods", "50:60:2"], "run.duration: 120 s is too short"),
    ],
)
def test_what_cannot_be_answered_is_refused(arguments, words, printed):
    assert words in printed(["response", *arguments, "--quiet"], 2).err
