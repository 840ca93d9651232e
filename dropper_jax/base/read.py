"""Reading plain values (TOML, dict) against declared fields; every error is one `SceneError` line.

A line reads `PATH: VALUE reason; allowed: WHAT`, with the path in the syntax of `--set`.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Self, TypeVar, overload

import numpy as np

from dropper_jax.base.errors import Check, SceneError, nearest, raise_first

Item = TypeVar("Item")


class Pairs:
    """The type of an option that is a list of pairs of names."""


#: What an option that is a list takes.
LISTS = {
    Pairs: 'a list of pairs of names, such as [["dropper-1", "dropper-2"]]',
    tuple: "a list of whole numbers",
    list: "a list of texts",
}
#: What a TOML file, a JSON text or a Python caller may give as a value.
Plain = str | bool | float | Sequence | Mapping | np.ndarray | None
#: Plain values by key: a table of a TOML file, or the object that `--json` prints.
Table = dict[str, Any]
#: Values by key that are only read: those of a table, or what a field declares of its value.
Values = Mapping[str, Any]

#: Maximum of any count: counts in compiled programs have 32 bits.
MAX_COUNT = 2**31 - 1


def refuse(path: str, value: Plain, reason: str, allowed: str) -> SceneError:
    """The error line for a value that cannot be used."""
    return SceneError(f"{path}: {short_text(value)} {reason}; allowed: {allowed}")


def short_text(value: Plain) -> str:
    """A value on one short line."""
    shown = 60  # maximum length of a value's text in an error line
    text = " ".join(repr(value).split())
    if len(text) <= shown:
        return text
    return text[: shown - 3] + "..."


@overload
def plain(value: Mapping[str, Any]) -> Table: ...
@overload
def plain(value: Plain) -> Plain: ...
def plain(value: Plain) -> Plain:
    """Arrays and tuples as lists and sections as tables, also inside tables; everything else unchanged."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, SectionValues):
        return value.table()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def read_table(value: Plain, path: str) -> Values:
    """A table with text keys."""
    if not isinstance(value, Mapping):
        raise refuse(path, value, "is not a table", "keys with values")
    return value


def check_keys(table: Values, allowed: Iterable[str], path: str) -> None:
    """Reject an unknown key and suggest the nearest known one."""
    allowed = list(allowed)
    for key in table:
        if key not in allowed:
            name = " ".join(str(key).split())
            raise SceneError(f"{join(path, name)}: unknown key; {nearest(name, allowed)}")


def check_kind_keys(table: Values, kind: str, keys: Mapping[str, Sequence[str]], path: str) -> None:
    """Reject keys of a table that its `kind` does not take."""
    for key in table:
        if key not in ("kind", *keys[kind]):
            raise SceneError(f"{path}.{key}: not used by kind {kind!r}, which takes {', '.join(keys[kind])}")


def join(path: str, key: str) -> str:
    if path:
        return f"{path}.{key}"
    return key


class ScenePath(str):
    """A path of a value, such as `line.0.mass.2`: section, item, key, and entries of a list.

    Attributes:
        section: its first word.
        stem: the path without entries, which are the numbers at its end.
        key: name of the value, the last word of the stem.
    """

    @property
    def section(self) -> str:
        return self.partition(".")[0]

    @property
    def stem(self) -> str:
        stem, _, last = self.rpartition(".")
        if last.isdecimal():
            return ScenePath(stem).stem
        return str(self)

    @property
    def key(self) -> str:
        return self.stem.rpartition(".")[2]

    def entry_of(self, paths: Container[str]) -> tuple[str, tuple[int, ...]] | None:
        """Which of these paths it is an entry of, and the numbers of the entry; None without such a path."""
        stem = str(self)
        entries = ()
        while stem not in paths:
            stem, _, last = stem.rpartition(".")
            if not last.isdecimal():
                return None
            entries = (int(last), *entries)
        return stem, entries


