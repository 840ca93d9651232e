"""Streams that take nothing, disks that are full, signals, damaged and unfinished files: one line, and nothing lost."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError, Solution, recover
from dropper_jax.base import files
from dropper_jax.base.lock import Lock
from dropper_jax.base.toml_text import parse_toml_text
from dropper_jax.cli import main
from dropper_jax.run import chunks, row_store
from dropper_jax.run.row_store import OnDisk

ROOT = Path(dj.__file__).parents[1]
RUN = [sys.executable, "-m", "dropper_jax", "run", "conical-pendulum", "--quiet"]

linux = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")


def shell(line: str, **environment: str) -> subprocess.CompletedProcess[str]:
    found = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]), **environment}
    line = line.replace("dropper ", f"{sys.executable} -m dropper_jax ")
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False, env=found)


@linux
@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("dropper scenes > /dev/full", 3, "error: standard output: cannot be written: No space left on device\n"),
        ("dropper scenes --json > /dev/full", 3, "error: standard output: cannot be written"),
        ("dropper scenes >&-", 0, ""),
        ("dropper scenes nope 2> /dev/full", 2, ""),
        ("dropper scenes nope 2>&-", 2, ""),
        ("dropper scenes | true", 0, ""),
    ],
)
def test_streams_that_take_nothing_end_in_a_line_or_in_silence(line, code, words):
    done = shell(line)
    assert done.returncode == code
    assert done.stderr.startswith(words)
    assert done.stderr.count("\n") == (1 if words else 0)
    assert done.stdout == ""


def test_an_unknown_platform_is_one_line_and_one_object():
    done = shell("dropper run conical-pendulum --duration 1 --json", JAX_PLATFORMS="abacus")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: JAX_PLATFORMS: 'abacus' cannot be used here")
    assert json.loads(done.stdout)["status"] == "invalid_input"


@pytest.mark.check
@pytest.mark.parametrize("suffix", ["nc", "npz"])
def test_a_full_disk_is_reported_with_the_file_and_stops_nothing_else(tmp_path, suffix):
    """The limit on the size of files works as a disk that is full; HDF5 ended in a segmentation fault."""
    if suffix == "nc":
        pytest.importorskip("h5netcdf")
    out = tmp_path / f"run.{suffix}"
    done = shell(f"ulimit -f 12; dropper run double-pendulum-chaotic --duration 10 --quiet --json --out {out}")
    assert done.returncode == 3
    assert f"error: {out}: cannot be written: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["status"] == "interrupted"
    assert list(tmp_path.iterdir()) == []


def test_what_nothing_could_be_kept_of_leaves_no_folder_behind(tmp_path):
    (tmp_path / "tmp").mkdir()
    run = f"dropper run conical-pendulum --dt 0.01 --duration 1 --no-companion --quiet --out {tmp_path}/run.npz"
    done = shell(f"ulimit -f 4; {run}", TMPDIR=str(tmp_path / "tmp"))
    assert "cannot be written: File too large; the run could not be saved" in done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["tmp"]


def test_a_sweep_that_a_full_disk_refuses_names_its_folder(tmp_path):
    pytest.importorskip("zarr")
    sweep = "dropper sweep conical-pendulum --vary effects.weight.gravity=9,10 --duration 0.1 --quiet"
    done = shell(f"ulimit -f 2; {sweep} --out {tmp_path}/many.zarr")
    assert done.returncode == 3
    assert done.stderr == f"error: {tmp_path}/many.zarr: cannot be written: File too large\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.check
def test_pictures_that_a_full_disk_refuses_are_no_fault_of_the_input(tmp_path):
    done = shell(f"ulimit -f 8; dropper run conical-pendulum --duration 1 --quiet --json --plot {tmp_path / 'p.png'}")
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1] == f"error: {tmp_path / 'p.png'}: cannot be written: File too large"
    assert json.loads(done.stdout)["status"] == "not_saved"
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_our_own_is_one_line_and_one_object(monkeypatch, printed):
    def fault(*_, **__):
        raise TypeError("nobody\nforesaw this")

    monkeypatch.setattr("dropper_jax.cli.scenes.find_scene", fault)
    out, err = printed(["scenes", "string", "--json"], 3)
    assert json.loads(out)["status"] == "internal_error"
    assert err == f"error: {json.loads(out)['error']}\n"
    assert "TypeError: nobody foresaw this" in err


@pytest.mark.parametrize("text", ["x = " + "[" * 40 + "]" * 40, "x = " + "[" * 9999, ".".join("a" * 99) + " = 1"])
def test_what_is_nested_beyond_measure_is_refused(text):
    with pytest.raises(ValueError, match="nested more than 32 deep"):
        parse_toml_text(text)


@pytest.mark.parametrize("number", ["9" * 30, "9" * 5000])
def test_numbers_beyond_64_bits_are_refused(number):
    with pytest.raises(ValueError, match=r"64 bits|digits"):
        parse_toml_text(f"x = {number}")
    assert parse_toml_text(f"x = {2**63 - 1}") == {"x": 2**63 - 1}


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["run", "string", "--set", "line.0.links=1000000000"], "line.0.links: 1000000000 is out of range"),
        (["run", "string", "--duration", "1e15"], "takes 5e+16 steps of 0.02 s"),
        (["run", "conical-pendulum", "--duration", "2e7"], "saved states, which need"),
        (["sweep", "string", "--vary", "b_l=0:1:1000000000000", "--out", "x.zarr"], "allowed: at most 10000000"),
    ],
)
def test_what_is_too_large_is_reported_before_it_starts(refused, argv, words):
    assert words in refused(argv)


def part_of(path, process):
    """The unfinished file of another process."""
    own = files.part_prefix(path)
    return path.with_name(f"{own.removesuffix(f'-{os.getpid()}-')}-{process}-x.part")


def test_what_a_killed_writer_left_is_removed_and_what_a_living_one_writes_stays(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left, alive = (part_of(tmp_path / "a", process) for process in (dead.pid, os.getppid()))
    for file in (left, alive):
        file.write_text("half")
    files.atomic_write(tmp_path / "a", "whole")
    assert not left.exists()
    assert alive.exists()


def test_a_lock_names_its_owner_and_is_free_once_it_is_gone(tmp_path):
    held = "import sys, time; from pathlib import Path; from dropper_jax.base.lock import Lock\n"
    held += "lock = Lock(Path(sys.argv[1])); print('held', flush=True); time.sleep(60)"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    call = [sys.executable, "-c", held, str(tmp_path / "a")]
    with subprocess.Popen(call, stdout=subprocess.PIPE, env=environment) as other:
        other.stdout.readline()
        with pytest.raises(SceneError, match=rf"a: locked by process {other.pid} on "):
            Lock(tmp_path / "a")
        other.kill()
    Lock(tmp_path / "a").release()
    assert list(tmp_path.iterdir()) == []


def test_a_run_kept_on_disk_has_the_numbers_of_one_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("dropper_jax.run.observation.BLOCK_STATES", 64)
    kept = dj.simulate("conical-pendulum", dt=0.01, duration=3.0, scratch=tmp_path)
    whole = dj.simulate("conical-pendulum", dt=0.01, duration=3.0)
    for name in ("t", "positions", "velocities", "tension", "work", "kinetic", "potential"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(whole, name), err_msg=name)
    assert kept.energy_drift == whole.energy_drift


@linux
def test_rows_on_disk_are_joined_and_looked_at_without_standing_in_memory(tmp_path):
    kept = OnDisk(tmp_path, {}, {})
    part = np.arange(row_store.BLOCK_STATES * 300.0).reshape(row_store.BLOCK_STATES, 300)
    for i in range(3):
        kept.append(kept.count, ([part + i], {}))
    (rest,) = kept.read(kept.count)
    whole = kept.join(part[0] - 1.0, rest)
    assert resident(tmp_path) < 0.5 * part.nbytes  # of six times as much
    some = row_store.take_every(whole, 7)
    assert resident(tmp_path) < 0.5 * part.nbytes
    np.testing.assert_array_equal(some, np.concatenate([part[:1] - 1.0, part, part + 1, part + 2])[::7])


def resident(folder):
    """Bytes of the files of a folder that this process holds in memory."""
    lines = Path("/proc/self/smaps").read_text().splitlines()
    starts = [i for i, line in enumerate(lines) if str(folder) in line]
    return sum(1024 * int(next(x for x in lines[i:] if x.startswith("Rss:")).split()[1]) for i in starts)


def killed_at(count, out, monkeypatch, simulate):
    """The folder of a run whose process ended after so many states, half of the next piece written."""
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    folder = part_of(out, dead.pid)
    folder.mkdir()
    append = OnDisk.append

    def ended(self, key, found):
        if self.count == count:
            with (folder / "rows.0").open("ab") as file:
                file.write(b"half")
            raise SystemError
        append(self, key, found)

    with monkeypatch.context() as patched:
        patched.setattr(chunks, "SECONDS", 0.0)
        patched.setattr(OnDisk, "append", ended)
        with pytest.raises(SystemError):
            simulate(folder)


@pytest.mark.parametrize("settings", [{}, {"integrator": "tsit5"}], ids=["default", "embedded error"])
def test_a_killed_run_continues_to_the_bit_also_one_that_continued_another(tmp_path, monkeypatch, settings):
    whole = dj.simulate("conical-pendulum-damped", dt=0.01, duration=0.6, **settings)
    first = dj.simulate("conical-pendulum-damped", dt=0.01, duration=0.2, **settings)
    out = tmp_path / "run.npz"
    killed_at(15, out, monkeypatch, lambda folder: first.continued(0.4, scratch=folder))
    assert len(recover(out)) == 1
    part = Solution.load(out)
    assert part.status == "interrupted"
    rest = part.continued()
    for name in ("t", "positions", "velocities", "tension", "work"):
        joined = [getattr(first, name), getattr(part, name)[1:], getattr(rest, name)[1:]]
        np.testing.assert_array_equal(np.concatenate(joined), getattr(whole, name), err_msg=name)
    for name, values in whole.last.items():
        np.testing.assert_array_equal(rest.last[name], values, err_msg=name)


def test_sigterm_keeps_what_is_done_as_an_interruption_does(tmp_path):
    out = tmp_path / "run.npz"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    call = [*RUN, "--duration", "20000", "--out", str(out), "--json"]
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment) as run:
        for _ in range(600):
            if any(row_store.read_mark(folder)[0] for folder in tmp_path.iterdir()):
                break
            time.sleep(0.1)
        run.send_signal(signal.SIGTERM)
        said = run.communicate()[0]
    assert run.returncode == 130
    assert json.loads(said)["status"] == "interrupted"
    assert Solution.load(out).status == "interrupted"
    assert len(Solution.load(out).t) > 1


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("<img src=x onerror=1>", "&lt;img src=x onerror=1&gt;"),
        ("[here](http://a.b)", "\\[here\\](http&#58;//a.b)"),
        ("a|b", "a&#124;b"),
        ("back_bone-1", "back_bone-1"),
    ],
)
def test_names_stand_in_reports_as_they_are(name, shown):
    from dropper_jax.base.markdown import literal

    assert literal(name) == shown


def test_a_scene_names_files_below_its_folder_only(tmp_path, capsys, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inner = tmp_path.parent / f"{tmp_path.name}-scene"
    inner.mkdir()
    waves = "period_s,amplitude_m,phase_rad\n8.0,0.5,0.0\n6.0,0.2,1.0\n"
    outside = tmp_path.parent / f"{tmp_path.name}-waves.csv"
    for file in (inner / "waves.csv", outside):
        file.write_text(waves)
    head, _, rest = printed(["scenes", "dropper-regular-wave"]).out.partition("[sea.waves]\n")
    rest = rest[rest.index("\n[") :] if "\n[" in rest else ""
    for text, code in (("waves.csv", 0), (str(outside), 2), (f"../{outside.name}", 2)):
        (inner / "scene.toml").write_text(f'{head}[sea.waves]\nkind = "components"\nfile = "{text}"\n{rest}')
        assert main(["scenes", str(inner / "scene.toml"), "--expanded"]) == code, text
        said = capsys.readouterr()
        assert ("outside the scene's folder" in said.err) == bool(code)
    (inner / "scene.toml").write_text(f'{head}[sea.waves]\nkind = "components"\nfile = "{outside}"\n{rest}')
    assert main(["scenes", str(inner / "scene.toml"), "--expanded", "--allow-outside"]) == 0
    with pytest.raises(SceneError, match="outside"):
        dj.load_scene(inner / "scene.toml")
    assert dj.load_scene(inner / "scene.toml", allow_outside=True).sea.waves.kind == "components"
