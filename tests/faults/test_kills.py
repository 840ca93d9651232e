"""Runs, sweeps and fits ended at random moments: nothing readable is wrong, and a lost last piece is reported."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax import Solution, as_toml, recover
from dropper_jax.cli import main
from fitting import Camera, observe, simulate_truth, write_trace

ROOT = Path(dj.__file__).parents[1]
#: Moments of each kind and signal: fifty of both kinds together; KILLS asks for more.
MOMENTS = int(os.environ.get("KILLS", "9"))
HOWS = [signal.SIGKILL, signal.SIGTERM]
RUN = ["run", "conical-pendulum", "--duration", "4000", "--quiet"]
SWEEP = ["sweep", "conical-pendulum", "--vary", "line.0.mass=1:2:600", "--duration", "1", "--chunk", "4"]
SWEEP += ["--devices", "1", "--quiet"]
PENDULUM = rods([np.pi / 2], effects={"linear_damping": {"b_l": 0.1}})
#: What differs between two fits of the same numbers.
CLOCKS = ("seconds", "compile_s", "run_s")

pytestmark = pytest.mark.check


@dataclass
class Commands:
    """Commands as processes of their own, their programs kept."""

    environment: dict[str, str]

    def begin(self, argv: list[str]) -> subprocess.Popen:
        call = [sys.executable, "-m", "dropper_jax", *argv]
        return subprocess.Popen(
            call, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=self.environment
        )

    def seconds(self, argv: list[str]) -> float:
        """How long a command takes that is let be."""
        started = time.perf_counter()
        with self.begin(argv) as process:
            printed = process.communicate()[1]
        assert process.returncode == 0, printed
        return time.perf_counter() - started

    def end(self, argv: list[str], how: int, after: float, started: Callable[[], bool] | None = None) -> None:
        """End one `after` seconds from its start, or from when something has begun; no traceback is left behind."""
        with self.begin(argv) as process:
            late = time.perf_counter() + 60
            while started is not None and time.perf_counter() < late and process.poll() is None and not started():
                time.sleep(0.005)
            time.sleep(after)
            process.send_signal(how)
            printed = process.communicate()[1]
        assert process.returncode in (0, -how, 130), printed
        if how == signal.SIGTERM and process.returncode == 130:
            assert "Traceback" not in printed


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    kept = str(tmp_path_factory.mktemp("programs"))
    return Commands({**os.environ, "PYTHONPATH": path, "XDG_CACHE_HOME": kept})


@pytest.fixture(scope="module")
def whole():
    return dj.simulate("conical-pendulum", duration=4000.0)


@pytest.fixture(scope="module")
def run_takes(commands, tmp_path_factory):
    """Seconds of a whole run, its program compiled before."""
    out = str(tmp_path_factory.mktemp("run") / "run.npz")
    commands.seconds([*RUN, "--out", out])
    return commands.seconds([*RUN, "--out", out])


@pytest.mark.parametrize("how", HOWS)
@pytest.mark.parametrize("moment", range(MOMENTS))
def test_a_run_that_is_ended_is_kept_to_its_last_whole_piece(commands, run_takes, tmp_path, whole, how, moment):
    rng = random.Random(f"{how} {moment}")
    out = tmp_path / f"run.{rng.choice(['npz', 'nc', 'zarr'])}"
    if moment % 3:  # from the first piece on: what comes before it leaves nothing
        commands.end([*RUN, "--out", str(out)], how, rng.uniform(0.0, 0.6 * run_takes), lambda: has_begun(out))
    else:
        commands.end([*RUN, "--out", str(out)], how, rng.uniform(0.0, run_takes))
    reported = recover(out)
    if not out.exists():  # before the first piece
        assert reported == []
        return
    found = Solution.load(out)
    assert found.status in ("ok", "interrupted")
    assert bool(reported) == (how == signal.SIGKILL and found.status == "interrupted")
    np.testing.assert_array_equal(found.positions, whole.positions[: len(found.t)])
    np.testing.assert_array_equal(found.tension, whole.tension[: len(found.t)])
    assert [item for item in tmp_path.iterdir() if item != out] == []


def has_begun(path: Path) -> bool:
    return path.exists() or any(path.parent.glob(f".{path.name}.*/rows.0"))


def test_a_sweep_that_is_ended_again_and_again_has_the_numbers_of_one_that_was_not(commands, tmp_path, capsys, json_of):
    zarr = pytest.importorskip("zarr")
    good, out = tmp_path / "good.zarr", tmp_path / "sweep.zarr"
    commands.seconds([*SWEEP, "--out", str(good)])
    there = 0
    for moment in range(2 * MOMENTS):
        rng, how = random.Random(moment), HOWS[moment % 2]
        commands.end([*SWEEP, "--out", str(out)], how, rng.uniform(0.0, 0.5), lambda there=there: written(out) > there)
        assert written(out) >= there
        there = written(out)
    capsys.readouterr()
    assert there <= json_of([*SWEEP, "--out", str(out), "--json"])["resumed"] <= 600
    for name, array in zarr.open_group(good, mode="r").arrays():
        np.testing.assert_array_equal(zarr.open_group(out, mode="r")[name][:], array[:], err_msg=name)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["good.zarr", "sweep.zarr"]


def written(path: Path) -> int:
    """Cases of a sweep whose status is on the disk."""
    return sum(file.stat().st_size for file in (path / "status").rglob("*") if file.parent.name == "c")


@pytest.fixture(scope="module")
def fit(commands, tmp_path_factory):
    """Words of a fit without its outputs, what it writes whole, and how long it takes."""
    folder = tmp_path_factory.mktemp("fit")
    write_trace(
        folder / "run.csv", observe(simulate_truth(PENDULUM, 6.0, 30.0), Camera(rate=30.0, angle_noise=0.005), 0)
    )
    guess = {**PENDULUM, "effects": {"weight": {}, "linear_damping": {"b_l": 0.5}}}
    (folder / "scene.toml").write_text(as_toml(guess))
    words = ["fit", str(folder / "run.csv"), "--scene", str(folder / "scene.toml"), "--quiet"]
    commands.seconds([*words, *outputs(folder)])
    takes = commands.seconds([*words, *outputs(folder)])
    return words, files_of(folder), takes


def outputs(folder: Path) -> list[str]:
    return ["--report", str(folder / "report"), "--out", str(folder / "fit.json")]


def files_of(folder: Path) -> dict[str, object]:
    """What a fit wrote, by name, without its clocks; what is half written does not come through here."""
    found: dict[str, object] = {}
    for file in [folder / "fit.json", *(folder / "report").glob("[!.]*")]:
        if not file.exists():
            continue
        if file.suffix == ".json":
            found[file.name] = {key: x for key, x in json.loads(file.read_text()).items() if key not in CLOCKS}
        elif file.suffix == ".md":
            found[file.name] = [line for line in file.read_text().splitlines() if not line.startswith("- wall time")]
        else:
            found[file.name] = file.read_bytes()
    return found


@pytest.mark.parametrize("how", HOWS)
@pytest.mark.parametrize("moment", range(MOMENTS))
def test_what_a_fit_writes_is_whole_or_not_there(commands, fit, tmp_path, how, moment):
    """Half of the moments lie in the writing, over the report of an earlier fit. The next fit to the same places takes
    away what a killed one left."""
    words, good, takes = fit
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "report.md").write_text("earlier")
    rng = random.Random(f"{how} {moment}")
    argv = [*words, *outputs(tmp_path)]
    if moment % 2:
        started = lambda: any((tmp_path / "report").glob("*fitted.toml*"))  # noqa: E731
        commands.end(argv, how, rng.uniform(0.0, 0.3 * takes), started)
    else:
        commands.end(argv, how, rng.uniform(0.0, takes))
    found = files_of(tmp_path)
    if found.get("report.md") == ["earlier"]:
        del found["report.md"]
        assert "fitted.toml" not in found  # an earlier report beside a newer result would be taken for its own
    for name, content in found.items():
        assert content == good[name], name
    if "report.md" in found:  # it names all others
        assert found.keys() >= good.keys() - {"fit.json"}
    if how == signal.SIGTERM:
        assert list(tmp_path.rglob("*.part")) == []
    if list(tmp_path.rglob("*.part")):
        assert main(argv) == 0
        assert files_of(tmp_path).keys() == good.keys()
        assert list(tmp_path.rglob("*.part")) == []


@pytest.mark.parametrize("kind", ["run", "cases", "sweep"])
def test_a_store_loses_no_complete_chunk_to_sixty_kills_and_a_full_disk(kind, tmp_path):
    """`kill -9` during creation and appends, again and again on one store; then no file may grow."""
    pytest.importorskip("zarr")
    call = [sys.executable, str(Path(__file__).with_name("ended_writer.py")), kind, str(tmp_path), "60"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    printed = subprocess.run(call, env=environment, capture_output=True, text=True, check=True).stdout
    *killed, refused, last = map(json.loads, printed.splitlines())
    assert len(killed) == 60
    for row in [*killed, last]:
        assert (row["lost"], row["wrong"]) == ([], [])
    counts = [row["done"] for row in [*killed, last]]
    assert counts == sorted(counts)
    assert counts[-1] >= 40
    assert refused == {"refused": f"[Errno 27] cannot be written: File too large: '{tmp_path}/store'"}
    assert list(tmp_path.rglob("*.part")) == []
