"""What studies share: results in `results/`, the machine they were made on, tables in Markdown."""

import argparse
import json
import os
import platform
import re
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
Rows = list[tuple[str, ...]]
#: Name of a table: results (`results/NAME.json`) that it is made of, and rows or Markdown made of them.
TABLES: dict[str, tuple[tuple[str, ...], Callable[..., Rows | str]]] = {}
Found = dict[str, Any]


def table_of(*results: str, name: str = "") -> Callable[[Callable[..., Rows | str]], Callable[..., Rows | str]]:
    """Enter a table of these results, by the name of its function unless given."""

    def entered(make: Callable[..., Rows | str]) -> Callable[..., Rows | str]:
        TABLES[name or make.__name__] = results, make
        return make

    return entered


def stored(name: str | Path, default: Any = None) -> Any:
    """Results of a study, in `results/` or in a file of the user's; the default where there are none yet."""
    file = RESULTS / f"{name}.json" if isinstance(name, str) else name
    if default is None or file.exists():
        return json.loads(file.read_text())
    return default


def store(name: str | Path, found: Any) -> None:
    """Keep results of a study, in `results/` or in a file of the user's; not a number is null."""
    from dropper_jax.base.files import atomic_write
    from dropper_jax.base.json_values import jsonable

    file = RESULTS / f"{name}.json" if isinstance(name, str) else name
    atomic_write(file, json.dumps(jsonable(found), indent=1, ensure_ascii=False) + "\n")


def say(found: Any) -> None:
    """Print what was just found, on one line."""
    print(json.dumps(found, default=str), flush=True)


def timed(work: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """What a piece of work gives, and its time by the clock and of the processor [s]."""
    clock = time.perf_counter()
    processor = time.process_time()
    found = work()
    return found, {"seconds": time.perf_counter() - clock, "processor_s": time.process_time() - processor}


def seeds_of(text: str) -> range:
    """The seeds of `FIRST:LAST`, without the last."""
    first, last = map(int, text.split(":"))
    return range(first, last)


def spread(values: Any) -> dict[str, float]:
    """Minimum, mean, standard deviation and maximum of a series."""
    return {name: float(getattr(values, name)()) for name in ("min", "mean", "std", "max")}


def describe() -> dict[str, object]:
    """Processor, cores and Python of this machine."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
    }


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        named = re.findall(r"model name\s*: (.*)", information.read_text())
    else:
        named = []
    return next(iter(named), platform.processor() or platform.machine())


def versions(*names: str) -> dict[str, str]:
    """Versions of packages."""
    return {name: metadata.version(name) for name in names}


def markdown(rows: Rows) -> str:
    """Rows as a Markdown table, the first one the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + " --- |" * len(rows[0]), *lines[1:]])


def columns(rows: Iterable[Found], *table: tuple) -> Rows:
    """The head, and of each row its cells.

    Args:
        table: head of each column, and a format of the row's values, or a function of the row and more arguments.
    """

    def cell(row: Found, made: str | Callable[..., str], *arguments: Any) -> str:
        if callable(made):
            return made(row, *arguments)
        return made.format(**row)

    return [tuple(head for head, *_ in table), *(tuple(cell(row, *made) for _, *made in table) for row in rows)]


def joined(values: Sequence[float], form: str, between: str = ", ") -> str:
    """Numbers in one cell."""
    return between.join(form.format(value) for value in values)


def percent(x: float, digits: int = 0, sign: str = "") -> str:
    return f"{100 * x:{sign}.{digits}f} %"


def kilo(newton: float) -> str:
    return f"{newton / 1e3:.1f}"


def milli(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def command(
    words: Mapping[str, Any] | None = None, **known: Any
) -> Callable[[Callable[..., int | None]], Callable[..., int | None]]:
    """Run the function, the last of its file, as a command where the file is the program, with what `options` reads."""

    def entered(run: Callable[..., int | None]) -> Callable[..., int | None]:
        if run.__module__ == "__main__":
            given = options(sys.modules["__main__"].__doc__, words, **known)
            sys.exit(run(given) if words or known else run())
        return run

    return entered


def collect(
    name: str | Path, parts: Mapping[str, Iterable[Found]], only: str | None = None, by: str | None = None, **head: Any
) -> None:
    """Measure the rows of all parts, or of one, instead of the stored ones; print each row and store it with `head`.

    Args:
        parts: rows by part, measured as they are taken.
        by: where given, rows replace only those with the same value of it.
    """
    found = {**(stored(name, {}) if only or by else {}), **head}
    for part, rows in parts.items():
        if only in (None, part):
            known = {row[by]: row for row in found.get(part, [])} if by else {}
            for i, row in enumerate(rows):
                known[row[by] if by else i] = row
                found[part] = list(known.values())
                say(row)
                store(name, found)


def show(*cells: object) -> None:
    """Print one row of a Markdown table."""
    print("|", " | ".join(map(str, cells)), "|", flush=True)


def options(doc: str | None, words: Mapping[str, Any] | None = None, **known: Any) -> argparse.Namespace:
    """Options of a command by name and default, described by the module's text; `words` are given without a name.

    False: a flag. A list: some of its members, all unless given. A tuple: one of its members, the first unless given,
    of which None is none. A type: a value of it, None unless given; of a word in a list any number of them.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, given in (words or {}).items():
        parser.add_argument(name, **_settings(given, metavar=name))
    for name, given in known.items():
        parser.add_argument(f"--{name}", **_settings(given))
    return parser.parse_args()


def _settings(given: Any, **more: str) -> dict[str, Any]:
    """What argparse is given of an option, or of a word by its `metavar`."""
    if given is False:
        return {"action": "store_true"}
    if isinstance(given, type):
        return {"type": given, **more}
    if isinstance(given, tuple):
        return {"choices": [one for one in given if one is not None], **({} if more else {"default": given[0]})}
    if isinstance(given, list) and isinstance(given[0], type):
        return {"nargs": "*", "type": given[0], **more}
    if isinstance(given, list):  # of a word the default is compared with the choices too
        choices = [*given, given] if more else given
        return {"nargs": "*", "type": type(given[0]), "choices": choices, "default": given, **more}
    return {"type": type(given), "default": given}
