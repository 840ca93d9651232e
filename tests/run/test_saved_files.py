"""Files that an earlier version (0.2.0, before the common store) wrote: each format is read, resumed and continued."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import Coupled, Solution, recover
from dropper_jax.base import files

SAVED = Path(__file__).with_name("saved-files.zip")
SCENE = "conical-pendulum-damped"


@pytest.fixture
def saved(tmp_path):
    with zipfile.ZipFile(SAVED) as archive:
        archive.extractall(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def run():
    return dj.simulate(SCENE, dt=0.01, duration=0.2)


@pytest.mark.parametrize("suffix", ["npz", "nc", "zarr"])
def test_a_run_of_each_format_has_its_numbers_and_continues(saved, run, suffix):
    pytest.importorskip("zarr")
    pytest.importorskip("h5netcdf")
    found = Solution.load(saved / f"run.{suffix}")
    assert (found.status, len(found.t)) == ("ok", 11)
    np.testing.assert_allclose(found.positions, run.positions[:11], atol=1e-9)
    np.testing.assert_allclose(found.continued(0.1).positions, run.positions[10:], atol=1e-9)


def test_rows_of_a_killed_run_are_recovered(saved, run):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    name = files.part_prefix(saved / "old.npz").replace(f"-{os.getpid()}-", f"-{dead.pid}-x.part")
    (saved / "killed").rename(saved / name)
    assert recover(saved / "old.npz") == [
        f"{saved}/old.npz: from a run that was killed; the part after t = 0.06 s is lost"
    ]
    found = Solution.load(saved / "old.npz")
    assert found.status == "interrupted"
    np.testing.assert_allclose(found.positions, run.positions[:7], atol=1e-9)
    assert found.last == {}


def test_a_coupled_state_is_restored(saved):
    lines = Coupled(SCENE, dt=0.01)
    forces = lines.restore(saved / "coupled.npz")
    assert lines.time == pytest.approx(0.01)
    assert np.all(np.isfinite(forces))


@pytest.mark.check
def test_a_sweep_is_resumed(saved):
    pytest.importorskip("zarr")
    from fitting.sweep import open_sweep, sweep

    scene = dj.load_scene("conical-pendulum").with_values({"run.dt": 0.01, "run.duration": 0.05})
    found = sweep(scene, {"line.0.mass": [1.0, 1.5, 2.0]}, saved / "sweep.zarr", chunk=2, mix_versions=True)
    assert (found.cases, found.resumed, found.counts["ok"]) == (3, 2, 3)
    tension = open_sweep(saved / "sweep.zarr").tension_max.values
    np.testing.assert_allclose(tension / tension[0], [1.0, 1.5, 2.0], rtol=1e-9)
