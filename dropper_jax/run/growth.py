"""Mussels on a rope: thickness and density over depth give mass, diameter and wet weight of each link."""

from __future__ import annotations

from collections.abc import Sequence

from dropper_jax.base.read import plain
from dropper_jax.load.scene import Scene
from dropper_jax.run.arrays import bare_model, static_pose
from dropper_jax.scene import grown, line_slices


def with_growth(
    scene: Scene, depth: Sequence[float], thickness: Sequence[float], density: Sequence[float] | float
) -> Scene:
    """The scene with mussels on its bare line, thickness [m] and density [kg/m^3] given over depth [m] (rising).

    The depth of a link is that of its middle in the pose of the bare line at rest in calm water. Changes `line.0.mass`
    and `line.0.diameter`; `[line.growth]` does the same and keeps the bare rope in the scene.

    Raises:
        SceneError: no sea, no diameter of the bare rope, or tables that do not fit together.
    """
    table = scene.to_dict()
    table["line"][0]["growth"] = {"depth": plain(depth), "thickness": plain(thickness), "density": plain(density)}
    return overgrown(Scene.from_dict(table))


def overgrown(scene: Scene) -> Scene:
    """The scene with its `[line.growth]` in mass and diameter of the links; a scene without growth as it is."""
    if all(line.growth is None for line in scene.lines):
        return scene
    table = scene.to_dict()
    for line in table["line"]:
        line.pop("growth", None)
    bare = Scene.from_dict(table)
    z = static_pose(bare, bare_model(bare)).positions[:, 2]
    changes = {}
    for i, (line, where) in enumerate(zip(scene.lines, line_slices(scene), strict=True)):
        if line.growth is None:
            continue
        nodes = z[where.nodes]
        layer, heavy = line.growth.over(-0.5 * (nodes[1:] + nodes[:-1]))
        found = grown(line.length, line.mass, line.diameter, layer, heavy, scene.sea.density, scene.sea.gravity)
        changes |= {f"line.{i}.mass": found.mass, f"line.{i}.diameter": found.diameter}
    return bare.with_values(changes)
