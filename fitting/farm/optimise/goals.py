"""Objective and constraints of a site's design.

[objective]
of = "material"                 kilograms times price; or "load": the maximum utilisation of `part`; or "motion":
                                the maximum displacement [m] of nodes of `lines` from their mean position
price = { backbone = 3.0, "loop-*" = 0.0 }   per kg of lines, by pattern; default 1
float_price = 8.0               per kg of floats (points with a volume); default 1

[[constraint]]                  in addition to those of the site's parts, anchors and [backbone], which always apply
kind = "depth"                  of `points` (patterns) or `lines` at rest: `shallowest`, `deepest` [m]
kind = "clearance"              of each of `lines` from the next one in storms: `minimum` [m]
kind = "motion"                 of `lines` in storms: `maximum` [m]
kind = "quantity"               `of` = "tension.west-leg.fairlead.max", "anchor.west.horizontal.max" or
                                "offset.buoy.max" in storms: `maximum` [N] or [m]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import chain, groupby, pairwise, product
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Values, check_keys, read_list, read_number, read_table, read_text, refuse
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from dropper_jax.run.growth import overgrown
from dropper_jax.run.scene_model import bare_model
from fitting.farm.optimise.quantities import (
    Clearance,
    LimitedSignal,
    NodeDisplacement,
    anchor_loads,
    line_nodes,
    named_quantity,
    part_load,
)
from fitting.farm.site import Site
from fitting.farm.site.case import match_names, read_patterns

#: Keys of `[objective]` by the quantity to minimise.
OBJECTIVES = {
    "material": ("of", "price", "float_price"),
    "load": ("of", "part"),
    "motion": ("of", "lines"),
}
#: Keys of a `[[constraint]]` by its kind.
KINDS = {
    "depth": ("kind", "points", "lines", "shallowest", "deepest"),
    "clearance": ("kind", "lines", "minimum"),
    "motion": ("kind", "lines", "maximum"),
    "quantity": ("kind", "of", "maximum"),
}


@dataclass(frozen=True)
class Objective:
    """`[objective]`: the quantity to minimise."""

    of: str
    price: tuple[tuple[str, float], ...] = ()
    float_price: float = 1.0
    part: str = ""
    lines: tuple[str, ...] = ()

    def material(self, scene: Scene) -> float:
        """Kilograms times price of lines and floats."""
        total = 0.0
        for line in scene.lines:
            name = line.piece_of or line.name
            price = next((p for pattern, p in self.price if fnmatchcase(name, pattern)), 1.0)
            total += price * float(np.sum(line.mass))
        floats = (p for p in scene.points if p.is_free and p.volume)
        return total + self.float_price * sum(float(p.mass or 0.0) for p in floats)


class DepthUtilisation(NamedTuple):
    """Name of a bound, its utilisation (1 at the bound), and the derivative of this by the variables (p,)."""

    name: str
    value: float
    slope: np.ndarray


@dataclass(frozen=True)
class DepthRange:
    """Range of depths for nodes at rest [m] below the water's level."""

    name: str
    points: tuple[str, ...]
    lines: tuple[str, ...]
    shallowest: float | None
    deepest: float | None

    def nodes(self, model: Model) -> np.ndarray:
        """Numbers of the free nodes that it applies to."""
        names = names_of(model.points)
        point_nodes = [model.geometry.point_node[names.index(name)] for name in self.points]
        return np.concatenate([point_nodes, *line_nodes(model, self.lines).values()]).astype(int)

    def utilisations(self, model: Model, r: np.ndarray, dr: np.ndarray, level: float) -> list[DepthUtilisation]:
        """Each bound at the worst node."""
        nodes = self.nodes(model)
        depth = level - r[nodes, 2]
        found = []
        unit = abs(self.deepest or self.shallowest or 1.0)
        for key, bound, sign in (("shallowest", self.shallowest, 1.0), ("deepest", self.deepest, -1.0)):
            if bound is None:
                continue
            worst = int(np.argmin(sign * depth))
            value = 1.0 + sign * (bound - depth[worst]) / unit
            slope = sign * dr[:, nodes[worst], 2] / unit
            found.append(DepthUtilisation(f"{self.name} {key}", value, slope))
        return found


