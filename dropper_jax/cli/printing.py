"""Output of commands: one JSON object or a short table on standard output, all else on standard error; exit codes."""

from __future__ import annotations

import json
import re
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Protocol

from dropper_jax.base.json_values import SCHEMA, jsonable
from dropper_jax.base.progress import Progress, silent
from dropper_jax.base.read import Table
from dropper_jax.base.table_cells import Columns, Record, record_cells

OK = 0
INVALID_INPUT = 2
#: A run or a search failed; its partial result is kept.
FAILED = 3
INTERRUPTED = 130

#: Status and message of what failed.
Failure = tuple[str, str]
#: The failure of a command that the user stopped; its partial result is printed.
STOPPED: Failure = ("interrupted", "interrupted")


def print_json(found: Table) -> None:
    """The one object on standard output; NaN and infinity as null."""
    print(json.dumps(jsonable(found), allow_nan=False), flush=True)


class Ended(Protocol):
    """What ends with a status and, unless that is ok, a message."""

    @property
    def status(self) -> str: ...

    @property
    def message(self) -> str: ...


def failure_of(found: Ended) -> Failure | None:
    """Status and message of an equilibrium, a design or a fit that failed."""
    if found.status == "ok":
        return None
    return found.status, f"{found.status}: {found.message}"


def print_result(args: Namespace, found: Table, text: str = "", failure: Failure | None = None) -> int:
    """Print the result of a command, its JSON object or its text, and what failed; returns the exit code."""
    if args.json:
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


def failure_object(status: str, message: str) -> Table:
    """The JSON object of a failed command."""
    return {"schema": SCHEMA, "status": status, "error": shorten(message)}


def with_failure(found: Table, failure: Failure | None) -> Table:
    """A JSON object with the status and the message of what failed."""
    if failure is None:
        return found
    return {**found, **failure_object(*failure)}


def done_object(**values: object) -> Table:
    """The JSON object of a successful command."""
    return {"schema": SCHEMA, "status": "ok", **values}


def table(rows: Sequence[Sequence[str]]) -> str:
    """Rows in columns, the heading first: the first column and remarks, which have no heading, flush left, the others
    flush right."""
    columns = []
    for i, column in enumerate(zip(*rows, strict=True)):
        width = max(map(len, column))
        justify = str.rjust
        if i == 0 or not column[0]:
            justify = str.ljust
        columns.append([justify(cell, width) for cell in column])
    return "\n".join("  ".join(row).rstrip() for row in zip(*columns, strict=True))


def record_table(rows: Iterable[Record], columns: Columns) -> str:
    """A table of rows; `columns` are the texts of their cells by heading (see `fill`)."""
    return table([list(columns), *(record_cells(row, columns) for row in rows)])


def listing(pairs: Sequence[tuple[str, str]]) -> str:
    """Names and values, one pair per line."""
    width = max(len(name) for name, _ in pairs)
    return "\n".join(f"{name.ljust(width)}  {value}" for name, value in pairs)


def progress(quiet: bool = False) -> Progress:
    """A function `(fraction, text)` that shows progress: a bar on a terminal, a few lines elsewhere, nothing if
    quiet."""
    if quiet:
        return silent
    if sys.stderr.isatty():
        return _bar()
    return _lines()


def row_printer(head: Sequence[str], quiet: bool = False) -> Callable[[Sequence[str]], None]:
    """A function that prints a row of a table on standard error, below its head; nothing if quiet.

    For rows that take long: the table itself follows on standard output.
    """
    if quiet:
        return lambda cells: None
    # width of the first and minimum width of the other columns
    widths = [20, *(max(len(text), 10) for text in head[1:])]
    printed = False

    def print_row(cells: Sequence[str]) -> None:
        line = [cells[0].ljust(widths[0]), *map(str.rjust, cells[1:], widths[1:])]
        print_line("  ".join(line))

    def show(cells: Sequence[str]) -> None:
        nonlocal printed
        if not printed:
            print_row(head)
        printed = True
        print_row(cells)

    return show


def _bar() -> Progress:
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


def _lines() -> Progress:
    reached = 0

    def show(fraction: float, text: str = "") -> None:
        nonlocal reached
        # without a terminal a progress line is printed at these fractions of the run
        marks = sum(fraction >= mark for mark in (0.25, 0.5, 0.75, 1.0))
        if marks > reached:
            print_line(f"{100 * fraction:3.0f} % {text}".rstrip())
        reached = max(marks, reached)

    return show