def limits(declared: Values) -> str:
    """The allowed range in words, with the unit, such as `> 0 kg`; empty if there are no limits."""
    low = declared.get("low")
    above = declared.get("above")
    high = declared.get("high")
    if declared.get("type") is int and high == MAX_COUNT:  # not a physical limit
        high = None
    if low is not None and high is not None:
        words = f"{low:g} to {high:g}"
    elif above is not None and high is not None:
        words = f"above {above:g} to {high:g}"
    elif low is not None:
        words = f">= {low:g}"
    elif above is not None:
        words = f"> {above:g}"
    elif high is not None:
        words = f"<= {high:g}"
    else:
        return ""
    unit = declared.get("unit", "-")
    if unit == "-":
        return words
    return f"{words} {unit}"


def read_number(value: Plain, path: str, declared: Values, allowed: str | None = None) -> float:
    """A finite number within its range; a truth value is not a number."""
    allowed = allowed or "a number" + _range(" ", declared)
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise refuse(path, value, "is not a number", allowed)
    number = math.inf
    with suppress(OverflowError):
        number = float(value)
    if not math.isfinite(number):
        raise refuse(path, value, "is not finite", allowed)
    low = declared.get("low")
    above = declared.get("above")
    high = declared.get("high")
    below = (low is not None and number < low) or (above is not None and number <= above)
    if below or (high is not None and number > high):
        raise refuse(path, value, "is out of range", allowed)
    return number


def _range(before: str, declared: Values) -> str:
    """The allowed range, or the unit, after some words; empty without either."""
    words = limits(declared)
    if not words and declared.get("unit", "-") != "-":
        words = f"in {declared['unit']}"
    if words:
        return before + words
    return ""


def rises(values: Sequence[float] | np.ndarray, count: int = 1) -> bool:
    """Whether there are at least `count` numbers, each above the one before."""
    return len(values) >= count and bool(np.all(np.diff(values) > 0))


def read_integer(value: Plain, path: str, low: int | None = None, high: int | None = None) -> int:
    """A whole number from `low` to `high`."""
    allowed = "a whole number"
    if low is not None:
        allowed = f"a whole number >= {low}"
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise refuse(path, value, "is not a whole number", allowed)
    if low is not None and value < low:
        raise refuse(path, value, "is out of range", allowed)
    if high is not None and value > high:
        raise refuse(path, value, "is out of range", f"{allowed} and <= {high}")
    return int(value)


def read_text(value: Plain, path: str, choices: Iterable[str] | None = None) -> str:
    """A text, one of `choices` where given."""
    longest_name = 200  # maximum length of a name: names are part of every message, table and file
    if not isinstance(value, str):
        allowed = "a text"
        if choices:
            allowed = "one of " + ", ".join(choices)
        raise refuse(path, value, "is not a text", allowed)
    if choices is not None and value not in choices:
        raise SceneError(
            f"{path}: {short_text(value)} is unknown; {nearest(value, choices)}; allowed: {', '.join(choices)}"
        )
    if path.rpartition(".")[2] == "name":
        if len(value) > longest_name:
            raise refuse(path, value, f"has {len(value)} characters", f"at most {longest_name}")
        if value.splitlines() != [value]:
            raise refuse(path, value, "is not one line", "a text of one line, not empty")
    return value


def read_list(value: Plain, path: str, count: int | None, allowed: str) -> list[Any]:
    """A list, of `count` items where given."""
    value = plain(value)
    if not isinstance(value, list):
        raise refuse(path, value, "is not a list", allowed)
    if count is not None and len(value) != count:
        raise refuse(path, value, f"has {len(value)} entries", allowed)
    return value


