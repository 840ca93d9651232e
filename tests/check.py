"""Parts of `make check`: what does not fit into `make test`, two processes at a time, each part's output in a file.

    python tests/check.py [--jobs 2] [--only PART ...] [--list]

A part that fails is reported at once with the end of its output, and the others continue. A table is printed at the
end, and the exit status is 1 if any part failed, ran out of time or was not found. Parts are single processes; those
that take longest start first, so that two cores are busy to the end.
"""

import argparse
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: After this long a part hangs [s].
MOST = 3600.0
#: Lines of output printed where a part fails.
PRINTED_LINES = 40
#: Only the parts themselves use the cores: threads of OpenBLAS beside them wait for each other.
ALONE = {"OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
#: One line for each test, with its time: a part that runs out of time says how far it came and what took long.
TESTS = ("-m", "pytest", "-v", "-o", "console_output_style=times", "--durations=10", "--durations-min=5")


@dataclass(frozen=True)
class Part:
    """A command of this Python, with what it changes in the environment."""

    name: str
    call: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    part: Part
    minutes: float
    code: int | None
    printed: str

    @property
    def word(self) -> str:
        if self.code is None:
            return "FAILED: ran out of time"
        return "ok" if self.code == 0 else f"FAILED: exit status {self.code}"


def marked(name: str, *where: str) -> Part:
    """Tests marked `check`."""
    return Part(f"check {name}", (*TESTS, "-m", "check", *where))


def as_users(name: str, *where: str, without: str = "slow or check") -> Part:
    """Tests with programs compiled as users get them, without the flags of conftest.py.

    Those marked `slow` or `check` compile largest: but for the derivatives of every kind of step they run with the
    quick flags only, which change rounding alone.
    """
    return Part(f"as users {name}", (*TESTS, "-m", f"not ({without})", *where), {"TESTS_CHOSE_XLA_FLAGS": "no"})


def plain(name: str, *where: str) -> Part:
    """Tests without stored programs, kernels and lanes: all of that must be only faster."""
    return Part(f"plain {name}", (*TESTS, *where), {"DROPPER_BACKEND": "plain"})


#: Folders whose marked tests are parts of their own; the part `check rest` takes all others.
APART = ("fitting", "effects", "stepping", "integrators", "docs", "moordyn", "statics")
CALIBRATION = "tests/fitting/calibration"
#: Fits of measured traces, of which one takes half an hour.
MEASURED = f"{CALIBRATION}/test_measured.py"
#: Every command and piece of Python of the pages.
PAGES = "tests/docs/test_everything_runs.py"
#: The catalogue in short, which `hard cases` runs in full.
SHORT_CASES = "tests/hard_cases/test_hard_cases.py::test_hard_case_keeps_its_claim"
#: Longest first.
PARTS = (
    marked("calibration", CALIBRATION, f"--ignore={MEASURED}"),
    marked("measured", MEASURED),
    marked("fitting", "tests/fitting", f"--ignore={CALIBRATION}"),
    marked("rest", "tests", *(f"--ignore=tests/{name}" for name in APART), f"--deselect={SHORT_CASES}"),
    marked("moorings", "tests/moordyn", "tests/statics"),
    Part("hard cases", ("-m", "dropper_jax", "stability", "--quiet")),
    as_users("effects", "tests/effects"),
    marked("pages", PAGES),
    marked("effects", "tests/effects"),
    marked("docs", "tests/docs", f"--ignore={PAGES}"),
    as_users("stepping", "tests/stepping"),
    as_users("derivatives", "tests/stepping/test_step_derivatives.py", without="check"),
    # reports where there is none
    Part("browser", (*TESTS, "-k", "browser", "tests/docs/test_site.py", "tests/report/page")),
    Part("figures of the sources", ("benchmarks/source_figures.py", "all", "--plot", "build/check/figures")),
    Part("many scenes", ("tests/many_scenes.py",)),
    Part(
        "random calls",
        ("tests/faults/sequences.py", "--sequences", "6"),
        {"XLA_FLAGS": "--xla_backend_optimization_level=0"},
    ),
    Part("random scenes", (*TESTS, "tests/load/test_fuzz.py"), {"FUZZ_EXAMPLES": "2000"}),
    as_users("schemes", "tests/integrators", "tests/solvers", "tests/report/page"),
    marked("steps", "tests/stepping", "tests/integrators"),
    plain("steps", "tests/stepping", "tests/integrators", "tests/solvers", "tests/effects"),
    plain("fits", "tests/fitting/estimate", "tests/fitting/calibration", "tests/fitting/sensitivity"),
    Part("damaged files", (*TESTS, "tests/faults/test_fuzz_files.py"), {"FUZZ_FILES": "2000"}),
)


def tail(text: str, lines: int = PRINTED_LINES) -> str:
    return "\n".join(text.rstrip().splitlines()[-lines:])


def last_word(text: str) -> str:
    """The last line that says anything, rules of `=` taken off: pytest's sum, or a table's last row."""
    lines = [line.strip("= ") for line in text.splitlines() if line.strip("= ")]
    return re.sub(r"\s+", " ", lines[-1])[:70] if lines else ""


def run(part: Part, out: Path, printing: threading.Lock) -> Outcome:
    path = out / f"{part.name.replace(' ', '-')}.txt"
    with printing:
        print(f"starts: {part.name}", flush=True)
    started = time.monotonic()
    with path.open("w") as file:
        try:
            done = subprocess.run(
                [sys.executable, *part.call],
                cwd=ROOT,
                env={**os.environ, **ALONE, **part.environment},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                timeout=MOST,
                check=False,
            )
            code = done.returncode
        except subprocess.TimeoutExpired:
            code = None
    printed = path.read_text(errors="replace")
    outcome = Outcome(part, (time.monotonic() - started) / 60.0, code, last_word(printed))
    with printing:
        print(f"ends:   {part.name}, {outcome.minutes:.1f} min, {outcome.word}", flush=True)
        if code != 0:
            print(f"{tail(printed)}\n(whole output: {path})", flush=True)
    return outcome


def table(found: list[Outcome], minutes: float) -> str:
    rows = [("part", "minutes", "outcome", "last line")]
    rows += [(one.part.name, f"{one.minutes:.1f}", one.word, one.printed) for one in found]
    rows.append(("all", f"{minutes:.1f}", "ok" if all(one.code == 0 for one in found) else "FAILED", ""))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def main(arguments: list[str] | None = None, parts: tuple[Part, ...] = PARTS) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time (default: 2)")
    parser.add_argument("--only", nargs="+", metavar="PART", default=[], help="names, or how they begin (default: all)")
    parser.add_argument("--list", action="store_true", help="print the parts and their commands, run none")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "check", help="folder of the outputs")
    args = parser.parse_args(arguments)
    chosen = [part for part in parts if not args.only or part.name.startswith(tuple(args.only))]
    if not chosen:
        print(f"error: --only {' '.join(args.only)}: no such part; allowed: {', '.join(p.name for p in parts)}")
        return 2
    if args.list:
        for part in chosen:
            print(f"{part.name}: {' '.join([*(f'{k}={v}' for k, v in part.environment.items()), *part.call])}")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    printing, started = threading.Lock(), time.monotonic()
    with ThreadPoolExecutor(max_workers=args.jobs) as pool:
        found = list(pool.map(lambda part: run(part, args.out, printing), chosen))
    print(table(found, (time.monotonic() - started) / 60.0), flush=True)
    return int(any(one.code != 0 for one in found))


if __name__ == "__main__":
    sys.exit(main())
