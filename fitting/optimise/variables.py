"""Variables of a design: numbers of the scene with bounds and, where parts come in sizes, a catalogue.

[[variable]]
name = "leg"                    of [parameters] of the scene, or any path of it: "line_type.rope.diameter"
low = 40.0
high = 80.0
catalogue = [50.0, 55.0, 60.0]  available sizes; the final design uses one of them
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import (
    Plain,
    ScenePath,
    check_keys,
    plain,
    read_list,
    read_number,
    read_table,
    read_text,
    refuse,
)
from dropper_jax.load.scene import Scene

KEYS = ("name", "low", "high", "catalogue")


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number of the scene that the optimiser may choose.

    Attributes:
        name: as specified; `path`: of the scene.
        value: start value; `low`, `high`: its bounds.
        catalogue: available sizes, in increasing order; empty if any value is allowed.
    """

    name: str
    path: str
    value: float
    low: float
    high: float
    catalogue: tuple[float, ...] = ()

    @property
    def span(self) -> float:
        return self.high - self.low

    def sizes(self, value: float) -> tuple[float, ...]:
        """Sizes next to a value, below and above it; the value itself without a catalogue."""
        if not self.catalogue:
            return (value,)
        below = [x for x in self.catalogue if x <= value + 1e-9 * self.span]
        above = [x for x in self.catalogue if x > value + 1e-9 * self.span]
        return (*below[-1:], *above[:1])


def read_variables(raw: Plain, scene: Scene) -> tuple[Variable, ...]:
    """The `[[variable]]` tables of a site.

    Raises:
        SceneError: no table, an unknown number, an empty interval or one that excludes the start, sizes outside it, a
            duplicate variable.
    """
    found: list[Variable] = []
    for i, item in enumerate(read_list(raw, "variable", None, "one or more [[variable]] tables")):
        found.append(_read(read_table(item, f"variable.{i}"), f"variable.{i}", scene))
        if found[-1].path in [v.path for v in found[:-1]]:
            raise refuse(f"variable.{i}.name", found[-1].name, "is a duplicate", "every variable once")
    if not found:
        raise SceneError("variable: none is given; needed: one or more [[variable]] tables")
    return tuple(found)


def _read(table: Mapping[str, Any], path: str, scene: Scene) -> Variable:
    check_keys(table, KEYS, path)
    name = read_text(table.get("name"), f"{path}.name")
    where = name if "." in name or scene.template is None else f"parameters.{name}"
    try:
        value = scene.value(where)
    except SceneError as error:
        raise SceneError(f"{path}.name: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise refuse(f"{path}.name", name, f"is {plain(value)!r}, no single number", "paths of such numbers")
    if ScenePath(where).section == "parameters":
        given = scene.template.table["parameters"][ScenePath(where).key]
        if isinstance(given, str):
            raise refuse(f"{path}.name", name, f"follows from others ({given})", "parameters that are numbers")
    low, high = (read_number(table.get(key), f"{path}.{key}", {}, "a number") for key in ("low", "high"))
    if not low < high:
        raise refuse(f"{path}.high", high, "leaves an empty interval", f"> {low:g}")
    if not low <= float(value) <= high:
        raise refuse(f"{path}.low", low, f"and high leave out the scene's {value:g}", "bounds around it")
    sizes = _sizes(table.get("catalogue"), f"{path}.catalogue", low, high)
    return Variable(name, where, float(value), low, high, sizes)


def _sizes(given: Plain, path: str, low: float, high: float) -> tuple[float, ...]:
    if given is None:
        return ()
    items = read_list(given, path, None, "a list of available sizes")
    sizes = [read_number(x, f"{path}.{i}", {}, "a number") for i, x in enumerate(items)]
    if not sizes:
        raise refuse(path, [], "is empty", "at least one size; or leave the key out")
    for i, size in enumerate(sizes):
        if not low <= size <= high:
            raise refuse(f"{path}.{i}", size, "is out of bounds", f"{low:g} to {high:g}")
    return tuple(sorted(set(sizes)))


def with_design(scene: Scene, variables: Sequence[Variable], values: np.ndarray) -> Scene:
    """The scene with the variables at these values (p,)."""
    return scene.with_values({v.path: float(x) for v, x in zip(variables, values, strict=True)})
