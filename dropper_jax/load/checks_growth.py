"""What `[line.growth]` and `[growth]` need."""

from __future__ import annotations

from dropper_jax.base.errors import SceneError
from dropper_jax.scene import SceneData


def check_growth(scene: SceneData) -> None:
    """Growth needs water and the diameter of the bare rope, and the volume must follow from the diameter."""
    for i, line in enumerate(scene.lines):
        season = scene.season is not None and scene.season.on(line.name, line.piece_of)
        if line.growth is None and not season:
            continue
        path = f"line.{i}"
        if line.growth is not None and season:
            raise SceneError(f"{path}.growth: given, and [growth] names {line.name!r} too; allowed: one of them")
        said = "growth" if season else f"{path}.growth"
        if scene.sea is None:
            raise SceneError(f"{said}: needs water, but the scene has no [sea]; allowed: [sea] with `depth`")
        if line.diameter is None:
            raise SceneError(f"{path}.diameter: missing; {said} needs that of the bare rope, > 0 m")
        if line.centre_of_mass is not None:
            raise SceneError(f"{said}: is for point masses at the nodes, but the line has compound links; leave it out")
        if scene.effects.get("buoyancy", {}).get("wet_weight") is not None:
            raise SceneError(
                f"effects.buoyancy.wet_weight: is that of the bare line, but {said} changes it; leave it out"
            )
