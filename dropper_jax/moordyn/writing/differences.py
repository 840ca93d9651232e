"""What a MoorDyn file cannot say of a scene, in words."""

from __future__ import annotations

from collections.abc import Iterator

from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.writing.pieces import detachment

#: Effects with a place in MoorDyn.
KNOWN = (
    *("weight", "buoyancy", "morison_drag", "morison_inertia"),
    *("seabed", "seabed_friction", "end_motion", "bending"),
)


def differences(scene: Scene) -> list[str]:
    """One line for each thing that a MoorDyn file of the scene leaves out or changes."""
    return [*_effects(scene), *_water(scene), *_things(scene)]


def _effects(scene: Scene) -> Iterator[str]:
    effects, wet = scene.effects, scene.sea is not None
    for name in effects:
        if name not in KNOWN:
            yield f"effects.{name}: not represented"
    if "end_motion" in effects:
        for name in (effects["end_motion"]["point"], *effects["end_motion"]["also"]):
            yield f"effects.end_motion: point {name!r} is Coupled; its motion is not in the file"
    if "weight" not in effects:
        yield "effects.weight: missing here, but MoorDyn's lines have weight"
    elif effects["weight"]["wet_weight"] is not None:
        yield "effects.weight.wet_weight: not represented; the weight is mass times gravity"
    if wet and "buoyancy" not in effects:
        yield "effects.buoyancy: missing here, but MoorDyn's lines have buoyancy"
    if effects.get("bending", {}).get("clamped"):
        yield "effects.bending.clamped: not represented; MoorDyn's lines are clamped on rods only"
    inertia = effects.get("morison_inertia")
    if wet and scene.sea.waves is not None and inertia is None:
        yield "effects.morison_inertia: missing here, but MoorDyn's lines feel the water's acceleration"
    if inertia is not None:
        if inertia["fluid_acceleration"] != "local":
            yield "effects.morison_inertia.fluid_acceleration: not represented; MoorDyn takes the local one"
        if inertia["added_mass"] != "morison":
            yield "effects.morison_inertia.added_mass: not represented; MoorDyn's does not keep energy"
    bed = effects.get("seabed")
    if bed is None:
        yield "effects.seabed: missing here, but MoorDyn has a bed at WtrDpth"
    elif wet and bed["depth"] is not None and bed["depth"] != scene.sea.depth:
        yield f"effects.seabed.depth: not represented; MoorDyn's bed is at the water's depth, {scene.sea.depth:g} m"


def _water(scene: Scene) -> Iterator[str]:
    sea = scene.sea
    if sea is None:
        return
    if scene.effects.get("weight", {}).get("gravity", sea.gravity) != sea.gravity:
        yield "sea.gravity: differs from effects.weight.gravity; MoorDyn has one, that of the weight"
    waves, current = sea.waves, sea.current
    if waves is not None:
        if waves.kind == "spectrum":
            yield "sea.waves: the spectrum is written as its components"
        if waves.theory != "linear":
            yield f"sea.waves.theory: {waves.theory!r} is not represented; a linear wave of this height is written"
        if sea.stretching != "wheeler":
            yield f"sea.stretching: {sea.stretching!r} is not represented; MoorDyn stretches as Wheeler"
        if sea.ramp is not None:
            yield "sea.ramp: MoorDyn's ramp is linear, ours is sin^2 of the same length"
        if sea.wave_current != "none":
            yield f"sea.wave_current: {sea.wave_current!r} is not represented; the components are those in still water"
        if sea.interpolation != "none":
            yield "sea.interpolation: not represented; components are summed"
    if current is not None:
        if current.kind != "table":
            yield f"sea.current: the {current.kind} profile is written as a table over height"
        if current.time is not None or current.amplitude is not None:
            key = "time" if current.time is not None else "amplitude"
            yield f"sea.current.{key}: not represented; the current is steady"
    if sea.level is not None:
        yield "sea.level: not represented; the water stays at its depth"


def _things(scene: Scene) -> Iterator[str]:
    for failure in scene.failures:
        if detachment(scene, failure) is None:
            which = "whichever link" if failure.link is None else f"link {failure.link}"
            yield (
                f"failure of line {failure.line!r}, {which}: not represented; MoorDyn takes lines off points, at the "
                "first or last link"
            )
    for line in scene.lines:
        if line.axial_law == "tabulated":
            yield f"line {line.name!r}: MoorDyn joins the rows of a table by straight lines and ends at the last one"
        elif line.axial_law not in ("rope", "damped_rope"):
            yield f"line {line.name!r}: axial law {line.axial_law!r} is not represented; MoorDyn's lines do not push"
        if scene.link_mass_nodes[line.name] == "far":
            yield f"line {line.name!r}: nodes 'far' is not represented; MoorDyn's links have halves at both nodes"
        if line.breaking_load is not None:
            yield f"line {line.name!r}: breaking load is not represented"
    bodies = {point.name: point.body for point in scene.points}
    for buoy in scene.buoys:
        if buoy.attachment:
            yield f"buoy {buoy.name!r}: attachment {buoy.attachment:g} m is not represented; lines hang on its base"
        if buoy.end_added_mass != "hemisphere":
            yield f"buoy {buoy.name!r}: end_added_mass {buoy.end_added_mass!r} is not represented; MoorDyn: hemisphere"
        if bodies[buoy.point]:
            yield f"point {buoy.point!r}: what it carries beside the buoy {buoy.name!r} is not represented"
    if scene.start.kind == "positions":
        yield "start.positions: not represented; MoorDyn finds the start"
