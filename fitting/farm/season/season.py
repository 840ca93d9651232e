"""The season month by month: required lift, schedule of floats, resulting geometry of the farm, and its report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from dropper_jax.base.errors import Progress, SceneError, part_of, silent
from dropper_jax.base.read import Table
from dropper_jax.load.library import FAMILIES, PREFIX
from fitting.farm.season.poses import Floating, Water, floating, needs, waters
from fitting.farm.site import Site
from fitting.farm.site.case import match_names, short
from fitting.farm.site.sections import SeasonValues

#: Visits, moved floats, and the floats of each month so far.
Plan = tuple[int, int, list[int]]


#: Times that the bounds on the number of floats are tightened.
TIGHTENED = 4


@dataclass(frozen=True)
class Month:
    """What a month needs: weights in water [N], forces on the points (points,) [N], bounds on the number of floats."""

    month: str
    wet_weight_n: float
    mussels_wet_n: float
    need_n: float
    least_need_n: float
    need_by_point_n: np.ndarray
    least: int
    most: int


@dataclass(frozen=True)
class Lying:
    """The farm on a number of floats: the equilibria in every water, and the distance [m] from its limits."""

    floats: int
    by_point: dict[str, int]
    poses: list[Floating]
    deepest_m: float
    shallowest_m: float
    sinking_m: float | None
    lifting_m: float | None
    holds: bool


def schedule(low: Sequence[int], high: Sequence[int], start: int | None = None) -> list[int]:
    """Number of installed floats in every month.

    Of all plans within the bounds, those with the fewest months of change are selected, then those that move the fewest
    floats, and finally the one with the fewest floats. The search goes month by month over numbers that are a bound of
    some month: a change to any other number can be shifted to one of these without another visit or float.

    Args:
        low, high: minimum and maximum floats of each month; where low is above high, low is used.
        start: floats before the first month; their first change is a visit too. None: they are newly installed.
    """
    spans = [(lo, max(lo, hi)) for lo, hi in zip(low, high, strict=True)]
    numbers = sorted({n for span in spans for n in span} | ({start} if start is not None else set()))
    best: dict[int | None, Plan] = {start: (0, 0, [])}
    for lo, hi in spans:
        best = {n: _best_plan(best, n) for n in numbers if lo <= n <= hi}
    return min(best.values(), key=lambda found: (*found[:2], found[2][-1:]))[2]


def _best_plan(best: dict[int | None, Plan], floats: int) -> Plan:
    """The best of the plans by their last number of floats, continued to this number."""
    found = []
    for before, (visits, moved, plan) in best.items():
        if before is not None:
            visits += before != floats
            moved += abs(floats - before)
        found.append((visits, moved, [*plan, floats]))
    return min(found)


def spread(count: int, need: Sequence[float] | np.ndarray) -> list[int]:
    """Floats distributed over points in proportion to their needs, as whole numbers by largest remainders."""
    wanted = np.maximum(need, 0.0)
    if not wanted.any():
        wanted = np.ones(len(need))
    share = count * wanted / wanted.sum()
    found = share.astype(int)
    order = np.argsort(found - share, kind="stable")
    found[order[: count - found.sum()]] += 1
    return found.tolist()


def season(site: Site, progress: Progress | None = None) -> Table:
    """The season of a site with `[season]` and `[[growth]]`.

    Bounds come from the force on the fixed points. The schedule is then checked by free equilibria at every state of
    the tide. If the backbone leaves its depths, the bounds are tightened by a float for each row and tried again.

    Returns:
        {points, lift_n, months: [{month, wet_weight_n, need_n, least, most, floats, change, by_point, poses, sinking_m,
        lifting_m, holds}], visits, handled, holds, flags}.

    Raises:
        SceneError: no `[season]`, no months, a float without lift, or no equilibrium.
    """
    season = site.season
    if season is None:
        raise SceneError("season: missing; needed: [season] with `points` and `volume`")
    if not site.growth:
        raise SceneError("growth: missing; needed: [[growth]] tables, one or more for each month")
    points = list(match_names(season.points, [p.name for p in site.scene.points if p.is_free], "season.points"))
    farm = _Farm(site, season, points, _lift(site, season), waters(site, season))
    say = progress or silent
    step = 0.5 / len(site.growth)
    rows = [farm.month(month, part_of(say, i * step, (i + 1) * step)) for i, month in enumerate(site.growth)]
    low = [row.least for row in rows]
    high = [row.most for row in rows]
    for _ in range(TIGHTENED):
        lying = []
        again = False
        for i, (row, floats) in enumerate(zip(rows, schedule(low, high, season.start), strict=True)):
            say(0.5 + 0.5 * i / len(rows), f"{row.month}: equilibria, floats: {floats}")
            found = farm.lying(row, floats)
            lying.append(found)
            if found.sinking_m is not None and found.sinking_m < 0.0 and low[i] <= high[i]:
                low[i] = max(low[i], floats + 1)
                again = True
            elif found.lifting_m is not None and found.lifting_m < 0.0 and low[i] < high[i]:
                high[i] = min(high[i], floats - 1)
                again = True
        if not again:
            break
    return farm.table(rows, lying)


def _lift(site: Site, season: SeasonValues) -> float:
    sea = site.sea
    lift = sea.gravity * season.volume * (sea.density - season.density)
    if lift <= 0.0:
        raise SceneError(
            f"season.density: {season.density:g} kg/m^3 does not lift; allowed: below the water's "
            f"{sea.density:g} kg/m^3"
        )
    return lift


@dataclass(frozen=True)
class _Farm:
    """The farm over its season.

    Attributes:
        points: names of those that carry floats; lift: of a float [N]; waters: states of the tide.
        known: equilibria in every water, by month and number of floats.
    """

    site: Site
    season: SeasonValues
    points: list[str]
    lift: float
    waters: tuple[Water, ...]
    floating_loads: dict[tuple[str, int], list[Floating]] = field(default_factory=dict)

    def month(self, month: str, say: Progress) -> Month:
        """Weights of a month, forces on the points and bounds on the number of floats."""
        season = self.season
        pulls = []
        # at the scene's level, for which its points are placed: floats at the surface follow the tide, others stay
        held = list(dict.fromkeys(water._replace(level=0.0) for water in self.waters))
        for i, water in enumerate(held):
            say(i / len(held), f"{month}: lift required of the floats")
            force, weights = needs(self.site, month, water, self.points)
            pulls.append(force)
        total = np.sum(pulls, axis=1)
        most = 10**6
        if season.least_share > 0.0:
            most = math.floor(max(total.min(), 0.0) / (season.least_share * self.lift) + 1e-9)
        return Month(
            month=month,
            wet_weight_n=sum(weights.values()),
            mussels_wet_n=sum(weights[name] for name in self.site.growth[month]),
            need_n=float(total.max()),
            least_need_n=float(total.min()),
            need_by_point_n=np.max(pulls, axis=0),
            least=math.ceil(season.reserve * max(total.max(), 0.0) / self.lift - 1e-9),
            most=most,
        )

    def lying(self, row: Month, count: int) -> Lying:
        """Geometry of the farm on this number of floats: rows by state of the tide, and distance from its limits."""
        floats = dict(zip(self.points, spread(count, row.need_by_point_n), strict=True))
        key = (row.month, count)
        if key not in self.floating_loads:
            self.floating_loads[key] = [
                floating(self.site, self.season, row.month, water, floats) for water in self.waters
            ]
        poses = self.floating_loads[key]
        deepest = max(pose.deepest_m for pose in poses)
        shallowest = min(pose.shallowest_m for pose in poses)
        limits = self.site.backbone
        sinking, lifting = (None, None) if limits is None else limits.margins(shallowest, deepest)
        inside = limits is None or limits.holds(shallowest, deepest)
        return Lying(
            floats=count,
            by_point=floats,
            poses=poses,
            deepest_m=deepest,
            shallowest_m=shallowest,
            sinking_m=sinking,
            lifting_m=lifting,
            holds=inside and all(pose.status == "ok" for pose in poses) and row.least <= count <= row.most,
        )

    def table(self, months: list[Month], lying: list[Lying]) -> Table:
        """The season as plain values."""
        floats = [found.floats for found in lying]
        start = floats[0] if self.season.start is None else self.season.start
        rows: list[Table] = []
        for month, found, change in zip(months, lying, np.diff(floats, prepend=start).tolist(), strict=True):
            reserve = found.floats * self.lift / month.need_n if month.need_n > 0.0 else None
            rows.append({**asdict(month), **asdict(found), "change": change, "reserve": reserve})
        return {
            "schema": 1,
            "status": "ok",
            "site": self.site.name,
            "scene": self.site.scene.name,
            "points": self.points,
            "lift_n": self.lift,
            "wanted_reserve": self.season.reserve,
            "least_share": self.season.least_share,
            "months": rows,
            "visits": sum(row["change"] != 0 for row in rows),
            "handled": sum(abs(row["change"]) for row in rows),
            "holds": all(row["holds"] for row in rows),
            "flags": [*double_crops(self.site), *(flag for row in rows for flag in _flags(row))],
        }


def double_crops(site: Site) -> list[str]:
    """A line about lines with mussels of `[[growth]]` whose type is a crop of the library already; none without any."""
    crops = tuple(f"{PREFIX}{name}-" for name, kind in FAMILIES.items() if kind.spread)
    types = {}
    for line in site.scene.as_written()["line"]:
        types[line["name"]] = [str(part.get("type", "")) for part in (line, *line.get("sections", ()))]
    grown = dict.fromkeys(name for lines in site.growth.values() for name in lines)
    both = [name for name in grown if any(kind.startswith(crops) for kind in types.get(name, ()))]
    if not both:
        return []
    return [
        f"{short(both)}: mussels of [[growth]] are added to a crop of the library, so floats carry both. Use a bare "
        "rope as type of these lines"
    ]


def _flags(row: Table) -> list[str]:
    month = row["month"]
    flags = []
    if row["least"] > row["most"]:
        flags.append(
            f"{month}: the reserve needs floats: {row['least']}, and `least_share` allows {row['most']} at most. Use "
            "smaller floats (volume), a smaller reserve or a smaller least_share"
        )
    bad = [pose for pose in row["poses"] if pose["status"] != "ok"]
    if bad:
        flags.append(f"{month}: no equilibrium at level {bad[0]['level_m']:+g} m: its depths are unknown")
    for key, what in (("sinking_m", "too deep"), ("lifting_m", "too high")):
        if row[key] is not None and row[key] < 0.0:
            flags.append(f"{month}: the backbone lies {-row[key]:.2g} m {what} (floats: {row['floats']})")
    return flags
