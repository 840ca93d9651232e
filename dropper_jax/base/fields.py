"""Declaring the fields of models and effects: unit, meaning and allowed range are given next to the value.

A *component* is a frozen dataclass registered as a JAX pytree. Its `parameter` fields are arrays (differentiable,
batchable). Its `option` fields are static and part of the compiled program. The scene reader validates against the same
declarations, so each number is described in one place only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, dataclass_transform

import jax

from dropper_jax.base.read import count, part

#: Shapes that a parameter may declare. `node` and `link` values may also be given as one number for all.
SHAPES = ("number", "node", "link", "joint", "vector", "table", "vectors", "numbers")


def parameter(
    meaning: str,
    *,
    unit: str,
    shape: str = "number",
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    rising: int = 0,
    entries: int | None = None,
    key: str | None = None,
    **kwargs: Any,
) -> Any:
    """Declare an array field of a component.

    Args:
        meaning: one-line description for the user.
        unit: SI unit as printed, `-` if dimensionless.
        shape: one of `SHAPES`: a number, one per node, link or joint, a 3-vector, a table (k,), vectors (k, 3), numbers
            (one, or a table).
        low, high: allowed range, ends included.
        above: lower end of the range, not included; in place of `low`.
        rising: if not 0, each number of a table is above the one before, and there are at least this many.
        entries: length of a table; None: any.
        key: its name in a scene, if it differs from the attribute's.
        **kwargs: `default` and similar, passed to `dataclasses.field`. A field whose default is None may be omitted in
            the scene and then adds no computation.
    """
    if shape not in SHAPES:
        raise ValueError(f"shape {shape!r} is not one of {SHAPES}")
    return dataclasses.field(
        metadata={
            "kind": "parameter",
            "meaning": meaning,
            "unit": unit,
            "shape": shape,
            "low": low,
            "above": above,
            "high": high,
            "rising": rising,
            "entries": entries,
            "key": key,
        },
        **kwargs,
    )


def option(
    meaning: str,
    *,
    choices: Sequence[Any] | None = None,
    type: type | None = None,
    key: str | None = None,
    **kwargs: Any,
) -> Any:
    """Declare a static field of a component: a choice or a plain value that determines the compiled program."""
    return dataclasses.field(
        metadata={"kind": "option", "meaning": meaning, "choices": choices, "type": type, "key": key}, **kwargs
    )


@dataclass_transform(field_specifiers=(parameter, option, dataclasses.field), frozen_default=True)
def component(cls: type) -> type:
    """Make `cls` a frozen dataclass and a pytree: parameters are leaves, options are static."""
    cls = dataclasses.dataclass(frozen=True)(cls)
    fields = dataclasses.fields(cls)
    static = [f.name for f in fields if f.metadata.get("kind") == "option"]
    leaves = [f.name for f in fields if f.name not in static]
    jax.tree_util.register_dataclass(cls, data_fields=leaves, meta_fields=static)
    return cls


@dataclass_transform(field_specifiers=(parameter, option, count, part, dataclasses.field), frozen_default=True)
def section(cls: type) -> type:
    """Make `cls` a frozen dataclass of declared fields, which compares by identity: it holds arrays."""
    return dataclasses.dataclass(frozen=True, eq=False)(cls)
