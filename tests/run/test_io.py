"""Output files are written whole or not at all; energies and summaries of a solution; files that are no runs."""

import json
import os

import numpy as np
import pytest

from dropper_jax import Solution
from dropper_jax.base.files import atomic_write


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_interrupted_write_keeps_the_old_file_and_no_rest(tmp_path, error):
    path = tmp_path / "run.npz"
    path.write_text("old")

    def writer(file):
        file.write(b"half")
        raise error("disk full")

    with pytest.raises(error):
        atomic_write(path, writer)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_file_has_the_usual_rights(tmp_path):
    path = atomic_write(tmp_path / "a", b"")
    plain = tmp_path / "b"
    plain.touch()
    assert os.stat(path).st_mode == os.stat(plain).st_mode


@pytest.fixture
def solution(made):
    """`solution(**changes)`: two links hanging straight down with a free end, at rest, three instants."""

    def make(**changes):
        positions = np.zeros((3, 3, 3))
        positions[:, :, 2] = -np.arange(3)
        fields = {
            "kinetic": np.array([0.0, 2.0, 1.0]),
            "potential": np.array([5.0, 2.5, 3.0]),
            "work": np.array([[0.0], [-0.5], [-0.75]]),
            "run_s": 0.25,
        }
        tension = np.array([[20.0, 10.0], [22.0, 11.0], [18.0, 9.0]])
        return made("double-pendulum-periodic", positions, tension, dt=0.5, **{**fields, **changes})

    return make


def test_energies_of_a_solution_follow_their_definitions(solution):
    found = solution()
    np.testing.assert_allclose(found.energy, [5.0, 4.5, 4.0])
    np.testing.assert_allclose(found.balance, [5.0, 5.0, 4.75])
    assert found.energy_drift == 0.25
    assert found.energy_scale == 2.5
    assert found.realtime_factor == 4.0
    assert found.us_per_step == 125000.0


def test_tension_summary_has_ends_and_all_links(solution):
    found = solution().tension_summary()
    times = {"min_s": 0.75, "max_s": 0.25}  # of the tensions, in the middle of their steps
    assert found["first"] == {"min": 18.0, "mean": 20.0, "max": 22.0, "final": 18.0, **times}
    assert found["last"] == {"min": 9.0, "mean": 10.0, "max": 11.0, "final": 9.0, **times}
    assert found["all"] == {"min": 9.0, "mean": 15.0, "max": 22.0, "final": 13.5, **times}


def test_summary_is_strict_json_with_null_for_nan(solution):
    found = solution(
        max_residual=float("nan"),
        kinetic=np.array([0.0, np.inf, np.nan]),
        status="non_finite",
        failed_steps=1,
        first_bad={"step": 2, "time_s": 1.0, "residual": float("nan"), "reason": "not a number"},
    )
    summary = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert summary["schema"] == 1
    assert summary["status"] == "non_finite"
    assert summary["max_residual"] is None
    assert summary["energy_drift_j"] is None
    assert summary["first_bad"]["residual"] is None
    assert "step 2 at t = 1 s" in summary["error"]
    assert np.shape(summary["final_positions_m"]) == (3, 3)


def other_netcdf(path):
    pytest.importorskip("xarray").Dataset({"a": ("x", [1.0])}).to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("other.npz", lambda path: path.write_bytes(b"")),
        ("other.npz", lambda path: path.write_bytes(b"text, not a run")),
        ("other.npz", lambda path: path.write_bytes(b"PK\x03\x04 half a zip")),
        ("other.npz", lambda path: np.savez(path, a=np.zeros(3))),
        ("other.nc", lambda path: path.write_bytes(b"no netCDF")),
        ("other.nc", other_netcdf),
    ],
)
def test_file_that_is_no_saved_run_is_refused_in_one_line(tmp_path, refusal, name, write):
    assert "cannot be read" in refusal(Solution.load, tmp_path / name)
    write(tmp_path / name)
    assert f"{name}: not a saved run; allowed" in refusal(Solution.load, tmp_path / name)
