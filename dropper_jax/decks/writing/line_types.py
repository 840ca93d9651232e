"""Values of MoorDyn's line types, which are those per metre of equal links."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from dropper_jax.axial.force_table import ForceTable
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.load.scene import Scene

#: Digits of a value per metre that was stored per link: dividing by the link's length rounds the last ones.
DIGITS = 12
#: Effect and key of each coefficient, in the order of MoorDyn's columns.
COEFFICIENTS = (
    ("bending", "EI"),
    ("morison_drag", "cdn"),
    ("morison_inertia", "can"),
    ("morison_drag", "cdt"),
    ("morison_inertia", "cat"),
)


class LineKind(NamedTuple):
    """What a line type of MoorDyn gives.

    Attributes:
        values: diameter [m], mass [kg/m], EA [N], BA [N s] and `COEFFICIENTS`, in the order of MoorDyn's columns.
        table: rows (strain, tension [N]) of a tabulated law, with which EA is not used.
    """

    values: tuple[float, ...]
    table: tuple[tuple[float, float], ...] | None


def values_of_links(scene: Scene) -> np.ndarray:
    """`LineKind.values` of each link, then its length [m] (n, k); zero where a scene has none."""
    line = scene.line
    columns = [displaced_diameter(line, scene), line.mass / line.length, line.EA, line.axial_damping]
    columns += [scene.effects.get(effect, {}).get(key) for effect, key in COEFFICIENTS]
    rows = np.zeros((line.links, len(columns) + 1))
    for i, values in enumerate([*columns, line.length]):
        if values is not None:
            rows[:, i] = values
    return rows


def table_rows(table: ForceTable) -> tuple[tuple[float, float], ...]:
    """Rows of strain and tension [N]."""
    return tuple(zip(table.strain.tolist(), table.tension.tolist(), strict=True))


def name_line_types(kinds: Iterable[LineKind]) -> dict[LineKind, str]:
    """A name for each kind."""
    return {kind: f"type{i}" for i, kind in enumerate(dict.fromkeys(kinds), start=1)}


def short(x: float) -> float:
    """The number without the digits that are lost in values per link."""
    return float(f"{x:.{DIGITS}g}")
