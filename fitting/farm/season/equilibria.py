"""Equilibria of a month: with the floats' points fixed, for the required lift, and free on their floats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.base.records import without_keys
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.build import build_model
from dropper_jax.modelling.growth import overgrown
from dropper_jax.plausibility.line_weights import wet_weights
from dropper_jax.quantities.end_forces import fixed_point_loads
from dropper_jax.scene import whole_lines
from dropper_jax.statics.static_pose import equilibrium
from fitting.farm.site import Site
from fitting.farm.site.sections import SeasonValues

#: Fields of a point that come from its floats, and that are removed without any.
BODY = ("mass", "volume", "drag_area", "added_mass")
#: Fields that make a current change in time: a state of the tide has one speed.
CHANGING = ("time", "factor", "amplitude", "period", "phase")


class WaterState(NamedTuple):
    """A state of the tide: level [m], speed [m/s] and direction [rad] of the current, None for those of the scene."""

    level: float
    speed: float | None
    direction: float | None


def list_waters(site: Site, season: SeasonValues) -> tuple[WaterState, ...]:
    """Every combination of level and current of `[season]`, otherwise of `[cases]`."""
    levels = site.lists.levels if season.levels is None else season.levels
    heading = site.lists.current_direction
    if season.currents is not None:
        currents = [(speed, None if heading is None else np.radians(heading)) for speed in season.currents]
    else:
        tables = [storm.current for storm in site.storms if storm.current is not None]
        pairs = {(float(table["speed"]), table["direction"]) for table in tables if "speed" in table}
        currents = sorted(pairs) or [(None, None)]
    return tuple(WaterState(level, *current) for level, current in product(levels, currents))


def scene_at_rest(site: Site, month: str, water: WaterState, points: dict[str, Table]) -> Scene:
    """The farm of a month at rest in the water: with mussels on its lines, and some points replaced."""
    table = site.scene.as_written()
    for line in table["line"]:
        growth = site.growth[month].get(line.get("name"))
        if growth is not None:
            line["growth"] = dict(growth)
    table["point"] = [points.get(point["name"], point) for point in table["point"]]
    sea = without_keys(table["sea"], ("waves", "wave_current", "ramp"))
    sea["level"] = {"offset": water.level}
    if water.speed is not None:
        current = without_keys(sea.get("current", {}), CHANGING)
        sea["current"] = {**current, "speed": water.speed}
        if water.direction is not None:
            sea["current"]["direction"] = float(water.direction)
    table["sea"] = sea
    return overgrown(Scene.from_dict(table, site.scene.name))


def bare_points(site: Site, names: Sequence[str]) -> dict[str, Table]:
    """The points as specified, without the fields that floats give them."""
    found = {}
    for point in site.scene.as_written()["point"]:
        if point["name"] in names:
            found[point["name"]] = without_keys(point, BODY)
    return found


def find_float_loads(
    site: Site, month: str, water: WaterState, names: Sequence[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """Downward force of the lines on each float point (points,) [N] at its position in the scene, and the weight in
    water [N] of each line.

    Raises:
        SceneError: no equilibrium found.
    """
    fixed = {name: {**point, "kind": "fixed"} for name, point in bare_points(site, names).items()}
    scene = scene_at_rest(site, month, water, fixed)
    pose = equilibrium(build_model(scene))
    if pose.status != "ok":
        raise SceneError(f"season: {month}, level {water.level:+g} m: no equilibrium: {pose.message}")
    loads = fixed_point_loads(scene, pose.positions, pose.tension)
    wet = wet_weights(scene)
    by_line = {line.name: wet[line.links].sum() for line in whole_lines(scene)}
    return np.array([-loads[name][2] for name in names]), by_line


@dataclass(frozen=True)
class RestOnFloats:
    """An equilibrium on floats: its status, and depths of the lines of `[backbone]`, otherwise of the points."""

    level_m: float
    speed_m_per_s: float | None
    status: str
    shallowest_m: float
    deepest_m: float


def find_rest_on_floats(
    site: Site, season: SeasonValues, month: str, water: WaterState, floats: dict[str, int]
) -> RestOnFloats:
    """The equilibrium on its floats; depths are below the level."""
    points = bare_points(site, list(floats))
    for name, point in points.items():
        point |= _body(season, floats[name])
    scene = scene_at_rest(site, month, water, points)
    pose = equilibrium(build_model(scene))
    z = pose.positions[:, 2]
    lines = whole_lines(scene)
    nodes: list[int] = []
    if site.backbone is not None:
        backbone = site.matching(site.backbone.lines)
        for line in lines:
            if line.name in backbone:
                nodes += line.nodes.tolist()
    else:
        for line in lines:
            nodes += [line.nodes[stop] for stop, point in line.stops.items() if point in floats]
    below = water.level - z[nodes]
    return RestOnFloats(water.level, water.speed, pose.status, below.min(), below.max())


def _body(season: SeasonValues, count: int) -> Table:
    """Mass, volume, drag and added mass of the floats at a point."""
    if not count:
        return {}
    frontal = 0.25 * np.pi * (6.0 * season.volume / np.pi) ** (2.0 / 3.0)
    # coefficients of a sphere, as for floats of scenes
    return {
        "mass": count * season.density * season.volume,
        "volume": count * season.volume,
        "drag_area": count * 0.5 * frontal,
        "added_mass": 0.5,
    }
