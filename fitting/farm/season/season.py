"""The season month by month: required lift, floats, and the resulting geometry of the farm."""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict, dataclass, field

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, part_of, silent
from dropper_jax.base.read import Table
from dropper_jax.load.library import FAMILIES, PREFIX
from fitting.farm.season.equilibria import RestOnFloats, WaterState, find_float_loads, find_rest_on_floats, list_waters
from fitting.farm.season.schedule import distribute_floats, float_schedule
from fitting.farm.site import Site
from fitting.farm.site.patterns import first_names, match_names
from fitting.farm.site.sections import SeasonValues

#: Maximum number of times that the bounds on the number of floats are tightened.
MAX_TIGHTENED = 4
#: Maximum number of floats of a month where nothing limits it.
UNLIMITED_FLOATS = 10**6


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
class FarmOnFloats:
    """The farm on a number of floats: the equilibria in every water, and the distance [m] from its limits."""

    floats: int
    by_point: dict[str, int]
    poses: list[RestOnFloats]
    deepest_m: float
    shallowest_m: float
    sinking_m: float | None
    lifting_m: float | None
    holds: bool


def plan_season(site: Site, progress: Progress | None = None) -> Table:
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
    points = list(match_names(season.points, site.scene.free_points, "season.points"))
    farm = _Farm(site, season, points, _lift(site, season), list_waters(site, season))
    say = progress or silent
    step = 0.5 / len(site.growth)
    rows = [farm.month(month, part_of(say, i * step, (i + 1) * step)) for i, month in enumerate(site.growth)]
    low = [row.least for row in rows]
    high = [row.most for row in rows]
    for _ in range(MAX_TIGHTENED):
        on_floats = []
        is_narrowed = False
        for i, (row, floats) in enumerate(zip(rows, float_schedule(low, high, season.start), strict=True)):
            say(0.5 + 0.5 * i / len(rows), f"{row.month}: equilibria, floats: {floats}")
            found = farm.on_floats(row, floats)
            on_floats.append(found)
            is_narrowed |= _narrow_bounds(low, high, i, found)
        if not is_narrowed:
            break
    return farm.table(rows, on_floats)


def _narrow_bounds(low: list[int], high: list[int], i: int, found: FarmOnFloats) -> bool:
    """Narrow the bounds of month i by a float, in place, if the farm is outside its limits; whether it was."""
    if (found.sinking_m or 0.0) < 0.0 and low[i] <= high[i]:
        low[i] = max(low[i], found.floats + 1)
    elif (found.lifting_m or 0.0) < 0.0 and low[i] < high[i]:
        high[i] = min(high[i], found.floats - 1)
    else:
        return False
    return True


def _lift(site: Site, season: SeasonValues) -> float:
    """Lift of a float under water [N]."""
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
        equilibria: in every water, by month and number of floats.
    """

    site: Site
    season: SeasonValues
    points: list[str]
    lift: float
    waters: tuple[WaterState, ...]
    equilibria: dict[tuple[str, int], list[RestOnFloats]] = field(default_factory=dict)

    def month(self, month: str, say: Progress) -> Month:
        """Weights of a month, forces on the points and bounds on the number of floats."""
        season = self.season
        forces = []
        # at the scene's level, for which the positions of its points are given: floats at the surface follow the tide
        still_waters = list(dict.fromkeys(water._replace(level=0.0) for water in self.waters))
        for i, water in enumerate(still_waters):
            say(i / len(still_waters), f"{month}: lift required of the floats")
            force, weights = find_float_loads(self.site, month, water, self.points)
            forces.append(force)
        total = np.sum(forces, axis=1)
        most = UNLIMITED_FLOATS
        if season.least_share > 0.0:
            most = math.floor(max(total.min(), 0.0) / (season.least_share * self.lift) + 1e-9)
        return Month(
            month=month,
            wet_weight_n=sum(weights.values()),
            mussels_wet_n=sum(weights[name] for name in self.site.growth[month]),
            need_n=total.max(),
            least_need_n=total.min(),
            need_by_point_n=np.max(forces, axis=0),
            least=math.ceil(season.reserve * max(total.max(), 0.0) / self.lift - 1e-9),
            most=most,
        )

    def on_floats(self, row: Month, count: int) -> FarmOnFloats:
        """Geometry of the farm on this number of floats: rows by state of the tide, and distance from its limits."""
        floats = dict(zip(self.points, distribute_floats(count, row.need_by_point_n), strict=True))
        key = (row.month, count)
        if key not in self.equilibria:
            poses = [find_rest_on_floats(self.site, self.season, row.month, water, floats) for water in self.waters]
            self.equilibria[key] = poses
        poses = self.equilibria[key]
        deepest = max(pose.deepest_m for pose in poses)
        shallowest = min(pose.shallowest_m for pose in poses)
        sinking = None
        lifting = None
        holds = row.least <= count <= row.most and all(pose.status == "ok" for pose in poses)
        limits = self.site.backbone
        if limits is not None:
            sinking, lifting = limits.margins(shallowest, deepest)
            holds = holds and limits.holds(shallowest, deepest)
        return FarmOnFloats(
            floats=count,
            by_point=floats,
            poses=poses,
            deepest_m=deepest,
            shallowest_m=shallowest,
            sinking_m=sinking,
            lifting_m=lifting,
            holds=holds,
        )

    def table(self, months: list[Month], on_floats: list[FarmOnFloats]) -> Table:
        """The season as plain values."""
        before = self.season.start
        if before is None:
            before = on_floats[0].floats
        rows: list[Table] = []
        flags = double_crops(self.site)
        for month, found in zip(months, on_floats, strict=True):
            reserve = found.floats * self.lift / month.need_n if month.need_n > 0.0 else None
            row = {**asdict(month), **asdict(found), "change": found.floats - before, "reserve": reserve}
            rows.append(row)
            flags += _flags(row)
            before = found.floats
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
            "flags": flags,
        }


def double_crops(site: Site) -> list[str]:
    """A line about lines with mussels of `[[growth]]` whose type is a crop of the library already; none without any."""
    crops = tuple(f"{PREFIX}{name}-" for name, kind in FAMILIES.items() if kind.spread)
    cropped = set()
    for line in site.scene.as_written()["line"]:
        for part in (line, *line.get("sections", ())):
            if str(part.get("type", "")).startswith(crops):
                cropped.add(line["name"])
    grown = dict.fromkeys(itertools.chain.from_iterable(site.growth.values()))
    both = [name for name in grown if name in cropped]
    if not both:
        return []
    return [
        f"{first_names(both)}: mussels of [[growth]] are added to a crop of the library, so floats carry both. Use a "
        "bare rope as type of these lines"
    ]


def _flags(row: Table) -> list[str]:
    """Lines about the limits that a month does not meet."""
    month = row["month"]
    flags = []
    if row["least"] > row["most"]:
        line = (
            "{month}: the reserve needs floats: {least}, and `least_share` allows {most} at most. Use smaller floats "
            "(volume), a smaller reserve or a smaller least_share"
        )
        flags.append(line.format_map(row))
    bad = [pose for pose in row["poses"] if pose["status"] != "ok"]
    if bad:
        flags.append(f"{month}: no equilibrium at level {bad[0]['level_m']:+g} m: its depths are unknown")
    for key, what in (("sinking_m", "too deep"), ("lifting_m", "too high")):
        if (row[key] or 0.0) < 0.0:
            flags.append(f"{month}: the backbone lies {-row[key]:.2g} m {what} (floats: {row['floats']})")
    return flags
