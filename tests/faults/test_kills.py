"""Runs and sweeps ended at random moments: nothing readable is wrong, at most the last piece is lost and told."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.cli import main
from dropper_jax.run.recovery import recover
from dropper_jax.run.solution import load_run

ROOT = Path(dj.__file__).parents[1]
#: Moments of each kind; `make check` takes them all.
MOMENTS = int(os.environ.get("KILLS", "17"))
RUN = ["run", "conical-pendulum", "--duration", "4000", "--quiet"]
SWEEP = ["sweep", "conical-pendulum", "--vary", "line.0.mass=1:2:600", "--duration", "1", "--chunk", "4"]
SWEEP += ["--devices", "1", "--quiet"]


def ended(argv: list[str], how: int, after: float, begun: Path | None = None) -> None:
    """A process that is ended `after` seconds, counted from when the file `begun` is there."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    call = [sys.executable, "-m", "dropper_jax", *argv]
    with subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment) as process:
        waited = 0.0
        while begun is not None and waited < 60 and process.poll() is None and not begun_at(begun):
            time.sleep(0.02)
            waited += 0.02
        time.sleep(after)
        process.send_signal(how)


def begun_at(path: Path) -> bool:
    return path.exists() or any(path.parent.glob(f".{path.name}.*/rows.0"))


@pytest.fixture(scope="module")
def whole():
    return dj.simulate("conical-pendulum", duration=4000.0)


@pytest.mark.check
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("moment", range(MOMENTS))
def test_a_run_that_is_ended_is_kept_to_its_last_whole_piece(tmp_path, whole, how, moment):
    out = tmp_path / f"run.{random.Random(moment).choice(['npz', 'nc', 'zarr'])}"
    ended([*RUN, "--out", str(out)], how, random.Random(f"{how} {moment}").uniform(0.0, 6.0), out)
    told = recover(out)
    if not out.exists():  # before the first piece
        assert told == []
        return
    found = load_run(out)
    assert found.status in ("ok", "interrupted")
    assert bool(told) == (how == signal.SIGKILL and found.status == "interrupted")
    np.testing.assert_array_equal(found.positions, whole.positions[: len(found.t)])
    np.testing.assert_array_equal(found.tension, whole.tension[: len(found.t)])
    assert [item for item in tmp_path.iterdir() if item != out] == []


@pytest.mark.check
def test_a_sweep_that_is_killed_again_and_again_has_the_numbers_of_one_that_was_not(tmp_path):
    zarr = pytest.importorskip("zarr")
    good, out = tmp_path / "good.zarr", tmp_path / "sweep.zarr"
    assert main([*SWEEP, "--out", str(good)]) == 0
    for moment in range(MOMENTS):
        ended([*SWEEP, "--out", str(out)], signal.SIGKILL, random.Random(moment).uniform(0.0, 3.0), out)
    assert main([*SWEEP, "--out", str(out)]) == 0
    for name, array in zarr.open_group(good, mode="r").arrays():
        np.testing.assert_array_equal(zarr.open_group(out, mode="r")[name][:], array[:], err_msg=name)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["good.zarr", "sweep.zarr"]
