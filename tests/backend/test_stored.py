"""Compiled programs stored for the next process: loaded for the same program only, compiled again where damaged."""

import os
import pickle
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache.compilation_cache import reset_cache

import dropper_jax as dj
from dropper_jax.backend import stored
from dropper_jax.backend.program_files import ABANDONED_AGE, UNFINISHED, Folder, open_folder
from dropper_jax.backend.programs import compile_program, store_programs
from dropper_jax.backend.stable_text import NoStableText, stable_text
from dropper_jax.backend.stored import StoredPrograms
from dropper_jax.base.numerics import components, inverse_rows
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import begin
from dropper_jax.study.doctor import loads_stored_programs

MATRICES = jnp.asarray(np.random.default_rng(1).normal(size=(4, 3, 3)) + 3.0 * np.eye(3))
RUN = "import sys; from dropper_jax.cli import main; sys.exit(main(['run', 'conical-pendulum', '--duration', '0.1']))"


@pytest.fixture(autouse=True)
def sources(monkeypatch):
    """Sources that do not change, even if they are edited while these tests run."""
    monkeypatch.setattr(stored, "sources_digest", lambda: "the same")


@pytest.fixture(autouse=True)
def only_store(monkeypatch):
    """The cache of JAX that other tests use is off, and nothing is stored after a test."""
    monkeypatch.setattr("dropper_jax.backend.programs._stored", None)
    folder = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    reset_cache()
    yield
    jax.config.update("jax_compilation_cache_dir", folder)
    reset_cache()


class Counted:
    """A function that counts how often it is traced."""

    def __init__(self, function):
        self.function, self.traced = function, 0

    def __call__(self, *values):
        self.traced += 1
        return self.function(*values)