def check_depths(depths: Sequence[DepthRange], model: Model) -> None:
    """Reject bounds that no pose meets: one requires a node to be deeper than another one allows.

    Raises:
        SceneError: with both of them.
    """
    own = [(depth, set(depth.nodes(model).tolist())) for depth in depths]
    for one, nodes in own:
        for other, others in own:
            if one.shallowest is None or other.deepest is None or not nodes & others:
                continue
            if one.shallowest > other.deepest:
                raise SceneError(
                    f"constraint: {one.name} shallowest of {one.shallowest:g} m contradicts {other.name} deepest of "
                    f"{other.deepest:g} m on the same nodes; allowed: at most {other.deepest:g} m"
                )


@dataclass(frozen=True)
class StormLimit:
    """A constraint on storms: its kind and path, the lines or the quantity that it applies to, and its limit."""

    kind: str
    path: str
    of: tuple[str, ...] | str
    limit: float

    def quantity(self, model: Model, number: int) -> LimitedSignal:
        """The quantity with a limit of 1; `number` counts constraints of this kind from 1."""
        if isinstance(self.of, str):
            return named_quantity(self.of, model, self.path, self.limit)
        if self.kind == "clearance":
            return Clearance(f"clearance {number}", _pairs(model, self.of, self.path), self.limit)
        return NodeDisplacement(f"motion {number}", _nodes(model, self.of), 1.0 / self.limit)


@dataclass(frozen=True)
class Goals:
    """Objective and constraints, read; those on storms by kind."""

    objective: Objective
    depths: tuple[DepthRange, ...]
    limits: tuple[StormLimit, ...]

    def quantities(self, site: Site, model: Model, kind: str = "intact") -> tuple[LimitedSignal, ...]:
        """The quantities of storms: all with a limit of 1, and the objective last if it depends on storms.

        If a line breaks (`kind` "broken") these are the loads of parts and anchors, with their own factors.
        """
        found: list[LimitedSignal] = [part_load(model, part, kind) for part in site.parts]
        found += [quantity for anchor in site.anchors for quantity in anchor_loads(model, anchor, kind)]
        if kind != "intact":
            return tuple(found)
        for _, limits in groupby(self.limits, key=lambda limit: limit.kind):
            found += [limit.quantity(model, i) for i, limit in enumerate(limits, 1)]
        if self.objective.of == "motion":
            found.append(NodeDisplacement("largest motion", _nodes(model, self.objective.lines)))
        return tuple(found)


def _nodes(model: Model, lines: Sequence[str]) -> tuple[int, ...]:
    """Numbers of the free nodes of lines, each once."""
    return tuple(dict.fromkeys(np.concatenate(list(line_nodes(model, lines).values())).tolist()))


def _pairs(model: Model, lines: Sequence[str], path: str) -> tuple[tuple[int, int], ...]:
    """Nodes of each line with those of the next one, without shared nodes; ends only if a line has no inner ones.

    Raises:
        SceneError: two lines without such a pair.
    """
    nodes = line_nodes(model, lines)
    pairs: list[tuple[int, int]] = []
    for one, other in pairwise(nodes):
        first = _unshared_nodes(model, nodes[one], nodes[other])
        second = _unshared_nodes(model, nodes[other], nodes[one])
        if not (first and second):
            raise SceneError(f"{path}.lines: {one!r} and {other!r} have no free nodes of their own. Use more links")
        pairs += product(first, second)
    return tuple(pairs)


def _unshared_nodes(model: Model, nodes: np.ndarray, others: np.ndarray) -> list[int]:
    """The inner ones of a line's nodes; of a line of one link, its free ends that are not among `others`."""
    inner = nodes[nodes < model.geometry.inner]
    if len(inner):
        return inner.tolist()
    return nodes[~np.isin(nodes, others)].tolist()


