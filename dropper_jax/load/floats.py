"""Points with types, and floats given by their volume."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, check_keys, declared_fields, read_list, read_number, read_table, read_text
from dropper_jax.scene import PointSpec

#: Density of foam and shell of a float over its volume [kg/m^3], and its coefficients as a sphere: drag on its frontal
#: area (subcritical: Hoerner 1965, Fluid-dynamic drag), added mass of a sphere (Lamb 1932, article 92).
DENSITY, DRAG, ADDED_MASS = 80.0, 0.5, 0.5


def with_types(table: dict[str, Any], types: Plain) -> dict[str, Any]:
    """The scene with the values that its points take from types and from `float` written out; a point's own values
    win."""
    known = {}
    keys = [key for key in declared_fields(PointSpec) if key not in ("position",)]
    for i, item in enumerate(read_list(types, "point_type", None, "one or more [[point_type]] tables")):
        item = read_table(item, f"point_type.{i}")
        check_keys(item, [*keys, "float", "float_density"], f"point_type.{i}")
        known[read_text(item.get("name"), f"point_type.{i}.name")] = {k: v for k, v in item.items() if k != "name"}
    points = table.get("point", [])
    if not isinstance(points, Sequence) or isinstance(points, str):
        return table
    return {**table, "point": [_written_out(point, known, f"point.{i}") for i, point in enumerate(points)]}


def _written_out(point: Plain, types: Mapping[str, Mapping[str, Any]], path: str) -> Plain:
    if not isinstance(point, Mapping):
        return point
    found = dict(point)
    if "type" in found:
        found = {**types[read_text(found.pop("type"), f"{path}.type", types)], **found}
    if "float" not in found:
        if "float_density" in found:
            raise SceneError(f"{path}.float_density: is only used together with `float`, its volume [m^3]")
        return found
    volume = read_number(found.pop("float"), f"{path}.float", {"low": 0.0, "open_low": True, "unit": "m^3"})
    density = read_number(found.pop("float_density", DENSITY), f"{path}.float_density", {"low": 0.0, "unit": "kg/m^3"})
    return {**float_of(volume, density), **found}


def float_of(volume: float, density: float = DENSITY) -> dict[str, Any]:
    """A spherical float [m^3] at a free point: mass, volume, drag coefficient times frontal area, added mass."""
    frontal = math.pi / 4 * (6 * volume / math.pi) ** (2 / 3)
    body = {"mass": density * volume, "volume": volume, "drag_area": DRAG * frontal, "added_mass": ADDED_MASS}
    return {"kind": "free", **body}
