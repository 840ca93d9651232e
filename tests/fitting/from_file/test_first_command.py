"""`dropper fit FILE` without a scene: an answer with errors, and the files and the command that repeat it."""

import shlex

import numpy as np
import pytest
from written_files import double_pendulum, points, swing, write

LENGTH, DAMPING = 0.4, 0.08
QUIET = ("--json", "--quiet")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def within(found, name, truth, errors=3.0):
    one = found["found"][name]
    return abs(one["value"] - truth) < errors * one["std_error"]


def test_an_angle_in_degrees_gives_length_zero_and_damping_and_the_command_that_repeats_them(here, json_of):
    t, phi = swing(20.0)
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(t))
    file = write(here / "arm.csv", ["Zeit [ms];Winkel [°]"], np.stack([1e3 * t, np.degrees(phi) + 3 + noise], 1), ";")
    found = json_of(["fit", file.name, "--report", "arm-fit", *QUIET])
    assert found["status"] == "ok"
    assert (here / "arm-fit" / "report.md").is_file()
    assert within(found, "effective length", LENGTH)
    assert within(found, "angle at rest", np.radians(3.0))
    assert within(found, "b_l / m", DAMPING)
    assert "may include viscous friction in the joints" in found["found"]["b_l / m"]["remark"]
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    again = json_of(["fit", *shlex.split(found["repeat"])[2:], *QUIET])
    for name, one in found["parameters"].items():
        assert again["parameters"][name]["value"] == pytest.approx(one["value"], abs=0.02 * one["std_error"])
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.check
def test_points_of_a_film_give_a_chains_lengths_masses_and_damping(here, json_of):
    t, first, second = double_pendulum()
    ends = np.conj([0.2 * first, 0.2 * first + 0.15 * second]) / 4.3e-4  # pixels downwards
    rows = np.stack([np.arange(len(t)), *points(*ends, noise=0.5)], axis=1)
    write(here / "film.csv", ["# 120 fps", "frame,x1,y1,x2,y2"], rows)
    found = json_of(["fit", "film.csv", *QUIET])
    for name, truth in (("length 1", 0.2), ("length 2", 0.15), ("mass 2 over mass 1", 2 / 3)):
        assert within(found, name, truth), name


@pytest.mark.check
@pytest.mark.parametrize("seed", [40, 44, 48, 53])
def test_files_of_users_are_answered_or_refused_in_one_line(seed, tmp_path):
    import files_of_users

    row = files_of_users.measure(seed, tmp_path)
    assert row["right"], row
