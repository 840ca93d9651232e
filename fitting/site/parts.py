"""Parts and anchors of a site: names that patterns find, capacities, factors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.scene import AnchorSpec
from fitting.site.sections import AnchorTable, Curve

#: Names in an error line.
SHOWN = 6


@dataclasses.dataclass(frozen=True)
class Part:
    """Lines of one kind.

    Attributes:
        name: in reports.
        lines: names of its lines, as they were written in the scene.
        capacity: (lines,) [N] breaking load; of a line whose links differ the least.
        factor: on its loads by kind of state, `intact` and `broken`; a state that no case has may be None.
        curve: its fatigue curve, or None.
        of_scene: whether the capacity is the breaking load of the scene's lines, and so follows its parameters.
    """

    name: str
    lines: tuple[str, ...]
    capacity: np.ndarray
    factor: dict[str, float | None]
    curve: Curve | None
    of_scene: bool = False


@dataclasses.dataclass(frozen=True)
class Anchor:
    """Held points of one kind, with what holds them and the factors on their loads."""

    name: str
    points: tuple[str, ...]
    table: AnchorTable
    factor: dict[str, float | None]

    def utilisation(self, horizontal: np.ndarray, upward: np.ndarray) -> np.ndarray:
        """Load over what is held (...), without a factor, for horizontal and upward loads (...) [N]."""
        table = self.table
        spec = AnchorSpec(self.points[0], table.kind, table.weight, table.friction, table.capacity, 1.0)
        return spec.utilisation(horizontal, upward)


def match_names(patterns: Iterable[str], names: Sequence[str], path: str, what: str = "line") -> tuple[str, ...]:
    """Names that any of the patterns finds, in their order.

    Raises:
        SceneError: a pattern that finds nothing (with the nearest name).
    """
    found = set()
    for pattern in patterns:
        own = [name for name in names if fnmatchcase(name, pattern)]
        if not own:
            raise SceneError(f"{path}: {pattern!r} matches no {what}; {_nearest_hint(pattern, names)}")
        found.update(own)
    return tuple(name for name in names if name in found)


def _nearest_hint(pattern: str, names: Sequence[str]) -> str:
    hint = nearest(pattern, names)
    return hint if not hint.startswith("known:") else f"known: {short(names)}"


def short(names: Sequence[str]) -> str:
    """The first names of many."""
    names = list(names)
    more = f", ... ({len(names)} in all)" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) or "none") + more


def refuse_overlap(groups: Sequence[tuple[str, Sequence[str]]], what: str) -> None:
    """Refuse a name that two groups claim; groups are (path, names)."""
    owner: dict[str, str] = {}
    for path, names in groups:
        for name in names:
            if name in owner:
                raise SceneError(f"{path}: {what} {name!r} belongs to {owner[name]} already; allowed: one of the two")
            owner[name] = path
