"""`[objective]` and `[[constraint]]` of a site.

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
from itertools import chain

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Plain, Values, check_keys, read_list, read_number, read_table, read_text, refuse
from dropper_jax.base.records import names_of
from dropper_jax.modelling.growth import overgrown
from dropper_jax.modelling.scene_model import bare_model
from fitting.farm.optimise.goals import DepthRange, Goals, Objective, StormLimit
from fitting.farm.optimise.quantities import named_quantity
from fitting.farm.site import Site
from fitting.farm.site.patterns import match_names, read_patterns

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
    if kind == "quantity":
        limit = read_number(table.get(key), f"{path}.{key}", {"above": 0.0, "unit": "N or m"})
        path = f"{path}.of"
        of = read_text(table.get("of"), path)
        named_quantity(of, bare_model(overgrown(site.scene)), path, limit)
        return StormLimit(kind, path, of, limit)
    limit = read_number(table.get(key), f"{path}.{key}", {"above": 0.0, "unit": "m"})
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
    patterns = read_patterns(table.get("points", []), f"{path}.points")
    points = match_names(patterns, free_points, f"{path}.points", "free point")
    patterns = read_patterns(table.get("lines", []), f"{path}.lines")
    lines = match_names(patterns, line_names, f"{path}.lines")
    if not (points or lines):
        raise SceneError(f"{path}: has neither points nor lines; needed: patterns of one or both")
    return DepthRange(f"depth {path.split('.')[1]}", points, lines, low, high)
