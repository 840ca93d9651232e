"""Values on the command line: numbers, ranges, files and folders that a command writes."""

from __future__ import annotations

import math
import os
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from dropper_jax.base.errors import SceneError
from dropper_jax.base.files import PART_SUFFIX, part_prefix, unwritable

Value = TypeVar("Value")

#: Value of `--dt` for the suggested step, which `run` shortens as its check advises.
AUTO = "auto"


def output_file(text: str, option: str, suffixes: tuple[str, ...], folders: tuple[str, ...] = ()) -> Path:
    """A file to write; what cannot be written is rejected before the work starts. `folders` are suffixes of folders."""
    path = Path(text)
    if path.suffix.lower() not in suffixes:
        raise SceneError(f"{option}: {text!r} has no known suffix; allowed: {', '.join(suffixes)}")
    if not path.parent.is_dir():
        raise SceneError(f"{option}: the folder {str(path.parent)!r} does not exist; allowed: an existing one")
    if path.is_dir() and path.suffix.lower() not in folders:
        raise SceneError(f"{option}: {text!r} is a folder; allowed: a file")
    if not os.access(path.parent, os.W_OK):
        raise SceneError(f"{option}: the folder {str(path.parent)!r} cannot be written; allowed: a writable folder")
    try:  # the name of the unfinished file is longer
        os.lstat(path.with_name(f"{part_prefix(path)}12345678{PART_SUFFIX}"))
    except FileNotFoundError:
        return path
    except OSError as error:
        raise unwritable(path, error) from None
    return path


def output_folder(text: str, option: str) -> Path:
    """A folder to write to, which need not exist; a file is rejected before the work starts."""
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
        raise ArgumentTypeError(f"{text!r} is not a number") from None


def positive(unit: str) -> Callable[[str], float]:
    """The type of an option: a finite number above 0, in this unit."""

    def read(text: str) -> float:
        value = number(text)
        if not 0.0 < value < math.inf:
            raise ArgumentTypeError(f"{text} is out of range; allowed: > 0 {unit}".rstrip())
        return value

    return read


def split_names(text: str) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in text.split(",")]


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
    if given is None:
        given = text
    try:
        found = list(map(float, text.split(mark)))
    except ValueError:
        found = []
    if not found or count not in (None, len(found)):
        raise SceneError(f"{option}: {given!r} {reason}")
    return found


def read_spaced(text: str, option: str, reason: str, given: str | None = None) -> tuple[float, float, int]:
    """Ends and whole number, at least 1, of values of `LO:HI:N`."""
    if given is None:
        given = text
    low, high, count = read_numbers(text, option, reason, ":", 3, given)
    if count % 1.0 != 0.0 or count < 1:
        raise SceneError(f"{option}: {given!r} {reason}")
    return low, high, int(count)


def read_named_range(text: str, option: str, reason: str) -> tuple[str, float, float]:
    """Name and ends of `NAME=LO:HI`."""
    name, _, limits = text.partition("=")
    low, high = read_numbers(limits, option, reason, ":", 2, given=text)
    return name.strip(), low, high


def values_by_name(pairs: Iterable[tuple[str, Value]], option: str) -> dict[str, Value]:
    """Values of an option by their names, each of which may be given once."""
    found: dict[str, Value] = {}
    for name, value in pairs:
        if name in found:
            raise SceneError(f"{option}: {name!r} is given twice; allowed: every name once")
        found[name] = value
    return found


def check_once(files: Sequence[str], label: str) -> None:
    """Reject a file that is given twice, also by another path: it would count as two measurements or runs."""
    seen = set()
    for file in files:
        path = Path(file).resolve()
        if path in seen:
            raise SceneError(f"{label}: {file!r} is given twice; allowed: every file once")
        seen.add(path)


def positive_integer(text: str) -> int:
    """A whole number on the command line, at least 1."""
    if not text.isdecimal() or int(text) < 1:
        raise ArgumentTypeError(f"{text!r} is not a whole number >= 1")
    return int(text)