def read_parameter(value: Plain, path: str, declared: Values, counts: Mapping[str, int]) -> float | np.ndarray:
    """A number as float, anything longer as an array of the declared shape."""
    shape = declared["shape"]
    each = _range(", each ", declared)
    value = plain(value)
    if shape == "number" or (shape == "numbers" and not isinstance(value, list)):
        return read_number(value, path, declared)
    if shape in ("node", "link", "joint"):
        count = counts[shape]
        allowed = f"a number or a list of {count} numbers{each}"
        if not isinstance(value, list):
            return read_number(value, path, declared, allowed)
        return _read_numbers(value, path, declared, count, allowed)
    if shape == "vectors":
        return read_rows(value, path, declared, 3, f"3 numbers{each}")
    count = declared.get("entries")
    if shape == "vector":
        count = 3
    found = _read_numbers(value, path, declared, count, f"{count or 'a list of'} numbers{each}")
    needed = declared.get("rising", 0)
    if needed and not rises(found, needed):
        few = {1: "one", 2: "two"}.get(needed, needed)
        raise refuse(path, plain(found), "does not rise", f"{few} or more rising numbers{_range(' ', declared)}")
    return found


def read_rows(
    value: Plain, path: str, declared: Values, count: int, allowed: str, many: int | None = None
) -> np.ndarray:
    """Rows of `count` numbers each (k, count), `many` rows where given."""
    rows = read_list(value, path, many, f"{many or 'a list of'} rows of {allowed}")
    found = [_read_numbers(row, f"{path}.{i}", declared, count, allowed) for i, row in enumerate(rows)]
    return np.array(found, float).reshape(len(found), count)


def read_matrix(value: Plain, path: str, declared: Values) -> np.ndarray:
    """Rows of numbers (k, n), as many in each as in the first."""
    rows = read_list(value, path, None, "rows of numbers")
    columns = 0
    if rows:
        columns = len(read_list(rows[0], f"{path}.0", None, "numbers"))
    return read_rows(rows, path, declared, columns, f"{columns} numbers, as in the first row")


def _read_numbers(value: Plain, path: str, declared: Values, count: int | None, allowed: str) -> np.ndarray:
    items = read_list(value, path, count, allowed)
    return np.array([read_number(item, f"{path}.{i}", declared, allowed) for i, item in enumerate(items)], float)


def read_option(value: Plain, path: str, declared: Values) -> str | int | bool | tuple[Any, ...]:
    """A text, whole number, truth value, or tuple of whole numbers, of texts (declared as `list`), or of pairs of
    texts."""
    kind = declared.get("type")
    choices = declared.get("choices")
    if kind in LISTS:
        read = {
            tuple: partial(read_integer, low=declared.get("low")),
            list: read_text,
            Pairs: _read_pair,
        }[kind]
        items = read_list(value, path, None, LISTS[kind])
        return tuple(read(item, f"{path}.{i}") for i, item in enumerate(items))
    if kind is int:
        return read_integer(value, path, declared.get("low"), declared.get("high"))
    if kind is bool:
        if not isinstance(value, bool):
            raise refuse(path, value, "is not a truth value", "true, false")
        return value
    return read_text(value, path, choices)


def _read_pair(value: Plain, path: str) -> tuple[str, ...]:
    names = read_list(value, path, 2, "two names")
    return tuple(read_text(name, f"{path}.{i}") for i, name in enumerate(names))


def read_fields(cls: type, table: Plain, path: str, counts: Mapping[str, int]) -> Table:
    """All declared fields of `cls` from a table, and those of its parts that are given.

    Args:
        cls: a dataclass whose fields were declared with `parameter`, `option` or `part`; other fields are ignored.
        table: the values; omitted ones take their defaults.
        path: path of the table within the scene.
        counts: number of entries of a list with one value per node, link or joint.

    Raises:
        SceneError: for the first key or value that cannot be used.
    """
    table = read_table(table, path)
    declared = declared_fields(cls)
    check_keys(table, section_keys(cls), path)
    values = {}
    for key, field in declared.items():
        if key in table:
            values[field.name] = _read_field(field, table[key], join(path, key), counts)
        elif field.default is dataclasses.MISSING:
            raise SceneError(f"{join(path, key)}: missing; needed: {_describe_missing(field)}")
        elif field.metadata.get("shape") == "vector" and field.default is not None:
            values[field.name] = np.array(field.default, float)
        else:
            values[field.name] = field.default
    for key, field in declared_fields(cls, "part").items():
        needed = field.metadata["needed"]
        if table.get(key) is not None:
            values[field.name] = field.metadata["part"](table[key], join(path, key))
        elif needed:
            raise SceneError(f"{join(path, key)}: missing; needed: {needed}")
    return values


