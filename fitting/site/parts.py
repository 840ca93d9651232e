"""Parts and anchors of a site: names matched by patterns, capacities, factors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.scene import AnchorSpec
from fitting.site.sections import AnchorTable, Curve

#: Maximum number of names in an error message.
SHOWN = 6


@dataclasses.dataclass(frozen=True)
class Part:
    """Lines of one kind.

    Attributes:
        name: in reports.
        lines: names of its lines, as specified in the scene.
        capacity: (lines,) [N] breaking load; the minimum if the links of a line differ.
        factor: on its loads by kind of state, `intact` and `broken`; None for a state without cases.
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
    """Fixed points of one kind, with their anchors and the factors on their loads."""

    name: str
    points: tuple[str, ...]
    table: AnchorTable
    factor: dict[str, float | None]

    def utilisation(self, horizontal: np.ndarray, upward: np.ndarray) -> np.ndarray:
        """Ratio of load to capacity (...), without a factor, for horizontal and upward loads (...) [N]."""
        table = self.table
        spec = AnchorSpec(self.points[0], table.kind, table.weight, table.friction, table.capacity, 1.0)
        return spec.utilisation(horizontal, upward)


def match_names(patterns: Iterable[str], names: Sequence[str], path: str, what: str = "line") -> tuple[str, ...]:
    """Names that match any of the patterns, in order.

    Raises:
        SceneError: a pattern without a match (with the nearest name).
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
    """The first names of a long list."""
    names = list(names)
    more = f", ... ({len(names)} in total)" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) or "none") + more


def refuse_overlap(groups: Sequence[tuple[str, Sequence[str]]], what: str) -> None:
    """Reject a name that belongs to two groups; groups are (path, names)."""
    owner: dict[str, str] = {}
    for path, names in groups:
        for name in names:
            if name in owner:
                raise SceneError(f"{path}: {what} {name!r} already belongs to {owner[name]}; allowed: one of the two")
            owner[name] = path
