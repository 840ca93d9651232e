"""Parts and anchors of a site, with capacities and factors for all kinds of its states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Values, read_items, refuse
from dropper_jax.base.records import names_of, without_keys
from dropper_jax.load.scene import Scene
from dropper_jax.scene import whole_lines
from fitting.farm.site.patterns import first_names, match_names, read_patterns
from fitting.farm.site.sections import AnchorTable, Curve, Factors, PartTable


@dataclass(frozen=True)
class Part:
    """Lines of one kind.

    Attributes:
        name: in reports.
        lines: names of its lines, as specified in the scene.
        capacity: (lines,) [N] breaking load; the minimum if the links of a line differ.
        factors: on its loads, with source, edition and clause.
        curve: its fatigue curve, or None.
        of_scene: whether the capacity is the breaking load of the scene's lines, and so follows its parameters.
    """

    name: str
    lines: tuple[str, ...]
    capacity: np.ndarray
    factors: Factors
    curve: Curve | None
    of_scene: bool


@dataclass(frozen=True)
class Anchor:
    """Fixed points of one kind, with their anchors and the factors on their loads."""

    name: str
    points: tuple[str, ...]
    table: AnchorTable
    factor: dict[str, float]


def refuse_duplicates(path: str, names: Sequence[str]) -> None:
    """Reject a name that is used twice."""
    for name in names:
        if list(names).count(name) > 1:
            raise refuse(path, name, "is used twice", "a unique name")


def read_parts(
    table: Values,
    scene: Scene,
    lines: tuple[str, ...],
    factors: Factors,
    kinds: Sequence[str],
) -> tuple[Part, ...]:
    """The parts, with factors for all `kinds` of states; every line is in one of them or in `unchecked`."""
    specs = {line.name: line.spec for line in whole_lines(scene)}
    found = []
    unchecked = read_patterns(table.get("unchecked", []), "unchecked")
    groups = [("unchecked", match_names(unchecked, lines, "unchecked"))]
    for i, part in enumerate(read_items(PartTable.read, table.get("part", []), "part")):
        path = f"part.{i}"
        names = match_names(part.lines, lines, f"{path}.lines")
        groups.append((f"{path} ({part.name!r})", names))
        own = _complete_factors(part.factor, factors, kinds, f"{path}.factor")
        capacity = np.array([_capacity(part, specs[name].breaking_load, name, path) for name in names])
        found.append(Part(part.name, names, capacity, own, part.curve, part.capacity is None))
    refuse_duplicates("part.name", names_of(found))
    owners = _find_owners(groups, "line")
    left = [name for name in lines if name not in owners]
    if left:
        raise SceneError(f"part: no part has the lines {first_names(left)}. Use a [[part]] with them, or `unchecked`")
    return tuple(found)


def _capacity(part: PartTable, capacity: np.ndarray | None, line: str, path: str) -> float:
    """Breaking load [N] of a line: that of its part, otherwise the minimum of its links in the scene."""
    if part.capacity is not None:
        return part.capacity
    if capacity is None:
        raise SceneError(
            f"{path}.capacity: missing; needed: the breaking load [N] of {part.name!r}, because {line!r} has no "
            "`breaking_load` in the scene"
        )
    return float(np.min(capacity))


def _complete_factors(given: Factors | None, table: Factors, kinds: Sequence[str], path: str) -> Factors:
    """The factors of a part, with those of `[factors]` for kinds of states that it does not give."""
    given = given or table
    common = without_keys(table.by_kind, given.by_kind)
    sources = [given.source, *(f"{kind}: {table.source}, {table.edition}, {table.clause}" for kind in common)]
    found = replace(given, **common, source="; ".join(sources))
    for kind in sorted(kinds):
        if kind not in found.by_kind:
            raise SceneError(f"{path}: missing; needed: a number, or `{kind}` in [factors], because cases are {kind}")
    return found


def read_anchors(table: Values, scene: Scene, factors: Factors, kinds: Sequence[str]) -> tuple[Anchor, ...]:
    """The anchors, with factors for all `kinds` of states; a fixed point belongs to one of them at most."""
    found = []
    groups = []
    for i, anchor in enumerate(read_items(AnchorTable.read, table.get("anchor", []), "anchor")):
        path = f"anchor.{i}"
        points = match_names(anchor.points, scene.fixed_points, f"{path}.points", "fixed point")
        groups.append((path, points))
        own = _complete_factors(anchor.factor, factors, kinds, f"{path}.factor")
        found.append(Anchor(anchor.name or ", ".join(anchor.points), points, anchor, own.by_kind))
    _find_owners(groups, "point")
    refuse_duplicates("anchor.name", names_of(found))
    return tuple(found)


def _find_owners(groups: Sequence[tuple[str, Sequence[str]]], what: str) -> dict[str, str]:
    """The path of the group of each name; groups are (path, names).

    Raises:
        SceneError: a name that belongs to two groups.
    """
    owner: dict[str, str] = {}
    for path, names in groups:
        for name in names:
            if name in owner:
                raise SceneError(f"{path}: {what} {name!r} already belongs to {owner[name]}; allowed: one of the two")
            owner[name] = path
    return owner
