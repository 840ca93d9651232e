"""What several commands share: their arguments and their output.

One JSON object or a short table is on standard output, all else on standard error.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import leftovers, references_of, refuse_pipe
from dropper_jax.base.toml_text import SCHEMA, jsonable, parsed_toml
from dropper_jax.integrators import SCHEMES
from dropper_jax.load.packaged import find_scene, folder_of

if TYPE_CHECKING:
    from dropper_jax.load.scene import Scene
    from dropper_jax.run.simulate import Solution

#: Value of `--dt` for the suggested step, which `run` shortens as its check advises.
AUTO = "auto"
SET_HELP = "change a value of the scene, such as effects.linear_damping.b_l=0.01 (may be given several times)"


def add_scene(parser: argparse.ArgumentParser, optional: bool = False) -> None:
    """SCENE, --set and --json."""
    what = "name of a packaged scene, a TOML file, a MoorDyn input, or a mooring of MoorPy or RAFT (.yaml)"
    parser.add_argument("scene", metavar="SCENE", help=what, **({"nargs": "?"} if optional else {}))
    parser.add_argument("--depth", type=number, help="water depth [m] for a MoorDyn input that has none")
    add_allow_outside(parser)
    add_effects(parser)
    add_set(parser)
    add_json(parser)


def add_effects(parser: argparse.ArgumentParser) -> None:
    """--effects."""
    about = "Python file with effects of your own that the scene uses (may be given several times)"
    parser.add_argument("--effects", action="append", default=[], metavar="FILE.py", help=about)


def register_effects(args: argparse.Namespace) -> None:
    """Make the effects of installed packages and of `--effects` known; imports JAX."""
    from dropper_jax.effects import register_file, register_installed

    register_installed()
    for file in args.effects:
        register_file(file)


def add_examples(parser: argparse.ArgumentParser, *examples: str) -> None:
    """Complete command lines at the end of the help."""
    parser.epilog = "\n".join(["examples:", *(f"  dropper {example}" for example in examples)])


def add_allow_outside(parser: argparse.ArgumentParser) -> None:
    """--allow-outside."""
    parser.add_argument("--allow-outside", action="store_true", help="allow the scene to use files outside its folder")


def add_set(parser: argparse.ArgumentParser) -> None:
    """--set."""
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=SET_HELP)


def add_run_values(parser: argparse.ArgumentParser, keys: Sequence[str]) -> None:
    """An option for each of these keys of `[run]`; `read_scene` puts their values into the scene."""
    for key in keys:
        parser.add_argument(f"--{key.replace('_', '-')}", **RUN_VALUES[key])


def add_json(parser: argparse.ArgumentParser) -> None:
    """--json."""
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """--quiet."""
    parser.add_argument("--quiet", action="store_true", help="no progress")


def read_scene(args: argparse.Namespace, run_values: Sequence[str] = (), notes: bool = True) -> Scene:
    """The scene with `--set` and options for keys of `[run]`; JAX is imported after the file was found to be TOML.

    Args:
        notes: print what its source file has and the scene lacks; False if the warnings of the command contain it.
    """
    values = given_values(args, run_values)
    if args.scene is None:
        raise SceneError("SCENE: missing; needed: the name of a packaged scene or a file")
    with references_of(folder_of(args.scene, vars(args).get("allow_outside", True))):
        table, name = find_scene(args.scene, vars(args).get("depth"))

        from dropper_jax.load.scene import Scene

        register_effects(args)
        scene = Scene.from_dict(table, name)
    if notes:
        print_warnings(scene.notes)
    return with_step(scene.with_values(values) if values else scene, args)


def with_step(scene: Scene, args: argparse.Namespace) -> Scene:
    """The scene with the suggested step for `--dt auto`, which is printed."""
    if vars(args).get("dt") != AUTO:
        return scene

    from dropper_jax.load.periods import suggest_step

    step = suggest_step(scene)
    print_line(f"time step: {step:g} s (--dt auto)")
    return scene.with_values({"run.dt": step})


def given_values(args: argparse.Namespace, run_values: Sequence[str] = ()) -> dict[str, Any]:
    """Values by path from `--set` and options for keys of `[run]`."""
    given = {f"run.{key}": getattr(args, key) for key in run_values}
    return assignments(args.set) | {path: value for path, value in given.items() if value not in (None, AUTO)}


def read_run(file: str, args: argparse.Namespace) -> Solution:
    """A saved run; JAX is imported after the file, or the rest of a killed run, was found."""
    path = Path(file)
    refuse_pipe(path, "run")
    left = leftovers(path) if not path.exists() else []
    try:
        if not left and not (path.suffix.lower() == ".zarr" and path.is_dir()):
            open(path, "rb").close()
    except OSError as error:
        raise SceneError(f"{file}: cannot be read: {error.strerror or error}") from None

    from dropper_jax.run.simulate import Solution

    register_effects(args)
    if left:
        recover_leftovers(path)
    return Solution.load(file)


def recover_leftovers(file: Path) -> None:
    """Recover and report the files of a killed run next to a file."""
    from dropper_jax.run.recovery import recover

    print_warnings(recover(file))


def assignments(texts: list[str]) -> dict[str, Any]:
    """Values by path of several `KEY=VALUE`."""
    return dict(_assignment(text) for text in texts)


def _assignment(text: str) -> tuple[str, Any]:
    """Path and value of `KEY=VALUE`; the value is read as TOML, or as plain text if it is not valid TOML."""
    path, equals, value = text.partition("=")
    if not equals or not path.strip():
        raise SceneError(f"--set: {text!r} is not KEY=VALUE; allowed: a path, '=' and a value, such as run.dt=0.01")
    try:
        return path.strip(), parsed_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path.strip(), value.strip()


def output_file(
    text: str | Path | None, option: str, suffixes: tuple[str, ...], folders: tuple[str, ...] = ()
) -> Path | None:
    """A file to write; a wrong suffix or folder is rejected early. `folders` are suffixes of folders."""
    if text is None:
        return None
    path = Path(text)
    if path.suffix.lower() not in suffixes:
        raise SceneError(f"{option}: {text!r} has no known suffix; allowed: {', '.join(suffixes)}")
    if not path.parent.is_dir():
        raise SceneError(f"{option}: the folder {str(path.parent)!r} does not exist; allowed: an existing one")
    if path.is_dir() and path.suffix.lower() not in folders:
        raise SceneError(f"{option}: {text!r} is a folder; allowed: a file")
    return path


def output_folder(text: str | Path | None, option: str) -> Path | None:
    """A folder to write to, which need not exist; a file is rejected before the work starts."""
    if text is None:
        return None
    path = Path(text)
    if path.exists() and not path.is_dir():
        raise SceneError(f"{option}: {text!r} is a file; allowed: a folder")
    above = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise SceneError(f"{option}: {text!r} cannot be made in {str(above)!r}; allowed: a writable folder")
    return path


def number(text: str) -> float:
    """A number on the command line; its range is checked with the scene."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None


