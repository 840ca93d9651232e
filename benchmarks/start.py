"""Processor time from typing a command to its answer.

    python benchmarks/start.py [--repeats N] [--package FOLDER]     help, listings, mistakes: no simulation
    python benchmarks/start.py --programs [--package FOLDER]        first and second starts of what compiles

Each row is the least of N starts, user and system time of the process. With `--programs` each command is started twice
with a folder of compiled programs of its own, empty at first, each process on one processor. `--package` measures
another checkout.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from study import command, show

ROOT = Path(__file__).parents[1]
#: Prints the heavy packages that were imported as the last line.
PROBE = """
import sys
from dropper_jax.cli import main
try:
    main(sys.argv[1:])
finally:
    print(*(name for name in ("jax", "scipy", "matplotlib", "xarray") if name in sys.modules))
"""
BROKEN = "[run]\ndt = = 1\n"
#: A good scene, and what makes it a bad one.
SCENE, GOOD, BAD = "dropper_jax/data/scenes/paper-case-1.toml", "duration = ", "duration = -"


#: Commands that compile; TRACES is a file of angles of the lab dropper.
PROGRAMS = (
    "run dropper-release-a --duration 1",
    "equilibrium dropper-release-a",
    "fit TRACES --scene dropper-release-a --free b_l,b_q",
    "run edulis-longline --duration 1",
    "equilibrium edulis-longline",
    "accuracy dropper-release-a --quick",
)
#: Writes traces of the lab dropper, ten seconds of a known truth with noise.
TRACES = """
import sys
from fitting import write_trace
from fitting.traces.synthetic import Camera, synthetic_traces
write_trace(sys.argv[1], synthetic_traces(["dropper-release-a"], 10.0, Camera(angle_noise=0.005))[0])
"""


def starts(folder: Path, package: Path) -> list[list[str]]:
    """Commands to measure; two of them read a file with a mistake."""
    broken, bad_value = folder / "broken.toml", folder / "bad-value.toml"
    broken.write_text(BROKEN)
    bad_value.write_text((package / SCENE).read_text().replace(GOOD, BAD))
    return [
        ["--help"],
        ["--version"],
        ["run", "--help"],
        ["report", "--help"],
        ["scenes"],
        ["scenes", "paper-case-1"],
        ["nonsense"],
        ["run", "nonsense"],
        ["run", "missing.toml"],
        ["run", str(broken)],
        ["run", "paper-case-1", "--dt", "abc"],
        ["run", "paper-case-1", "--out", "run.txt"],
        ["view", "missing.npz", "--out", "view.html"],
        ["run", str(bad_value)],
        ["run", "paper-case-1", "--set", "run.dt=0"],
        ["run", "paper-case-1", "--integrator", "eulr"],
        ["run", "dropper-release-a", "--integrator", "rk4"],
    ]


def timed(words: list[str], folder: Path, **environment: str) -> tuple[float, subprocess.CompletedProcess[str]]:
    """Processor time [s] of Python with these words in a folder, and the process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, **environment}
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, env=environment, cwd=folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, done


def measure(argv: list[str], package: Path, repeats: int) -> tuple[float, str]:
    """Least processor time [s] of a start, and what heavy packages it imported."""
    runs = [timed(["-c", PROBE, *argv], package, PYTHONPATH=str(package)) for _ in range(repeats)]
    return min(spent for spent, _ in runs), runs[0][1].stdout.splitlines()[-1]


def first_and_second(line: str, package: Path, folder: Path) -> tuple[float, float]:
    """Processor times [s] of a command with an empty folder of compiled programs, and of the same command after it."""
    cache = folder / "-".join(line.split()[:2])
    words = [str(folder / "traces.csv") if word == "TRACES" else word for word in line.split()]
    paths = {"PYTHONPATH": str(package), "XDG_CACHE_HOME": str(cache)}
    first, second = (timed(["-m", "dropper_jax", *words], folder, **paths) for _ in range(2))
    if first[1].returncode:
        sys.exit(f"{line}: {first[1].stderr}")
    return first[0], second[0]


def programs(package: Path) -> None:
    """The table of first and second starts."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    show("command", "first start [s]", "second [s]")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        timed(["-c", TRACES, "traces.csv"], folder, PYTHONPATH=str(ROOT))
        for line in PROGRAMS:
            show(f"`{line}`", *(f"{spent:.1f}" for spent in first_and_second(line, package, folder)))


@command(repeats=5, package=ROOT, programs=False)
def main(args) -> None:
    package = args.package.resolve()
    if args.programs:
        programs(package)
        return
    show("command", "processor time [s]", "imports")
    with tempfile.TemporaryDirectory() as folder:
        for argv in starts(Path(folder), package):
            spent, imported = measure(argv, package, args.repeats)
            words = " ".join(Path(word).name if word.startswith("/") else word for word in argv)
            show(f"dropper {words}", f"{spent:.2f}", imported)