def answer(folder, one, function=inverse_rows, settings=None, values=(MATRICES,), kernel=False):
    """Result of a process that starts now, with programs stored in a folder."""
    assert store_programs(folder) == folder
    return compile_program(function, settings or {}, values, one, kernel)(*values)


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def run(folder, **more):
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder), **more}
    return subprocess.run([sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True)


def programs_of(folder):
    return [file for file in folder.rglob("*") if file.is_file() and file.suffix != UNFINISHED]


def numbers(text):
    """The lines of a run's output without times."""
    return "\n".join(line for line in text.splitlines() if "compil" not in line and " s" not in line)


DAMAGES = [
    pytest.param(lambda whole: whole[:-1], id="cut"),
    pytest.param(lambda whole: whole[:3], id="stub"),
    pytest.param(lambda whole: whole[:-1] + bytes([whole[-1] ^ 1]), id="one bit"),
    pytest.param(lambda whole: b"", id="empty"),
]


def test_the_least_recently_used_files_are_removed_first(tmp_path):
    folder = Folder(tmp_path, largest=3 * 140)
    for i, key in enumerate("abc"):
        folder.write(key, bytes(100))
        os.utime(tmp_path / key, (i, i))
    assert folder.read("a") is not None  # used now
    folder.write("d", bytes(100))
    assert names(tmp_path) == ["a", "c", "d"]


def test_unfinished_files_of_stopped_processes_are_removed_after_a_while(tmp_path):
    old, new = tmp_path / f"old{UNFINISHED}", tmp_path / f"new{UNFINISHED}"
    for file in (old, new):
        file.write_bytes(b"half")
    then = time.time() - 2 * ABANDONED_AGE
    os.utime(old, (then, then))
    Folder(tmp_path).write("a", b"program")
    assert not old.exists()
    assert new.exists()


@pytest.mark.parametrize("kernel", [False, True])
def test_a_second_process_does_not_trace_and_gets_the_same_numbers_in_the_same_tree(tmp_path, kernel):
    first, second = Counted(inverse_rows), Counted(inverse_rows)
    a, b = answer(tmp_path, first, kernel=kernel), answer(tmp_path, second, kernel=kernel)
    assert first.traced > 0
    assert second.traced == 0
    assert jax.tree.structure(a) == jax.tree.structure(b)
    found = np.stack([np.stack(row, axis=-1) for row in b], axis=-2)
    np.testing.assert_allclose(found, np.linalg.inv(MATRICES), rtol=1e-12)


@pytest.mark.parametrize("scene", ["conical-pendulum", pytest.param("paper-case-2", marks=pytest.mark.check)])
def test_a_stored_run_gives_the_same_bits(tmp_path, scene):
    model, s = dj.build(dj.load_scene(scene))
    stepper = dj.make_stepper(model)
    settings = {"stepper": stepper, "saves": 8, "save_every": 2}
    values = model, begin(stepper, model, s), jnp.asarray(0.01), jnp.asarray(5, jnp.int32)
    run = lambda model, progress, dt, count: advance(  # noqa: E731
        stepper, model, progress, dt, saves=8, save_every=2, count=count
    )
    second = Counted(run)
    a, b = (answer(tmp_path, one, advance, settings, values) for one in (run, second))
    assert second.traced == 0
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for got, again in zip(*map(jax.tree.leaves, (a, b)), strict=True):
        np.testing.assert_array_equal(got, again)
        assert got.dtype == again.dtype


@pytest.mark.check
@pytest.mark.parametrize(
    ("devices", "scene", "choice", "most"),
    [
        pytest.param(1, "dropper-release-a", ', solver="dense"', 3, id="with LAPACK, not started there"),
        pytest.param(2, "conical-pendulum", "", 0, id="with several processors"),
    ],
)
def test_a_stored_program_runs_in_another_process(devices, scene, choice, most, tmp_path):
    code = f"""
import os, sys
if {devices} > 1: os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count={devices}"
import jax
import dropper_jax as dj
from dropper_jax.backend.programs import stored_programs
assert len(jax.devices()) == {devices}
dj.store_programs(sys.argv[1])
solution = dj.simulate("{scene}", duration=0.1{choice})
print(solution.positions[-1].sum(), stored_programs().loaded)
"""
    calls = [sys.executable, "-c", code, str(tmp_path)]
    first, second = (subprocess.run(calls, capture_output=True, text=True, check=True).stdout.split() for _ in "ab")
    assert first[0] == second[0]
    assert (first[1], int(second[1]) > most) == ("0", True)


OTHERS = [
    pytest.param(lambda patch: {"values": (MATRICES[:2],)}, id="shape"),
    pytest.param(lambda patch: {"values": (MATRICES.astype(jnp.float32),)}, id="precision"),
    pytest.param(lambda patch: {"values": ([MATRICES],)}, id="tree"),
    pytest.param(lambda patch: {"settings": {"saves": 3}}, id="static argument"),
    pytest.param(lambda patch: {"settings": {"saves": 3.0}}, id="kind of static argument"),
    pytest.param(lambda patch: {"settings": {"model": MATRICES}}, id="constants"),
    pytest.param(lambda patch: {"function": components}, id="function"),
    pytest.param(lambda patch: {"kernel": True}, id="kernel"),
    pytest.param(lambda patch: patch.setattr(stored, "_platform", lambda: ("another",)), id="processor"),
    pytest.param(lambda patch: patch.setattr(stored, "sources_digest", lambda: "changed"), id="sources"),
]


@pytest.mark.parametrize("other", OTHERS)
def test_another_program_is_stored_separately(tmp_path, monkeypatch, other):
    answer(tmp_path, inverse_rows)
    given = other(monkeypatch) or {}
    one = Counted(lambda x: inverse_rows(jax.tree.leaves(x)[0]))
    answer(tmp_path, one, **given)
    assert one.traced > 0
    assert len(names(tmp_path)) == 2


def test_programs_of_another_setting_of_jax_are_separate(tmp_path):
    answer(tmp_path, inverse_rows)
    one = Counted(inverse_rows)
    with jax.default_matmul_precision("float32"):
        answer(tmp_path, one)
    assert one.traced > 0


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_program_is_compiled_and_stored_again(tmp_path, damage):
    answer(tmp_path, inverse_rows)
    (file,) = tmp_path.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    for traces in (1, 0):
        one = Counted(inverse_rows)
        answer(tmp_path, one)
        assert (one.traced > 0) == (traces > 0)


@pytest.mark.parametrize("content", [b"no pickle", pickle.dumps(3), pickle.dumps((False, b"program", None, None))])
def test_content_that_is_no_program_is_compiled_again(tmp_path, content):
    answer(tmp_path, inverse_rows)
    (key,) = names(tmp_path)
    Folder(tmp_path).write(key, content)
    one = Counted(inverse_rows)
    answer(tmp_path, one)
    assert one.traced > 0
    assert len(Folder(tmp_path).read(key)) > 1000


def test_a_program_from_the_cache_of_jax_is_not_stored(tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "jax"))
    (tmp_path / "own").mkdir()
    answer(tmp_path / "own", inverse_rows)
    assert names(tmp_path / "own") == []


def test_sources_that_change_while_a_process_runs_keep_its_programs_out(tmp_path, monkeypatch):
    digests = iter(["at the start", "edited"])
    monkeypatch.setattr(stored, "sources_digest", lambda: next(digests))
    answer(tmp_path, inverse_rows)
    assert names(tmp_path) == []


