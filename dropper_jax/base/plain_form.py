"""Static values and trees in a plain form that can be written as JSON and read back: names, numbers, texts, tuples.

Only values that mean the same in every process have a plain form: plain values, and dataclasses, named tuples, types
and functions of this project, which are written by name. Everything else is rejected, so that no value is misread.
Reading creates objects of this project's types only and executes nothing else.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from typing import TypeAlias

import jax
import numpy as np
from jax.tree_util import PyTreeDef, default_registry

#: Types that JSON can hold.
Plain: TypeAlias = None | bool | int | str | list["Plain"]

#: Packages whose names mean the same in every process with the same sources.
PROJECT = ("dropper_jax", "fitting")
#: Types of trees from outside this project, by the name under which they are written.
BUILT_IN: dict[str, type] = {"tuple": tuple, "list": list, "dict": dict, "none": type(None)}


class NoPlainForm(ValueError):
    """A value that may mean something else in another process."""


def to_plain(value: object) -> Plain:
    """The plain form of a static value.

    Raises:
        NoPlainForm: the value has no plain form.
    """
    match value:
        case None | bool() | str():
            return value
        case int() if type(value) is int:
            return value
        case float():
            return ["float", float(value).hex()]
        case tuple() | list() if type(value) in (tuple, list):
            return [type(value).__name__, *map(to_plain, value)]
        case dict() if type(value) is dict:
            return ["dict", *([to_plain(key), to_plain(one)] for key, one in value.items())]
        case frozenset():
            return ["frozenset", *sorted((to_plain(one) for one in value), key=repr)]
        case np.ndarray() if value.dtype.kind in "biuf":
            return ["array", value.dtype.str, [*value.shape], value.tobytes().hex()]
        case tuple():  # a named tuple
            return ["made", name_of(type(value)), *map(to_plain, value)]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            names = [field.name for field in dataclasses.fields(value)]
            return ["of", name_of(type(value)), *([name, to_plain(getattr(value, name))] for name in names)]
        case _ if callable(value):
            return ["name", name_of(value)]
    raise NoPlainForm(f"{type(value).__name__} has no plain form")


def read(plain: Plain) -> object:
    """The value of a plain form.

    Raises:
        NoPlainForm: the form is invalid or its types have changed.
    """
    match plain:
        case ["float", text]:
            return float.fromhex(text)
        case ["tuple", *parts]:
            return tuple(map(read, parts))
        case ["list", *parts]:
            return [*map(read, parts)]
        case ["frozenset", *parts]:
            return frozenset(map(read, parts))
        case ["dict", *pairs]:
            return {read(key): read(one) for key, one in pairs}
        case ["array", dtype, shape, data]:
            return np.frombuffer(bytes.fromhex(data), dtype).reshape(shape)
        case ["name", name]:
            return import_named(name)
        case ["made", name, *parts]:
            return import_named(name)(*map(read, parts))
        case ["of", name, *fields]:
            return import_named(name)(**{key: read(one) for key, one in fields})
        case list():
            raise NoPlainForm(f"{plain[:1]} is not a kind of plain form")
    return plain


def name_of(value: type | Callable[..., object]) -> str:
    """`module:name` of a type or function of this project that is defined in its module under that name.

    Raises:
        NoPlainForm: the object belongs to another project or was created at run time.
    """
    module, name = getattr(value, "__module__", None) or "", getattr(value, "__qualname__", "")
    known = module.partition(".")[0] in PROJECT and "<" not in name and name
    if not known or _import_attribute(module, name) is not value:
        raise NoPlainForm(f"{module}.{name or type(value).__name__} is not a name of this project")
    return f"{module}:{name}"


def import_named(name: str) -> Callable[..., object]:
    """The object for a name given by `name_of`.

    Raises:
        NoPlainForm: the object no longer exists.
    """
    module, _, inner = name.partition(":")
    if module.partition(".")[0] not in PROJECT:
        raise NoPlainForm(f"{name} is not a name of this project")
    try:
        importlib.import_module(module)
        return _import_attribute(module, inner)
    except (ImportError, AttributeError) as error:
        raise NoPlainForm(f"{name} no longer exists") from error


def _import_attribute(module: str, name: str) -> Callable[..., object]:
    found = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    # a compiled function may replace the original under the same name
    return getattr(found, "__wrapped__", found)


def tree_written(tree: PyTreeDef) -> Plain:
    """The plain form of a tree without its leaves: types, their static data, and branches.

    Raises:
        NoPlainForm: the tree has no plain form.
    """
    node = tree.node_data()
    branches = [tree_written(branch) for branch in tree.children()]
    if node is None:
        return ["leaf"] if tree == jax.tree.structure(0) else ["nothing"]
    kind, beside = node
    name = next((word for word, type_ in BUILT_IN.items() if type_ is kind), None) or name_of(kind)
    return ["node", name, to_plain(beside), *branches]


def tree_read(plain: Plain) -> PyTreeDef:
    """The tree of a plain form.

    Raises:
        NoPlainForm: the form is invalid or its types have changed.
    """
    kind, *parts = plain
    if kind == "leaf":
        return jax.tree.structure(0)
    if kind == "nothing":
        return jax.tree.structure(None)
    name, beside, *branches = parts
    type_ = BUILT_IN.get(name) or import_named(name)
    branches = [tree_read(branch) for branch in branches]
    return PyTreeDef.from_node_data_and_children(default_registry, (type_, read(beside)), branches)
