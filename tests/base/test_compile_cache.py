"""Programs kept from one process to the next: what is damaged is made again, and nobody hears of it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dropper_jax.backend.compile_cache import ABANDONED, UNFINISHED, Entries
from dropper_jax.backend.programs import supported_options

RUN = "import sys; from dropper_jax.cli import main; sys.exit(main(['run', 'conical-pendulum', '--duration', '0.1']))"


def environment(folder, **more):
    return {**os.environ, "DROPPER_COMPILE_CACHE": str(folder), **more}


def run(folder, **more):
    call = [sys.executable, "-c", RUN]
    return subprocess.run(call, env=environment(folder, **more), capture_output=True, text=True, check=True)


def entries(folder):
    (place,) = folder.iterdir()
    return [file for file in place.iterdir() if file.suffix != UNFINISHED]


def test_what_is_put_is_got_and_what_is_damaged_goes(tmp_path):
    cache = Entries(tmp_path)
    assert cache.get("a") is None
    cache.put("a", b"program")
    assert cache.get("a") == b"program"
    for spoil in (
        lambda whole: whole[:-1],
        lambda whole: whole[:3],
        lambda whole: whole[:-1] + b"x",
        lambda whole: b"",
    ):
        cache.put("a", b"program")
        (tmp_path / "a").write_bytes(spoil((tmp_path / "a").read_bytes()))
        assert cache.get("a") is None
        assert not (tmp_path / "a").exists()


def test_the_ones_not_used_for_longest_go(tmp_path):
    cache = Entries(tmp_path, largest=3 * 140)
    for i, key in enumerate("abc"):
        cache.put(key, bytes(100))
        os.utime(tmp_path / key, (i, i))
    assert cache.get("a") is not None  # used now
    cache.put("d", bytes(100))
    assert {file.name for file in tmp_path.iterdir()} == {"a", "c", "d"}


def test_what_a_stopped_process_left_goes_after_a_while(tmp_path):
    old, new = tmp_path / f"old{UNFINISHED}", tmp_path / f"new{UNFINISHED}"
    for file in (old, new):
        file.write_bytes(b"half")
    then = time.time() - 2 * ABANDONED
    os.utime(old, (then, then))
    Entries(tmp_path).put("a", b"program")
    assert not old.exists()
    assert new.exists()


@pytest.mark.slow
def test_a_second_start_takes_the_programs_and_damaged_ones_are_made_again(tmp_path):
    first = run(tmp_path)
    files = entries(tmp_path)
    assert len(files) > 5
    times = {file.name: file.stat().st_ino for file in files}
    for file in files:
        os.utime(file, (0, 0))
    second = run(tmp_path)
    assert {file.name: file.stat().st_ino for file in entries(tmp_path)} == times  # none was written again
    # all but the programs on which the compiler's options were tried, once for all
    taken = [file for file in files if file.stat().st_mtime > 0]
    assert len(taken) >= len(files) - len(supported_options())
    for file in taken[::2]:
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    third = run(tmp_path)
    assert {file.name for file in entries(tmp_path)} == set(times)
    assert len({numbers(output.stdout) for output in (first, second, third)}) == 1
    # what was damaged is whole again
    assert all(Entries(file.parent).get(file.name) is not None for file in entries(tmp_path))
    assert "persistent" not in second.stderr + third.stderr
    assert "feature" not in second.stderr + third.stderr


LOADING_THREADS = """
import os, sys, threading
import jax, jax.numpy as jnp
import dropper_jax as dj
dj.compile_cache(sys.argv[1])
x = jnp.arange(3.0)

def load(number):
    for i in range(6):
        jax.jit(lambda x: jnp.cos(x * (number + 2)) + i)(x)
        os.write(2, b"written\\n")

threads = [threading.Thread(target=load, args=(number,)) for number in range(2)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
os.write(2, b"written last\\n")
"""


def test_threads_that_load_programs_keep_what_is_written_to_standard_error(tmp_path):
    for _ in range(2):  # the second process loads what the first one has compiled
        call = [sys.executable, "-c", LOADING_THREADS, str(tmp_path)]
        environment = {**os.environ, "TF_CPP_MIN_LOG_LEVEL": "3"}
        done = subprocess.run(call, env=environment, capture_output=True, text=True, check=True)
        assert done.stderr == 12 * "written\n" + "written last\n"


def test_no_part_of_this_project_redirects_a_descriptor_of_its_process():
    # the command line closes its output after its reader has, at the end of the process
    closing = "dropper_jax/cli/faults.py"
    packages = Path(__file__).parents[2]
    sources = [file for name in ("dropper_jax", "fitting") for file in (packages / name).rglob("*.py")]
    assert len(sources) > 300
    found = [str(file.relative_to(packages)) for file in sources if "dup2" in file.read_text(encoding="utf-8")]
    assert found == [closing]


def numbers(text):
    """The lines of a run's output that do not tell times."""
    return "\n".join(line for line in text.splitlines() if "compil" not in line and " s" not in line)


@pytest.mark.check
def test_a_process_killed_while_it_writes_leaves_only_whole_programs(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", RUN], env=environment(tmp_path), stdout=subprocess.DEVNULL)
    for _ in range(600):
        time.sleep(0.05)
        if any(tmp_path.glob("*/*")):
            break
    process.send_signal(signal.SIGKILL)
    process.wait()
    for file in entries(tmp_path):
        assert Entries(file.parent).get(file.name) is not None
    assert "persistent" not in run(tmp_path).stderr
