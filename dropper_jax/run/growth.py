"""Weights of lines, bare and with mussels, whose thickness and density over depth give mass, diameter and weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.scene import LineSpec, grown, sliced_lines


def overgrown(scene: Scene) -> Scene:
    """The scene with its `[line.growth]` and `[growth]` included in mass and diameter of the links; other scenes are
    unchanged."""
    if scene.season is None and all(line.growth is None for line in scene.lines):
        return scene
    if "_overgrown" in scene.__dict__:  # an equilibrium: solved once for each scene
        return scene.__dict__["_overgrown"]
    bare = _bare(scene)
    z = static_pose(bare, bare_model(bare)).positions[:, 2]
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


def _bare(scene: Scene) -> Scene:
    table = scene.to_dict()
    table.pop("growth", None)
    for line in table["line"]:
        line.pop("growth", None)
    return Scene.from_dict(table)


def _layer(scene: Scene, line: LineSpec, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Thickness [m] and density [kg/m^3] on a line's links (n,), whose nodes (n + 1,) rest at z [m]; None if bare."""
    depth = -0.5 * (z[1:] + z[:-1])
    if line.growth is not None:
        return line.growth.over(depth)
    season = scene.season
    if season is None or not season.on(line.name, line.piece_of):
        return None
    return season.layer(
        line.name, line.piece_of, depth, np.cumsum(line.length) - 0.5 * line.length, line.needed_diameter
    )


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
    asked = season.months if months is None else months
    for month in asked:
        if not season.months[0] <= month <= season.months[-1]:
            raise SceneError(
                f"--months: {month:g} is out of range; allowed: {season.months[0]:g} to {season.months[-1]:g} months"
            )
    ropes: dict[tuple[float, float], list[str]] = {}
    for line in scene.lines:
        if season.on(line.name, line.piece_of):
            ropes.setdefault((float(line.mass[0] / line.length[0]), float(line.needed_diameter[0])), []).append(
                line.name
            )
    sea = scene.needed_sea
    metre = np.ones(len(season.depth))
    rows = []
    for (mass, diameter), names in ropes.items():
        for month in asked:
            thickness, density = season.over(season.depth, month)
            found = grown(metre, mass * metre, diameter * metre, thickness, density, sea.density, sea.gravity)
            for i in range(len(metre)):
                rows.append(
                    {
                        "lines": names,
                        "month": float(month),
                        "depth_m": float(season.depth[i]),
                        "thickness_m": float(thickness[i]),
                        "diameter_m": float(found.diameter[i]),
                        "mass_kg_per_m": float(found.mass[i]),
                        "wet_weight_n_per_m": float(found.wet_weight[i]),
                    }
                )
    return rows
