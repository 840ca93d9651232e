"""Weights of lines, bare and with mussels, whose thickness and density over depth give mass, diameter and weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.modelling.scene_model import bare_model, resting_nodes
from dropper_jax.scene import LineSpec, grown, sliced_lines


def overgrown(scene: Scene) -> Scene:
    """The scene with its `[line.growth]` and `[growth]` included in mass and diameter of the links; other scenes are
    unchanged."""
    if scene.season is None and all(line.growth is None for line in scene.lines):
        return scene
    # solved once for each scene, which is frozen and holds the result as a `cached_property` of it would
    if "_overgrown" in scene.__dict__:
        return scene.__dict__["_overgrown"]
    table = scene.to_dict()
    for section in (table, *table["line"]):
        section.pop("growth", None)
    bare = Scene.from_dict(table)
    z = resting_nodes(bare, bare_model(bare))[:, 2]
    changes = {}
    for i, (line, where) in enumerate(sliced_lines(scene)):
        layer = _layer(scene, line, z[where.nodes])
        if layer is not None:
            sea = scene.needed_sea
            found = grown(line.length, line.mass, line.needed_diameter, *layer, sea.density, sea.gravity)
            changes |= {f"line.{i}.mass": found.mass, f"line.{i}.diameter": found.diameter}
    found = bare.with_values(changes)
    object.__setattr__(scene, "_overgrown", found)
    return found


def has_mussels(scene: Scene, line: LineSpec) -> bool:
    """Whether mussels grow on a line of the scene, or on that from which this piece was cut."""
    in_season = scene.season is not None and scene.season.covers(line.name, line.piece_of)
    return line.growth is not None or in_season


def _layer(scene: Scene, line: LineSpec, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Thickness [m] and density [kg/m^3] on a line's links (n,), whose nodes (n + 1,) rest at z [m]; None if bare."""
    depth = -0.5 * (z[1:] + z[:-1])
    if line.growth is not None:
        return line.growth.thickness_and_density(depth)
    season = scene.season
    if season is None or not has_mussels(scene, line):
        return None
    arc = np.cumsum(line.length) - 0.5 * line.length
    return season.layer(line.name, line.piece_of, depth, arc, line.needed_diameter)


def season_table(scene: Scene, months: Sequence[float] | None = None) -> list[Table]:
    """Mass, diameter and wet weight per metre by month and depth, of each bare rope that `[growth]` grows on.

    The values are without the random factor and without harvest.

    Returns:
        Rows of lines, month, depth_m, thickness_m, diameter_m, mass_kg_per_m, wet_weight_n_per_m.

    Raises:
        SceneError: no `[growth]`, or a month outside its months.
    """
    season = scene.season
    if season is None:
        raise SceneError(
            "growth: missing; needed: [growth] with `lines`, `month`, `months`, `depth`, `thickness` and `density`, "
            "as `dropper new mussels` writes"
        )
    asked = season.months if months is None else list(dict.fromkeys(months))
    first = season.months[0]
    last = season.months[-1]
    for month in asked:
        if not first <= month <= last:
            raise SceneError(f"--months: {month:g} is out of range; allowed: {first:g} to {last:g} months")
    ropes: dict[tuple[float, float], list[str]] = {}
    for line in scene.lines:
        if season.covers(line.name, line.piece_of):
            for rope in _bare_ropes(line):
                ropes.setdefault(rope, []).append(line.name)
    sea = scene.needed_sea
    metre = np.ones(len(season.depth))
    rows = []
    for (mass, diameter), names in ropes.items():
        for month in asked:
            thickness, density = season.thickness_and_density(season.depth, month)
            found = grown(metre, mass * metre, diameter * metre, thickness, density, sea.density, sea.gravity)
            columns = {
                "depth_m": season.depth,
                "thickness_m": thickness,
                "diameter_m": found.diameter,
                "mass_kg_per_m": found.mass,
                "wet_weight_n_per_m": found.wet_weight,
            }
            for values in np.transpose(list(columns.values())).tolist():
                rows.append({"lines": names, "month": float(month), **dict(zip(columns, values, strict=True))})
    return rows


def _bare_ropes(line: LineSpec) -> list[tuple[float, float]]:
    """Mass [kg/m] and diameter [m] of the ropes that a line is made of, each once."""
    mass = np.round(line.mass / line.length, 9)  # links of one rope differ by the rounding of their lengths
    ropes = []
    for of_link in zip(mass.tolist(), line.needed_diameter.tolist(), strict=True):
        if of_link not in ropes:
            ropes.append(of_link)
    return ropes