def step_length(text: str) -> float | str:
    """A time step on the command line: a number, or `auto`."""
    if text == AUTO:
        return AUTO
    return number(text)


def read_numbers(
    text: str, option: str, reason: str, mark: str = ",", count: int | None = None, given: str | None = None
) -> list[float]:
    """Numbers separated by `mark`, this many if `count` is given, such as those of `LO:HI:N`.

    Raises:
        SceneError: `OPTION: TEXT REASON`, where TEXT is `given` if the numbers are a part of it.
    """
    try:
        found = [float(part) for part in text.split(mark)]
    except ValueError:
        found = []
    if not found or count not in (None, len(found)):
        raise SceneError(f"{option}: {(text if given is None else given)!r} {reason}")
    return found


def read_spaced(text: str, option: str, reason: str, given: str | None = None) -> tuple[float, float, int]:
    """Ends and whole number, at least 1, of values of `LO:HI:N`."""
    low, high, count = read_numbers(text, option, reason, ":", 3, given)
    if not count.is_integer() or count < 1:
        raise SceneError(f"{option}: {(text if given is None else given)!r} {reason}")
    return low, high, int(count)


def read_named_range(text: str, option: str, reason: str) -> tuple[str, float, float]:
    """Name and ends of `NAME=LO:HI`."""
    name, _, limits = text.partition("=")
    low, high = read_numbers(limits, option, reason, ":", 2, given=text)
    return name.strip(), low, high


