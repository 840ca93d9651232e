"""Processor time from typing a command to its answer, where the answer needs no simulation: help, listings, mistakes.

    python benchmarks/start.py [--repeats N] [--package FOLDER]

Each row is the least of N starts, user and system time of the process. `--package` measures another checkout.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

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


def measure(argv: list[str], package: Path, repeats: int) -> tuple[float, str]:
    """Least processor time [s] of a start, and what heavy packages it imported."""
    environment = {**os.environ, "PYTHONPATH": str(package)}
    spent, imported = [], ""
    for _ in range(repeats):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        call = [sys.executable, "-c", PROBE, *argv]
        done = subprocess.run(call, capture_output=True, text=True, check=False, env=environment, cwd=package)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
        imported = done.stdout.splitlines()[-1]
    return min(spent), imported


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, metavar="N")
    parser.add_argument("--package", type=Path, default=ROOT, metavar="FOLDER")
    args = parser.parse_args()
    package = args.package.resolve()
    print("| command | processor time [s] | imports |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for argv in starts(Path(folder), package):
            spent, imported = measure(argv, package, args.repeats)
            words = " ".join(Path(word).name if word.startswith("/") else word for word in argv)
            print(f"| dropper {words} | {spent:.2f} | {imported} |", flush=True)


if __name__ == "__main__":
    main()