def read_goals(site: Site) -> Goals:
    """The goals of a site.

    Raises:
        SceneError: an unknown objective, line, point or part, or contradicting bounds.
    """
    line_names = site.lines
    free_points = site.scene.free_points
    objective = _objective(read_table(site.raw.get("objective", {}), "objective"), site)
    depths = []
    limits = []
    if site.backbone is not None:
        own = site.backbone
        lines = match_names(own.lines, line_names, "backbone.lines")
        depths.append(DepthRange("backbone", (), lines, own.shallowest, own.deepest))
    items = read_list(site.raw.get("constraint", []), "constraint", None, "one or more [[constraint]] tables")
    for i, item in enumerate(items):
        path = f"constraint.{i}"
        table = read_table(item, path)
        kind = read_text(table.get("kind"), f"{path}.kind", KINDS)
        check_keys(table, KINDS[kind], path)
        if kind == "depth":
            depths.append(_depth(table, path, line_names, free_points))
        else:
            limits.append(_storm_limit(table, path, kind, site))
    limits.sort(key=lambda limit: list(KINDS).index(limit.kind))
    return Goals(objective, tuple(depths), tuple(limits))


def _storm_limit(table: Values, path: str, kind: str, site: Site) -> StormLimit:
    """A `[[constraint]]` on storms.

    Raises:
        SceneError: no limit, lines that do not exist, one line for a clearance, or a quantity without a limit.
    """
    key = "minimum" if kind == "clearance" else "maximum"
    unit = "N or m" if kind == "quantity" else "m"
    limit = read_number(table.get(key), f"{path}.{key}", {"above": 0.0, "unit": unit})
    if kind == "quantity":
        path = f"{path}.of"
        of = read_text(table.get("of"), path)
        named_quantity(of, bare_model(overgrown(site.scene)), path, limit)
        return StormLimit(kind, path, of, limit)
    lines = _match_lines(table.get("lines"), f"{path}.lines", site)
    if kind == "clearance" and len(lines) < 2:
        raise SceneError(f"{path}.lines: matches only {lines[0]!r}. Use patterns of two lines or more")
    return StormLimit(kind, path, lines, limit)


def _match_lines(given: Plain, path: str, site: Site) -> tuple[str, ...]:
    """The lines of a site that match patterns; at least one."""
    patterns = read_patterns(given, path)
    if not patterns:
        raise refuse(path, [], "is empty", "at least one pattern")
    return match_names(patterns, site.lines, path)


def _objective(table: Values, site: Site) -> Objective:
    """`[objective]` of a site."""
    check_keys(table, chain.from_iterable(OBJECTIVES.values()), "objective")
    of = read_text(table.get("of", "material"), "objective.of", OBJECTIVES)
    for key in table:
        if key not in OBJECTIVES[of]:
            used = ", ".join(OBJECTIVES[of])
            raise SceneError(f"objective.{key}: is not used to minimise {of!r}; allowed: {used}")
    price = read_table(table.get("price", {}), "objective.price")
    for pattern in price:
        match_names([pattern], site.lines, "objective.price")
    prices = tuple((k, read_number(v, f"objective.price.{k}", {"low": 0.0})) for k, v in price.items())
    part = ""
    if of == "load":
        part = read_text(table.get("part"), "objective.part", names_of(site.parts))
    lines = _match_lines(table.get("lines", "*"), "objective.lines", site)
    per_float = read_number(table.get("float_price", 1.0), "objective.float_price", {"low": 0.0})
    return Objective(of, prices, per_float, part, lines)


def _depth(table: Values, path: str, line_names: Sequence[str], free_points: Sequence[str]) -> DepthRange:
    """A `[[constraint]]` on depth, of these lines and free points of the scene."""
    bounds = {}
    for key in ("shallowest", "deepest"):
        if key in table:
            bounds[key] = read_number(table[key], f"{path}.{key}", {"unit": "m"})
    low = bounds.get("shallowest")
    high = bounds.get("deepest")
    if low is None and high is None:
        raise SceneError(f"{path}: no bound is given; needed: `shallowest`, `deepest` or both [m]")
    if low is not None and high is not None and not low < high:
        raise SceneError(f"{path}.deepest: {high:g} m contradicts shallowest; allowed: > {low:g} m")
    point_patterns = read_patterns(table.get("points", []), f"{path}.points")
    points = match_names(point_patterns, free_points, f"{path}.points", "free point")
    line_patterns = read_patterns(table.get("lines", []), f"{path}.lines")
    lines = match_names(line_patterns, line_names, f"{path}.lines")
    if not (points or lines):
        raise SceneError(f"{path}: has neither points nor lines; needed: patterns of one or both")
    return DepthRange(f"depth {path.split('.')[1]}", points, lines, low, high)
