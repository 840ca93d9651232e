"""The season month by month: required lift, number of floats, and the resulting geometry of the farm."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from fitting.season.poses import Water, floating, needs, waters
from fitting.season.schedule import schedule, spread
from fitting.site import Site
from fitting.site.parts import match_names

SCHEMA = 1
#: Maximum number of times that bounds are tightened when the farm leaves its depths.
ROUNDS = 4


def season(site: Site, progress: Progress | None = None) -> dict[str, Any]:
    """The season of a site with `[season]` and `[[growth]]`.

    Bounds come from the force on the fixed points. The schedule is then checked by free equilibria at every state of
    the tide. If the backbone leaves its depths, the bounds are tightened by a float for each row and tried again.

    Returns:
        {points, lift_n, months: [{month, wet_weight_n, need_n, least, most, floats, change, by_point, poses, sinking_m,
        lifting_m, holds}], visits, handled, holds, flags}.

    Raises:
        SceneError: no `[season]`, no months, a float without lift, or no equilibrium.
    """
    if site.season is None:
        raise SceneError("season: missing; needed: [season] with `points` and `volume`")
    if not site.growth:
        raise SceneError("growth: missing; needed: [[growth]] tables, one or more for each month")
    names = list(
        match_names(site.season.points, [p.name for p in site.scene.points if p.kind == "free"], "season.points")
    )
    lift = _lift(site)
    say, all_waters = progress or silent, waters(site)
    months, rows = list(site.growth), []
    # at the scene's water level, for which its points are placed: floats at the surface follow the tide, others stay
    held = [Water(0.0, speed) for speed in dict.fromkeys(water.speed for water in all_waters)]
    for i, month in enumerate(months):
        pulls = []
        for j, water in enumerate(held):
            say(0.5 * (i + j / len(held)) / len(months), f"{month}: lift required of the floats")
            force, weights = needs(site, month, water, names)
            pulls.append(force)
        rows.append(_month(site, month, weights, np.array(pulls), lift))
    low, high = [row["least"] for row in rows], [row["most"] for row in rows]
    known: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for _ in range(ROUNDS):
        plan = schedule(low, high, site.season.start)
        again = False
        for i, (row, count) in enumerate(zip(rows, plan, strict=True)):
            say(0.5 + 0.5 * i / len(rows), f"{row['month']}: {count} floats")
            row |= _lying(site, row, names, count, all_waters, known)
            if row["sinking_m"] is not None and row["sinking_m"] < 0.0 and low[i] <= high[i]:
                low[i], again = max(low[i], count + 1), True
            elif row["lifting_m"] is not None and row["lifting_m"] < 0.0 and low[i] < high[i]:
                high[i], again = min(high[i], count - 1), True
        if not again:
            break
    return _season_table(site, names, lift, rows)


def _lift(site: Site) -> float:
    sea, own = site.scene.sea, site.season
    lift = sea.gravity * own.volume * (sea.density - own.density)
    if lift <= 0.0:
        raise SceneError(
            f"season.density: {own.density:g} kg/m^3 does not lift; allowed: below the water's {sea.density:g} kg/m^3"
        )
    return lift


def _month(site: Site, month: str, weights: dict[str, float], pulls: np.ndarray, lift: float) -> dict[str, Any]:
    """Weights and bounds of a month; forces on the points (waters, points) [N]."""
    total = pulls.sum(axis=1)
    own = site.season
    share = own.least_share
    most = math.floor(max(total.min(), 0.0) / (share * lift) + 1e-9) if share > 0.0 else 10**6
    return {
        "month": month,
        "wet_weight_n": sum(weights.values()),
        "mussels_wet_n": sum(weights[name] for name in site.growth[month]),
        "need_n": float(total.max()),
        "least_need_n": float(total.min()),
        "need_by_point_n": pulls.max(axis=0),
        "least": math.ceil(own.reserve * max(total.max(), 0.0) / lift - 1e-9),
        "most": most,
    }


def _lying(
    site: Site, row: dict[str, Any], names: list[str], count: int, all_waters: tuple[Water, ...], cache: dict[Any, Any]
) -> dict[str, Any]:
    """Geometry of the farm on this number of floats: rows by state of the tide, and distance from its limits."""
    floats = dict(zip(names, spread(count, row["need_by_point_n"]), strict=True))
    key = (row["month"], count)
    if key not in cache:
        cache[key] = [floating(site, row["month"], water, floats) for water in all_waters]
    poses = cache[key]
    deepest, shallowest = max(p["deepest_m"] for p in poses), min(p["shallowest_m"] for p in poses)
    own = site.backbone
    sinking = None if own is None or own.deepest is None else own.deepest - deepest
    lifting = None if own is None or own.shallowest is None else shallowest - own.shallowest
    found = all(p["status"] == "ok" for p in poses)
    inside = all(margin is None or margin >= 0.0 for margin in (sinking, lifting))
    return {
        "floats": count,
        "by_point": floats,
        "poses": poses,
        "deepest_m": deepest,
        "shallowest_m": shallowest,
        "sinking_m": sinking,
        "lifting_m": lifting,
        "holds": found and inside and row["least"] <= count <= row["most"],
    }


def _season_table(site: Site, names: list[str], lift: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    before, flags, visits, handled = site.season.start, [], 0, 0
    for row in rows:
        row["change"] = 0 if before is None else row["floats"] - before
        visits, handled, before = visits + (row["change"] != 0), handled + abs(row["change"]), row["floats"]
        row["reserve"] = row["floats"] * lift / row["need_n"] if row["need_n"] > 0.0 else None
        flags += _flags(row)
    return {
        "schema": SCHEMA,
        "status": "ok",
        "site": site.name,
        "scene": site.scene.name,
        "points": names,
        "lift_n": lift,
        "wanted_reserve": site.season.reserve,
        "least_share": site.season.least_share,
        "months": rows,
        "visits": visits,
        "handled": handled,
        "holds": all(row["holds"] for row in rows),
        "flags": flags,
    }


def _flags(row: dict[str, Any]) -> list[str]:
    month, flags = row["month"], []
    if row["least"] > row["most"]:
        flags.append(
            f"{month}: at least {row['least']} floats against sinking, at most {row['most']} against rising: no number "
            "satisfies both. Use smaller floats, a smaller reserve or least_share"
        )
    bad = [pose for pose in row["poses"] if pose["status"] != "ok"]
    if bad:
        flags.append(f"{month}: no equilibrium at level {bad[0]['level_m']:+g} m: its depths are unknown")
    for key, what in (("sinking_m", "too deep"), ("lifting_m", "too high")):
        if row[key] is not None and row[key] < 0.0:
            flags.append(f"{month}: the backbone lies {-row[key]:.2g} m {what} on {row['floats']} floats")
    return flags