def _describe_missing(field: dataclasses.Field) -> str:
    """Meaning, unit and range, or choices, of a missing field."""
    words = field.metadata["meaning"] + _range(", ", field.metadata)
    choices = field.metadata.get("choices")
    if choices is None:
        return words
    return f"{words}; allowed: {', '.join(choices)}"


def _read_field(field: dataclasses.Field, value: Plain, path: str, counts: Mapping[str, int]) -> object:
    if field.metadata["kind"] == "parameter":
        return read_parameter(value, path, field.metadata, counts)
    return read_option(value, path, field.metadata)


def read_items(
    read: Callable[..., Item], value: Plain, path: str, *more: object, needed: bool = False
) -> tuple[Item, ...]:
    """The entries of a list of tables, each read with its path and `more`."""
    items = read_list(value, path, None, f"one or more [[{path}]] tables")
    if needed and not items:
        raise SceneError(f"{path}: missing; needed: one or more [[{path}]] tables")
    return tuple(read(item, f"{path}.{i}", *more) for i, item in enumerate(items))


def count(meaning: str, low: int = 1, high: int = MAX_COUNT, **kwargs: Any) -> Any:
    """Declare a whole number from `low` to `high`."""
    return dataclasses.field(
        metadata={"kind": "option", "meaning": meaning, "type": int, "low": low, "high": high}, **kwargs
    )


def part(read: Callable[[Plain, str], Any], key: str | None = None, needed: str = "", **kwargs: Any) -> Any:
    """Declare a table, a list of tables or other values inside a section, which `read` reads at their path; one that
    is `needed` has no default, and this is what its error names."""
    return dataclasses.field(metadata={"part": read, "key": key, "needed": needed}, **kwargs)


def items(cls: type[DeclaredSection]) -> Callable[[Plain, str], tuple[DeclaredSection, ...]]:
    """The reader of a part that is a list of tables."""
    return partial(read_items, cls.read)


def read_positions(value: Plain, path: str) -> dict[str, np.ndarray]:
    """Positions (3,) [m] by name."""
    vector = {"unit": "m", "shape": "vector"}
    found = {}
    for name, position in read_table(value, path).items():
        found[read_text(name, path)] = read_parameter(position, f"{path}.{name}", vector, {})
    return found


def declared_fields(cls: type, word: str = "kind") -> dict[str, dataclasses.Field]:
    """All declared numbers, texts and choices by their names in a table; with the word `part` the parts."""
    return {f.metadata.get("key") or f.name: f for f in dataclasses.fields(cls) if word in f.metadata}


def section_keys(cls: type) -> list[str]:
    """Names of all values of a section in its table."""
    return [*declared_fields(cls), *declared_fields(cls, "part")]


def as_table(spec: object) -> Table:
    """The given values of a section as plain values; None values and empty parts are omitted."""
    parts = declared_fields(type(spec), "part")
    found = {}
    for key, field in (declared_fields(type(spec)) | parts).items():
        value = plain(getattr(spec, field.name))
        is_empty_part = key in parts and not value
        if value is not None and not is_empty_part:
            found[key] = value
    return found


class SectionValues:
    """Base of a section of a scene: a dataclass with declared fields."""

    def table(self) -> Table:
        """Plain values from which `read` recreates the section."""
        return as_table(self)


class DeclaredSection(SectionValues):
    """A section whose declared fields are all that it reads and writes."""

    @classmethod
    def read(cls, table: Plain, path: str) -> Self:
        """The section from its table, checked."""
        section = cls(**read_fields(cls, table, path, {}))
        section.check(path)
        return section

    def check(self, path: str) -> None:
        """Raise `SceneError` for combinations of values that ranges of single fields cannot express."""
        raise_first(self.checks(), path)

    def checks(self) -> Iterable[Check]:
        """These combinations, with messages that start with the key, or with `:` for the whole section."""
        return ()
