"""Consistency of a scene with its water and with mussel growth."""

from __future__ import annotations

from collections.abc import Iterator

from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.effects.buoyancy import displaced_diameter
from dropper_jax.scene import SceneData

#: Effects that take the diameter of the lines.
BY_MORISON = ("morison_drag", "morison_inertia", "thesis_wave_force")
NEEDS_WATER = "needs water, but the scene has no [sea]; needed: [sea] with `depth`"
#: Depth below the seabed at which a point may be due to rounding [m].
BELOW_BED = 1e-9


@raises_first
def check_water(effect: str, scene: SceneData) -> Iterator[Check]:
    """Check that an effect of the water has a sea, a diameter, and fixed points above the seabed."""
    sea = scene.sea
    if sea is None:
        raise SceneError(f"effects.{effect}: {NEEDS_WATER}")
    if effect in BY_MORISON and displaced_diameter(scene.line, scene) is None:
        bare = next((i for i, line in enumerate(scene.lines) if line.diameter is None), 0)
        yield True, f"line.{bare}.diameter: missing; effects.{effect} needs it, > 0 m"
    if scene.effects.get("seabed", {}).get("bed_x") is not None:
        return  # a sloping seabed has a different depth everywhere, see `check_bed`
    lowest = -sea.depth
    for i, point in enumerate(scene.points):
        z = point.position[2]
        yield (
            not point.is_free and z < lowest - BELOW_BED,
            f"point.{i}.position: z = {z:g} m is below the seabed; allowed: >= {lowest:g} m",
        )


@raises_first
def check_growth(scene: SceneData) -> Iterator[Check]:
    """Check that growth has water and the diameter of the bare rope, and that the volume follows from the diameter."""
    for i, line in enumerate(scene.lines):
        season = scene.season is not None and scene.season.covers(line.name, line.piece_of)
        if line.growth is None and not season:
            continue
        path = f"line.{i}"
        source = f"{path}.growth"
        if season:
            source = "growth"
        yield (
            line.growth is not None and season,
            f"{path}.growth: given, but [growth] lists {line.name!r} too; allowed: one of them",
        )
        yield scene.sea is None, f"{source}: {NEEDS_WATER}"
        yield line.diameter is None, f"{path}.diameter: missing; {source} needs the diameter of the bare rope, > 0 m"
        yield (
            line.outer_diameter is not None,
            f"{path}.outer_diameter: {source} changes the diameter; allowed: one of them",
        )
        yield (
            line.centre_of_mass is not None,
            f"{source}: needs point masses at the nodes, but the line has compound links. Remove it",
        )
        yield (
            scene.effects.get("buoyancy", {}).get("wet_weight") is not None,
            f"effects.buoyancy.wet_weight: is that of the bare line, but {source} changes it. Remove it",
        )
