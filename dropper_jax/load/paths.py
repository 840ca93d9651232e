"""Values of a scene by path: `effects.linear_damping.b_l`, `line.0.mass`, `point.right.position.0`."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Plain, ScenePath, Table, Values, declared_fields, join, section_keys
from dropper_jax.load.scene_sections import KEYS_BY_HAND, declared_sections

#: Keys and numbers that lead from a scene's table to a value.
Steps = tuple[str | int, ...]
Branch = Table | list[Any]

#: Tables that have paths only for the keys that are given.
BY_NAME = ("vessel.*.rao", "vessel.*.attachments", "body.*.attachments")
#: Sections of whose tables only the keys have paths, not the tables themselves.
KEYS_ALONE = ("line.*",)
#: Sections of templates, of lines with types and of fits, whose values have no path in a scene with one value per link.
WITHOUT_PATHS = ("point_type.*", "line_type.*", "fit", "fit.sensor.*", "fit.prior.*", "parameters", "unit.*", "array.*")


def describe(path: str) -> Values:
    """Declaration of the value at a path, with `meaning`, `unit`, `low` and `high`; empty for keys read by hand."""
    section, _, key = ScenePath(path).stem.rpartition(".")
    for pattern, _, cls in declared_sections():
        if cls is not None and re.fullmatch(re.escape(pattern).replace(r"\*", r"[^.]+"), section):
            declared = declared_fields(cls)
            if key in declared:
                return declared[key].metadata
    return {}


def locate(table: Values, paths: Iterable[str] | None = None) -> dict[str, Steps]:
    """Steps to each value that a scene with one value per link may have, by path; without entries of lists.

    Args:
        paths: if given, only effects that the scene has or that one of these paths names, so that no other is imported.
    """
    found: dict[str, Steps] = {}
    effects = None
    if paths is not None:
        named = {path.split(".")[1] for path in paths if path.startswith("effects.")}
        effects = named.union(table.get("effects", ()))
    for pattern, _, cls in declared_sections(effects):
        if pattern not in (*WITHOUT_PATHS, *BY_NAME) and (pattern != "growth" or "growth" in table):
            found |= steps_to(table, pattern, _keys_with_paths(pattern, cls))
    for pattern in BY_NAME:
        found |= steps_to(table, pattern)
    return found


def _keys_with_paths(pattern: str, cls: type | None) -> list[str]:
    """Keys of a section that have paths, declared or read by hand."""
    if cls is None:
        return list(KEYS_BY_HAND.get(pattern, ()))
    if pattern in KEYS_ALONE:
        return list(declared_fields(cls))
    return [*section_keys(cls), *KEYS_BY_HAND.get(pattern, ())]


def steps_to(table: Values, pattern: str, keys: Iterable[str] | None = None) -> dict[str, Steps]:
    """Steps to these keys of every table at a pattern; without `keys`, to those that it has."""
    found = {}
    for path, to, own in _tables(table, list(filter(None, pattern.split(".")))):
        named = keys
        if named is None:
            named = own
        for key in named:
            found[join(path, key)] = (*to, key)
    return found


def _tables(
    table: Values | list[Any], words: list[str], path: str = "", to: Steps = ()
) -> Iterator[tuple[str, Steps, Values | list[Any]]]:
    """Path, steps and value of every table at the words of a pattern; items of lists by number and by name, of which a
    number is that of an item first."""
    if not words:
        yield path, to, table
    elif isinstance(table, list):
        labels = {str(i): i for i in range(len(table))}
        for i, item in enumerate(table):
            labels.setdefault(str(item.get("name", i)), i)
        for label, i in labels.items():
            yield from _tables(table[i], words[1:], f"{path}.{label}", (*to, i))
    elif words[0] != "*":
        yield from _tables(table.get(words[0], {}), words[1:], join(path, words[0]), (*to, words[0]))


def set_value(
    table: Table,
    path: str,
    value: Plain,
    steps: Mapping[str, Steps] | None = None,
    candidates: Iterable[str] = (),
) -> None:
    """Set a value at a path of plain values; numbers at the end of the path are entries of a list.

    Args:
        steps: steps by path; default `locate`.
        candidates: further paths that the error line may suggest.

    Raises:
        SceneError: the path (with the nearest) or the entry does not exist.
    """
    parent, key = _find_parent(table, path, steps, candidates)
    parent[key] = value


def get(table: Table, path: str, steps: Mapping[str, Steps] | None = None) -> Plain:
    """The plain value at a path.

    Raises:
        SceneError: the path or entry does not exist, or no value is given there.
    """
    parent, key = _find_parent(copy.deepcopy(table), path, steps, ())
    if isinstance(parent, dict) and key not in parent:
        raise SceneError(f"{path}: is not given in the scene")
    return parent[key]


def _find_parent(
    table: Table, path: str, steps: Mapping[str, Steps] | None, candidates: Iterable[str]
) -> tuple[Any, str | int]:
    """The container of the value at a path, and its key in it; missing tables are created."""
    if steps is None:
        steps = locate(table, [path])
    found = ScenePath(path).entry_of(steps)
    if found is None:
        known = {*steps, *candidates}
        if path.startswith("effects."):
            known.update(locate(table))
        raise SceneError(f"{path}: unknown path; {_hint(path, known)}")
    stem, entries = found
    *parents, key = steps[stem]
    branch: Branch = table
    for step in parents:
        if isinstance(branch, list):
            branch = branch[step]
        else:
            branch = branch.setdefault(step, {})
    for number in entries:
        if isinstance(branch, dict):
            items = branch.get(key)
            if isinstance(items, float) and _is_per_link(steps[stem]):  # equal values are stored as one number
                items = [items] * table["line"][parents[1]]["links"]
                branch[str(key)] = items
        else:
            items = branch[key]
        if not isinstance(items, list):
            raise SceneError(
                f"{path}: has no entries, its value is {items!r}; use the path without a number at its end"
            )
        if number >= len(items):
            raise SceneError(f"{path}: entry {number} does not exist; allowed: 0 to {len(items) - 1}")
        branch = items
        key = number
    return branch, key


def _is_per_link(steps: Steps) -> bool:
    """Whether a value may be a list of one number per link of its line."""
    section, _, key, *_ = (*steps, "", "")
    own = key == "axial" or describe(".".join(map(str, steps))).get("shape") == "link"
    return section == "line" and own


def path_as_given(error: SceneError, given: Iterable[str]) -> SceneError:
    """The error of a changed table with the path that was given: with the name of a line or type, not its number."""
    path, colon, reason = str(error).partition(":")
    section, number, key = (*path.split(".", 2), "", "")[:3]
    same = [own for own in given if own.startswith(f"{section}.") and own.endswith(f".{key}")]
    if number.isdecimal() and key and len(same) == 1:
        return SceneError(f"{same[0]}{colon}{reason}")
    return error


def _hint(path: str, candidates: set[str]) -> str:
    """The nearest path, otherwise those of the same section, otherwise the sections."""
    shown = 20  # maximum number of valid paths listed in an error line
    hint = nearest(path, candidates)
    if not hint.startswith("known:") or len(candidates) <= shown:
        return hint
    sections = {ScenePath(p).section for p in candidates}
    if ScenePath(path).section not in sections:
        return f"known sections: {', '.join(sorted(sections))}"
    near = sorted(p for p in candidates if ScenePath(p).section == ScenePath(path).section)
    if len(near) > shown:
        near[shown:] = ["..."]
    return f"known: {', '.join(near)}"
