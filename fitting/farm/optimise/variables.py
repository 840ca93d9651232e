"""Variables of a design: numbers of the scene with bounds and, where parts come in sizes, a catalogue.

[[variable]]
name = "leg"                    of [parameters] of the scene, or any path of it: "line_type.rope.diameter"
low = 40.0
high = 80.0
catalogue = [50.0, 55.0, 60.0]  available sizes; the final design uses one of them
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import Check, SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import DeclaredSection, Plain, ScenePath, plain, read_items, refuse
from dropper_jax.load.scene import Scene


@dataclass(frozen=True)
class Variable(DeclaredSection):
    """`[[variable]]`: one number of the scene that the optimiser may choose.

    Attributes:
        catalogue: in increasing order; empty if any value is allowed.
        path: of the number in the scene; `value`: its start value.
    """

    name: str = option("name of the number: one of [parameters], or a path", type=str)
    low: float = parameter("lower bound", unit="-")
    high: float = parameter("upper bound", unit="-")
    catalogue: Sequence[float] | None = parameter("available sizes", unit="-", shape="table", default=None)
    path: str = ""
    value: float = np.nan

    @classmethod
    def of(cls, table: Plain, path: str, scene: Scene) -> Variable:
        """A variable of a scene, checked."""
        found = cls.read(table, path)
        where = found.name
        if "." not in where and scene.template is not None:
            where = f"parameters.{where}"
        try:
            value = scene.value(where)
        except SceneError as error:
            raise SceneError(f"{path}.name: {error}") from None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SceneError(
                f"{path}.name: {found.name!r} is {plain(value)!r}, no single number; allowed: paths of such numbers"
            )
        if scene.template is not None and ScenePath(where).section == "parameters":
            given = scene.template.table["parameters"][ScenePath(where).key]
            if isinstance(given, str):
                raise SceneError(
                    f"{path}.name: {found.name!r} follows from others ({given}); allowed: parameters that are numbers"
                )
        if not found.low <= value <= found.high:
            raise SceneError(
                f"{path}.low: {found.low} and high leave out the scene's {value:g}; allowed: bounds around it"
            )
        sizes = () if found.catalogue is None else tuple(np.unique(found.catalogue).tolist())
        return replace(found, path=where, value=float(value), catalogue=sizes)

    def checks(self) -> Iterator[Check]:
        yield not self.low < self.high, f"high: {self.high} leaves an empty interval; allowed: > {self.low:g}"
        if self.catalogue is not None:
            empty = len(self.catalogue) == 0
            yield empty, "catalogue: [] is empty; allowed: at least one size; or leave the key out"
            for i, size in enumerate(self.catalogue):
                outside = not self.low <= size <= self.high
                yield outside, f"catalogue.{i}: {size} is out of bounds; allowed: {self.low:g} to {self.high:g}"

    @property
    def span(self) -> float:
        """Width of its range."""
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
    found = read_items(Variable.of, raw, "variable", scene)
    if not found:
        raise SceneError("variable: none is given; needed: one or more [[variable]] tables")
    paths = [v.path for v in found]
    for i, variable in enumerate(found):
        if variable.path in paths[:i]:
            raise refuse(f"variable.{i}.name", variable.name, "is a duplicate", "every variable once")
    return found


def bounds(variables: Sequence[Variable]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (p,)."""
    return np.array([v.low for v in variables]), np.array([v.high for v in variables])


def with_design(scene: Scene, variables: Sequence[Variable], values: np.ndarray) -> Scene:
    """The scene with the variables at these values (p,)."""
    return scene.with_values({v.path: float(x) for v, x in zip(variables, values, strict=True)})