def test_the_digest_of_the_sources_sees_every_change(tmp_path, monkeypatch):
    monkeypatch.undo()
    package = tmp_path / stored.PACKAGES[0]
    package.mkdir()
    seen = set()
    for text in ("a = 1", "a = 2"):
        (package / "one.py").write_text(text)
        seen.add(stored.sources_digest(tmp_path))
    (package / "one.py").rename(package / "two.py")
    seen.add(stored.sources_digest(tmp_path))
    assert len(seen) == 3


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners of files here")
def test_a_folder_of_another_user_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert store_programs(tmp_path) is None


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners of files here")
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_may_write_is_not_used(tmp_path, mode):
    folder = tmp_path / "programs"
    assert open_folder(folder) == folder
    folder.chmod(mode)
    assert open_folder(folder) is None


def test_a_folder_that_cannot_be_made_is_not_used(tmp_path):
    (tmp_path / "file").write_text("")
    assert store_programs(tmp_path / "file" / "folder") is None


def test_the_plain_backend_stores_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("DROPPER_BACKEND", "plain")
    assert store_programs(tmp_path) is None


@dataclass(frozen=True, eq=False)
class Setting:
    """A setting whose comparison sees none of its fields."""

    value: object


class Kind(Enum):
    ONE = 1


@pytest.mark.parametrize("value", [lambda x: x, object(), Kind.ONE, Setting(object()), np.sin], ids=range(5))
def test_values_without_a_stable_text_are_refused(value):
    with pytest.raises(NoStableText):
        stable_text(value)
    key = StoredPrograms(Folder(Path())).key(inverse_rows, {"setting": value}, (MATRICES,))
    assert key is None


def test_texts_of_different_values_differ():
    values = [1, 1.0, True, "1", None, (1,), [1], {1: 1}, {"1": 1}, np.ones(1), np.ones(1, int), np.ones((1, 1)), 0.1]
    texts = [stable_text(value) for value in values]
    assert len(set(texts)) == len(texts)
    stepper = dj.make_stepper(dj.build("conical-pendulum")[0])
    assert stable_text(stepper) == stable_text(dj.make_stepper(dj.build("conical-pendulum")[0]))
    assert stable_text(stepper) != stable_text(stepper.plain)


def test_the_check_of_an_installation_loads_what_it_has_stored():
    assert loads_stored_programs().ok


@pytest.mark.slow
def test_a_second_start_loads_all_programs_and_compiles_damaged_ones_again(tmp_path):
    first = run(tmp_path)
    files = programs_of(tmp_path)
    assert len(files) >= 3
    written = {file: file.stat().st_mtime_ns for file in files}
    for file in files:
        os.utime(file, (0, 0))
    second = run(tmp_path)
    assert set(programs_of(tmp_path)) == set(files)
    assert all(file.stat().st_mtime > 0 for file in files)  # each was used
    for file in files[::2]:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    third = run(tmp_path)
    assert set(programs_of(tmp_path)) == set(written)
    assert len({numbers(output.stdout) for output in (first, second, third)}) == 1
    assert all(Folder(file.parent).read(file.name) is not None for file in files)
    for output in (first, second, third):  # progress only
        assert all("% t = " in line for line in output.stderr.splitlines())


def test_no_part_of_this_project_redirects_a_descriptor_of_its_process():
    # the command line closes its output after its reader has, at the end of the process
    closing = "dropper_jax/cli/faults.py"
    packages = Path(__file__).parents[2]
    sources = [file for name in ("dropper_jax", "fitting") for file in (packages / name).rglob("*.py")]
    assert len(sources) > 300
    found = [str(file.relative_to(packages)) for file in sources if "dup2" in file.read_text(encoding="utf-8")]
    assert found == [closing]


@pytest.mark.check
def test_a_process_killed_while_it_writes_leaves_only_whole_programs(tmp_path):
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", RUN], env=environment, stdout=subprocess.DEVNULL)
    for _ in range(600):
        time.sleep(0.05)
        if programs_of(tmp_path):
            break
    process.send_signal(signal.SIGKILL)
    process.wait()
    for file in programs_of(tmp_path):
        assert Folder(file.parent).read(file.name) is not None
    assert "rror" not in run(tmp_path).stderr


def test_doctor_reports_a_process_that_does_not_end(monkeypatch):
    def never_ends(call, timeout, **options):
        raise subprocess.TimeoutExpired(call, timeout)

    monkeypatch.setattr("dropper_jax.study.doctor.subprocess.run", never_ends)
    check = loads_stored_programs()
    assert not check.ok
    assert "fails" in check.found
