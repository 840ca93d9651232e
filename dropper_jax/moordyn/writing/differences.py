"""Differences between a scene and a MoorDyn file of it, in words."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
from dropper_jax.moordyn.writing.pieces import detachment
from dropper_jax.scene import BodySpec

#: Values of effects that a file represents, or that have their own sentence below; any other given value is listed.
WRITTEN_FIELDS: dict[str, tuple[str, ...]] = {
    "weight": ("gravity", "wet_weight"),
    "buoyancy": (),
    "morison_drag": ("cdn", "cdt", "tangents"),  # how directions enter a step is not a matter of physics
    "morison_inertia": ("can", "cat", "fluid_acceleration", "added_mass"),
    "seabed": ("stiffness", "damping", "depth", "bed_x", "bed_y", "bed_depth"),
    "seabed_friction": ("kinetic", "static", "damping", "law"),
    "end_motion": ("amplitude", "period", "phase", "ramp", "time", "displacement", "point", "also"),
    "bending": ("EI", "directions", "clamped"),
}
#: Effects that move points, which a file can only mark as coupled, and the keys of the points' names.
MOTIONS = {"end_motion": ("point", "also"), "sea_following_end": ("point", "also"), "recorded_motion": ("points",)}


def differences(scene: Scene) -> list[str]:
    """One line for each feature of the scene that a MoorDyn file omits or changes."""
    return [*_effects(scene), *_water(scene), *_things(scene)]


def _effects(scene: Scene) -> Iterator[str]:
    effects, wet = scene.effects, scene.sea is not None
    for name in effects:
        if name in MOTIONS:
            for point in _named_points(effects[name], MOTIONS[name]):
                yield f"effects.{name}: point {point!r} is Coupled; its motion is not in the file"
        elif name not in WRITTEN_FIELDS:
            yield f"effects.{name}: not represented"
        for key in _given_values(EFFECTS[name], effects[name]):
            if key not in WRITTEN_FIELDS.get(name, (key,)):
                yield f"effects.{name}.{key}: not represented"
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
        yield "effects.morison_inertia: missing here, but MoorDyn applies the water's acceleration to lines"
    if inertia is not None:
        if inertia["fluid_acceleration"] != "local":
            yield "effects.morison_inertia.fluid_acceleration: not represented; MoorDyn uses the local one"
        if inertia["added_mass"] != "morison":
            yield "effects.morison_inertia.added_mass: not represented; MoorDyn's does not conserve energy"
    law = effects.get("seabed_friction", {"law": "moordyn"})["law"]
    if law != "moordyn":
        yield f"effects.seabed_friction.law: {law!r} is not represented; MoorDyn's friction creeps by FricDamp"
    bed = effects.get("seabed")
    if bed is None:
        yield "effects.seabed: missing here, but MoorDyn has a seabed at WtrDpth"
    elif wet and bed["depth"] is not None and bed["depth"] != scene.sea.depth:
        yield f"effects.seabed.depth: not represented; MoorDyn's seabed is at the water depth, {scene.sea.depth:g} m"


def moved_points(scene: Scene) -> set[str]:
    """Names of the points moved by effects or vessels."""
    vessels = {vessel.name for vessel in scene.vessels}
    found = {point.name for point in scene.points if point.on in vessels}
    for name in MOTIONS.keys() & scene.effects.keys():
        found |= set(_named_points(scene.effects[name], MOTIONS[name]))
    return found


def _named_points(values: Mapping[str, Any], keys: Sequence[str]) -> list[str]:
    words = [[values[key]] if isinstance(values[key], str) else values[key] for key in keys]
    return [name for names in words for name in names if name]


def _given_values(cls: type, values: Mapping[str, Any]) -> Iterator[str]:
    """Keys whose values differ from the defaults of the class."""
    for field in dataclasses.fields(cls):
        value = values.get(field.name)
        if field.name in values and value is not None and not np.array_equal(value, field.default):
            yield field.name


def _water(scene: Scene) -> Iterator[str]:
    sea = scene.sea
    if sea is None:
        return
    if scene.effects.get("weight", {}).get("gravity", sea.gravity) != sea.gravity:
        yield "sea.gravity: differs from effects.weight.gravity; MoorDyn has one, and that of the weight is written"
    waves, current = sea.waves, sea.current
    if waves is not None:
        if waves.kind == "spectrum":
            yield "sea.waves: the spectrum is written as its components"
        if waves.theory != "linear":
            yield f"sea.waves.theory: {waves.theory!r} is not represented; a linear wave of this height is written"
        if sea.stretching != "wheeler":
            yield f"sea.stretching: {sea.stretching!r} is not represented; MoorDyn uses Wheeler stretching"
        if sea.ramp is not None:
            yield "sea.ramp: MoorDyn's ramp is linear; here it is sin^2 of the same length"
        if sea.wave_current != "none":
            yield f"sea.wave_current: {sea.wave_current!r} is not represented; the components are those in still water"
        if sea.dispersion != "exact":
            yield f"sea.dispersion: {sea.dispersion!r} is not represented; MoorDyn solves the dispersion relation"
        if sea.interpolation != "none":
            yield "sea.interpolation: not represented; components are summed"
    if current is not None:
        if current.kind != "table":
            yield f"sea.current: the {current.kind} profile is written as a table over height"
        if current.time is not None or current.amplitude is not None:
            key = "time" if current.time is not None else "amplitude"
            yield f"sea.current.{key}: not represented; the current is steady"
    if sea.level is not None:
        yield "sea.level: not represented; the water level is constant"


def _things(scene: Scene) -> Iterator[str]:
    for failure in scene.failures:
        if detachment(scene, failure) is None:
            which = "most loaded link" if failure.link is None else f"link {failure.link}"
            yield (
                f"failure of line {failure.line!r}, {which}: not represented; MoorDyn detaches lines from points, at "
                "the first or last link"
            )
    for line in scene.lines:
        if line.axial_law == "tabulated":
            yield f"line {line.name!r}: MoorDyn joins the rows of a table by straight lines and ends at the last one"
        elif line.axial_law not in ("rope", "damped_rope"):
            yield f"line {line.name!r}: axial law {line.axial_law!r} is not represented; MoorDyn's lines cannot push"
        if scene.link_mass_nodes[line.name] == "far":
            yield f"line {line.name!r}: nodes 'far' is not represented; MoorDyn's links have half at each node"
        if line.breaking_load is not None:
            yield f"line {line.name!r}: breaking load is not represented"
    floats = [p.name for p in scene.points if scene.sea and scene.sea.density * (p.volume or 0.0) > (p.mass or 0.0)]
    if floats:
        names = ", ".join(map(repr, floats[:3])) + (f" and {len(floats) - 3} more" if len(floats) > 3 else "")
        yield f"points that float ({names}): MoorDyn treats their full volume as submerged, also above the surface"
    for vessel in scene.vessels:
        for name in vessel.attachments:
            yield f"vessel {vessel.name!r}: point {name!r} is Coupled; its motion is not in the file"
    for body in scene.bodies:
        yield from _body(body, scene.effects.get("seabed") is not None)
    for anchor in scene.anchors:
        yield f"anchor at {anchor.point!r}: its resistance is not represented; MoorDyn's fixed points hold any load"
    bodies = {point.name: point.body for point in scene.points}
    for buoy in scene.buoys:
        if buoy.attachment:
            yield f"buoy {buoy.name!r}: attachment {buoy.attachment:g} m is not represented; lines end at its base"
        if buoy.end_added_mass != "hemisphere":
            yield f"buoy {buoy.name!r}: end_added_mass {buoy.end_added_mass!r} is not represented; MoorDyn: hemisphere"
        if bodies[buoy.point]:
            yield f"point {buoy.point!r}: its own body, in addition to the buoy {buoy.name!r}, is not represented"
    if scene.season is not None and scene.season.attachment is not None:
        yield "growth.attachment: not represented; mussels are part of the links and do not detach"
    if scene.fit is not None:
        yield "fit: not represented; it is for fits to measured traces"


def _body(body: BodySpec, bed: bool) -> Iterator[str]:
    for i, cylinder in enumerate(body.cylinders):
        if cylinder.ends != "both":
            yield f"body {body.name!r}: cylinder {i} has exposed ends {cylinder.ends!r}; MoorDyn exposes both"
    if body.spheres:
        yield f"body {body.name!r}: its sphere can leave the water; in MoorDyn the volume of a body stays submerged"
    if np.any(body.velocity) or np.any(body.angular_velocity):
        yield f"body {body.name!r}: velocities at the start are not represented"
    if body.bed_friction:
        yield f"body {body.name!r}: bed_friction is not represented"
    if bed and body.cylinders and not body.touches_bed:
        yield f"body {body.name!r}: touches_bed = false is not represented; MoorDyn's rods touch the seabed"
    if bed and body.spheres and body.touches_bed:
        yield f"body {body.name!r}: in MoorDyn the volume of a body does not touch the seabed"
