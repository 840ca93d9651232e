"""Output of commands: one JSON object or a short table on standard output, all else on standard error. Exit codes."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

from dropper_jax.base.toml_text import SCHEMA, jsonable

OK = 0
INVALID_INPUT = 2
#: A run or a search failed; its partial result is kept.
FAILED = 3
INTERRUPTED = 130


#: Status and message of what failed.
Failure = tuple[str, str]


def print_json(found: dict[str, Any]) -> None:
    """The one object on standard output; NaN and infinity as null."""
    print(json.dumps(jsonable(found), allow_nan=False), flush=True)


def print_result(as_json: bool, found: dict[str, Any], text: str = "", failure: Failure | None = None) -> int:
    """Print the result of a command, its JSON object or its text, and what failed; returns the exit code."""
    if as_json:
        print_json(with_failure(found, failure))
    elif text:
        print(text)
    if failure is not None:
        print_line(f"error: {failure[1]}")
    return OK if failure is None else FAILED


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
    return found if failure is None else {**found, **failure_object(*failure)}


def done_object(**values: Any) -> dict[str, Any]:
    """The JSON object of a successful command."""
    return {"schema": SCHEMA, "status": "ok", **values}


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns, the first one flush left, the others flush right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def listing(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values, one pair per line."""
    width = max(len(name) for name, _ in pairs)
    return "\n".join(f"{name.ljust(width)}  {value}" for name, value in pairs)


def progress(quiet: bool = False) -> Callable[[float, str], None] | None:
    """A function `(fraction, text)` that shows progress: a bar on a terminal, a few lines elsewhere, None if quiet."""
    if quiet:
        return None
    return _bar() if sys.stderr.isatty() else _lines()


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