def positive_integer(text: str) -> int:
    """A whole number on the command line, at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number >= 1")
    return int(text)


#: Signals and statistics of `dropper_jax.run.quantities`, which imports JAX.
SIGNALS = (
    *("tension", "anchor", "angle", "line", "curvature", "offset", "excursion", "depth", "x", "y", "z", "period"),
    "energy",
)
STATISTICS = ("max", "min", "mean", "final", "start", "std", "fatigue", "peak", "sustained", "mpm")
QUANTITY_HELP = (
    "SIGNAL[.WHERE].STATISTIC, such as tension.3.max, tension.west-leg.fairlead.max, anchor.west.horizontal.max or "
    f"offset.buoy.max; signals: {', '.join(SIGNALS)}; statistics: {', '.join(STATISTICS)}"
)
#: Options for values of `[run]`, by their key.
RUN_VALUES: dict[str, dict[str, Any]] = {
    "integrator": {"metavar": "NAME", "help": f"time integration scheme: {', '.join(SCHEMES)}"},
    "solver": {"metavar": "NAME", "help": "linear solver: auto, dense, banded, condensed or network"},
    "dt": {
        "type": step_length,
        "metavar": "S",
        "help": "length of equal steps [s]; auto: the step of `dropper check`, in `run` an accuracy of 0.01",
    },
    "duration": {"type": number, "help": "simulated time [s]"},
    "dtype": {"metavar": "NAME", "help": "float64 or float32"},
    "accuracy": {
        "type": number,
        "help": "choose the steps by their error: required relative accuracy of positions and tensions, such as 0.01",
    },
    "save_interval": {"type": number, "metavar": "S", "help": "time between saved states [s]"},
    "gamma": {"type": number, "help": "weight of the new time in the theta schemes, 0 to 1"},
    "rho_infinity": {
        "type": number,
        "help": "fraction of the highest-frequency amplitude that a step of generalized_alpha keeps, 0 to 1",
    },
}


# Output of commands and exit codes

OK = 0
INVALID_INPUT = 2
#: A run or a search failed; its partial result is kept.
FAILED = 3
INTERRUPTED = 130

#: Status and message of what failed.
Failure = tuple[str, str]
#: The failure of a command that the user stopped; its partial result is printed.
STOPPED: Failure = ("interrupted", "interrupted")


def print_json(found: dict[str, Any]) -> None:
    """The one object on standard output; NaN and infinity as null."""
    print(json.dumps(jsonable(found), allow_nan=False), flush=True)


def print_result(as_json: bool, found: dict[str, Any], text: str = "", failure: Failure | None = None) -> int:
    """Print the result of a command, its JSON object or its text, and what failed; returns the exit code."""
    if as_json:
        print_json(with_failure(found, failure))
    elif text:
        print(text)
    if failure is None:
        return OK
    print_line(f"error: {failure[1]}")
    if failure == STOPPED:
        return INTERRUPTED
    return FAILED


def shorten(text: str) -> str:
    """A message with very long words cut: names of 100 000 letters, binary files taken for text."""
    # paths have up to 500 characters; longer words are cut to 60
    return re.sub(r"\S{501,}", lambda found: f"{found[0][:60]}... ({len(found[0])} characters)", text)


def print_line(text: str) -> None:
    """Print a line on standard error, if that can be written."""
    with suppress(OSError):
        print(shorten(text), file=sys.stderr, flush=True)


def print_warnings(warnings: Iterable[str]) -> None:
    """Print a line for each on standard error."""
    for warning in warnings:
        print_line(f"warning: {warning}")


def failure_object(status: str, message: str) -> dict[str, Any]:
    """The JSON object of a failed command."""
    return {"schema": SCHEMA, "status": status, "error": shorten(message)}


def with_failure(found: dict[str, Any], failure: Failure | None) -> dict[str, Any]:
    """A JSON object with the status and the message of what failed."""
    if failure is None:
        return found
    return {**found, **failure_object(*failure)}


def done_object(**values: Any) -> dict[str, Any]:
    """The JSON object of a successful command."""
    return {"schema": SCHEMA, "status": "ok", **values}


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns, the first one flush left, the others flush right."""
    first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
    cells = ([row[0].ljust(first), *map(str.rjust, row[1:], others)] for row in rows)
    return "\n".join("  ".join(row).rstrip() for row in cells)


def listing(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values, one pair per line."""
    width = max(len(name) for name, _ in pairs)
    return "\n".join(f"{name.ljust(width)}  {value}" for name, value in pairs)


def progress(quiet: bool = False) -> Callable[[float, str], None] | None:
    """A function `(fraction, text)` that shows progress: a bar on a terminal, a few lines elsewhere, None if quiet."""
    if quiet:
        return None
    if sys.stderr.isatty():
        return _bar()
    return _lines()


def row_printer(head: Sequence[str], quiet: bool = False) -> Callable[[Sequence[str]], None]:
    """A function that prints a row of a table on standard error, below its head; nothing if quiet.

    For rows that take long: the table itself follows on standard output.
    """
    # width of the first and minimum width of the other columns
    widths = [20, *(max(len(text), 10) for text in head[1:])]
    printed = False

    def show(cells: Sequence[str]) -> None:
        nonlocal printed
        rows = [cells] if printed else [head, cells]
        printed = True
        for first, *others in [] if quiet else rows:
            line = [first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]
            print_line("  ".join(line))

    return show


def _bar() -> Callable[[float, str], None]:
    last = 0.0

    def show(fraction: float, text: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if fraction < 1.0 and now - last < 0.1:  # ten times a second looks smooth and has no noticeable cost
            return
        last = now
        bar = "#" * int(30 * min(max(fraction, 0.0), 1.0))
        end = "\n" if fraction >= 1.0 else ""
        with suppress(OSError):
            print(f"\r[{bar:.<30}] {100 * fraction:3.0f} % {text:<40}", end=end, file=sys.stderr, flush=True)

    return show


def _lines() -> Callable[[float, str], None]:
    reached = 0

    def show(fraction: float, text: str = "") -> None:
        nonlocal reached
        # without a terminal a progress line is printed at these fractions of the run
        marks = sum(fraction >= mark for mark in (0.25, 0.5, 0.75, 1.0))
        if marks > reached:
            print_line(f"{100 * fraction:3.0f} % {text}".rstrip())
        reached = max(marks, reached)

    return show
