"""Texts of values that mean the same in every process with the same sources: parts of the keys of stored programs."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Callable, Iterable

import jax
import numpy as np
from jax import Array

#: Packages whose names and sources the key of a program contains.
PACKAGES = ("dropper_jax", "fitting")


class NoStableText(ValueError):
    """A value that may mean something else in another process."""


def stable_text(value: object) -> str:
    """A text that two values share only if they mean the same in every process with the same sources.

    Arrays are written by their digests; objects of this project by their names and fields.

    Raises:
        NoStableText: an object of another kind, or a function that was created at run time.
    """
    match value:
        case None | bool() | int() | float() | str():
            return f"{type(value).__name__}:{value!r}"
        case np.ndarray() | np.generic() | Array():
            array = np.asarray(value)
            return f"array:{array.dtype}{array.shape}{hashlib.sha256(array.tobytes()).hexdigest()}"
        case dict():
            return _join_parts("dict", sorted(f"{stable_text(key)}={stable_text(one)}" for key, one in value.items()))
        case frozenset():
            return _join_parts("frozenset", sorted(map(stable_text, value)))
        case tuple() | list():
            return _join_parts(_type_text(type(value)), map(stable_text, value))
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = dataclasses.fields(value)
            texts = (f"{field.name}={stable_text(getattr(value, field.name))}" for field in fields)
            return _join_parts(_type_text(type(value)), texts)
        case _ if callable(value):
            return _name(value)
    raise NoStableText(type(value).__name__)


def _join_parts(kind: str, parts: Iterable[str]) -> str:
    """The texts of the parts of a value of this kind as one text."""
    return f"{kind}({','.join(parts)})"


def _type_text(kind: type) -> str:
    """The name of a type: of Python's containers, or of this project."""
    if kind in (tuple, list, dict, type(None)):
        return kind.__name__
    return _name(kind)


def _name(value: type | Callable[..., object]) -> str:
    """`module:name` of a type or function that a module of this project defines under that name."""
    module = getattr(value, "__module__", None) or ""
    name = getattr(value, "__qualname__", "")
    found = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    # a compiled function may replace its original under the same name
    original = getattr(found, "__wrapped__", found)
    if module.partition(".")[0] not in PACKAGES or (value is not found and value is not original):
        raise NoStableText(f"{module}.{name}")
    return f"{module}:{name}"


def tree_text(tree: jax.tree_util.PyTreeDef) -> str:
    """The types of a tree and their static data, without its leaves."""
    node = tree.node_data()
    if node is None:
        if tree.num_leaves:
            return "leaf"
        return "none"
    kind, static = node
    return _join_parts(_type_text(kind) + stable_text(static), map(tree_text, tree.children()))
