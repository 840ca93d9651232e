"""Differences between a scene and a MoorDyn file of it, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dropper_jax.base.read import Values, declared_fields
from dropper_jax.base.records import names_of
from dropper_jax.decks.reading.points import wet_floats_note
from dropper_jax.decks.writing.stretches import detachment, stretches
from dropper_jax.effects import EFFECTS
from dropper_jax.load.scene import Scene
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
    return [*_effects(scene), *_water(scene), *_failures(scene), *_lines(scene), *_points(scene), *_others(scene)]


def _effects(scene: Scene) -> Iterator[str]:
    effects = scene.effects
    for name, values in effects.items():
        for point in _named_points(values, MOTIONS.get(name, ())):
            yield f"effects.{name}: point {point!r} is Coupled; its motion is not in the file"
        if name in WRITTEN_FIELDS:
            for key in _given_values(EFFECTS[name], values):
                if key not in WRITTEN_FIELDS[name]:
                    yield f"effects.{name}.{key}: not represented"
        elif name not in MOTIONS:
            yield f"effects.{name}: not represented"
    if "weight" not in effects:
        yield "effects.weight: missing here, but MoorDyn's lines have weight"
    elif effects["weight"]["wet_weight"] is not None:
        yield "effects.weight.wet_weight: not represented; the weight is mass times gravity"
    if scene.sea is not None and "buoyancy" not in effects:
        yield "effects.buoyancy: missing here, but MoorDyn's lines have buoyancy"
    if "bending" in effects and effects["bending"]["clamped"]:
        yield "effects.bending.clamped: not represented; MoorDyn's lines are clamped on rods only"
    if "morison_inertia" in effects:
        inertia = effects["morison_inertia"]
        if inertia["fluid_acceleration"] != "local":
            yield "effects.morison_inertia.fluid_acceleration: not represented; MoorDyn uses the local one"
        if inertia["added_mass"] != "morison":
            yield "effects.morison_inertia.added_mass: not represented; MoorDyn's does not conserve energy"
    elif scene.sea is not None and scene.sea.waves is not None:
        yield "effects.morison_inertia: missing here, but MoorDyn applies the water's acceleration to lines"
    if "seabed_friction" in effects:
        law = effects["seabed_friction"]["law"]
        if law != "moordyn":
            yield f"effects.seabed_friction.law: {law!r} is not represented; MoorDyn's friction creeps by FricDamp"
    if "seabed" not in effects:
        yield "effects.seabed: missing here, but MoorDyn has a seabed at WtrDpth"
    elif scene.sea is not None and effects["seabed"]["depth"] not in (None, scene.sea.depth):
        depth = scene.sea.depth
        yield f"effects.seabed.depth: not represented; MoorDyn's seabed is at the water depth, {depth:g} m"


def moved_points(scene: Scene) -> set[str]:
    """Names of the points moved by effects or vessels."""
    vessels = set(names_of(scene.vessels))
    found = {point.name for point in scene.points if point.carrier in vessels}
    for name in MOTIONS.keys() & scene.effects.keys():
        found |= set(_named_points(scene.effects[name], MOTIONS[name]))
    return found


def _named_points(values: Values, keys: Sequence[str]) -> list[str]:
    found = []
    for key in keys:
        names = values[key]
        if isinstance(names, str):
            names = [names]
        found += filter(None, names)
    return found


def _given_values(cls: type, values: Values) -> Iterator[str]:
    """Keys whose values differ from the defaults of the class."""
    for field in declared_fields(cls).values():
        value = values.get(field.name)
        if value is not None and not np.array_equal(value, field.default):
            yield field.name


def _water(scene: Scene) -> Iterator[str]:
    sea = scene.sea
    if sea is None:
        return
    if "weight" in scene.effects and scene.effects["weight"]["gravity"] != sea.gravity:
        yield "sea.gravity: differs from effects.weight.gravity; MoorDyn has one, and that of the weight is written"
    waves = sea.waves
    current = sea.current
    if waves is not None:
        if waves.kind == "spectrum":
            yield "sea.waves: the spectrum is written as its components"
        for name, value, same, instead in (
            ("waves.theory", waves.theory, "linear", "a linear wave of this height is written"),
            ("stretching", sea.stretching, "wheeler", "MoorDyn uses Wheeler stretching"),
            ("wave_current", sea.wave_current, "none", "the components are those in still water"),
            ("dispersion", sea.dispersion, "exact", "MoorDyn solves the dispersion relation"),
        ):
            if value != same:
                yield f"sea.{name}: {value!r} is not represented; {instead}"
        if sea.ramp is not None:
            yield "sea.ramp: MoorDyn's ramp is linear; here it is sin^2 of the same length"
        if sea.interpolation != "none":
            yield "sea.interpolation: not represented; components are summed"
    if current is not None:
        if current.kind != "table":
            yield f"sea.current: the {current.kind} profile is written as a table over height"
        for key in ("time", "amplitude"):
            if getattr(current, key) is not None:
                yield f"sea.current.{key}: not represented; the current is steady"
    if sea.level is not None:
        yield "sea.level: not represented; the water level is constant"


def _failures(scene: Scene) -> Iterator[str]:
    for failure in scene.failures:
        if detachment(stretches(scene), failure) is None:
            which = "most loaded link"
            if failure.link is not None:
                which = f"link {failure.link}"
            yield (
                f"failure of line {failure.line!r}, {which}: not represented; MoorDyn detaches lines from points, at "
                "the first or last link"
            )


def _lines(scene: Scene) -> Iterator[str]:
    nodes = scene.link_mass_nodes
    for line in scene.lines:
        of = f"line {line.name!r}"
        if line.axial_law == "damped_rope" and has_several_laws(scene):
            yield f"{of}: axial law 'damped_rope' is read again as 'rope', that of other lines; a file has one law"
        if line.axial_law == "tabulated":
            yield f"{of}: MoorDyn joins the rows of a table by straight lines and ends at the last one"
        if not line.goes_slack:
            yield f"{of}: axial law {line.axial_law!r} is not represented; MoorDyn's lines cannot push"
        if nodes[line.name] == "far":
            yield f"{of}: nodes 'far' is not represented; MoorDyn's links have half at each node"
        if line.breaking_load is not None:
            yield f"{of}: breaking load is not represented"
        if line.length_in_time:
            yield f"{of}: lengths that change in time are not represented"


def has_several_laws(scene: Scene) -> bool:
    """Whether some lines are ropes and others damped ropes, which only free text of a file can distinguish."""
    return {"rope", "damped_rope"} <= {line.axial_law for line in scene.lines}


def _points(scene: Scene) -> Iterator[str]:
    floats = [p.name for p in scene.points if scene.sea and scene.sea.density * (p.volume or 0.0) > (p.mass or 0.0)]
    if floats:
        yield wet_floats_note(floats)
    for vessel in scene.vessels:
        for name in vessel.attachments:
            yield f"vessel {vessel.name!r}: point {name!r} is Coupled; its motion is not in the file"
    for body in scene.bodies:
        yield from _body(body, "seabed" in scene.effects)
    for anchor in scene.anchors:
        yield f"anchor at {anchor.point!r}: its resistance is not represented; MoorDyn's fixed points hold any load"
    for buoy in scene.buoys:
        of = f"buoy {buoy.name!r}"
        if buoy.attachment != 0.0:
            yield f"{of}: attachment {buoy.attachment:g} m is not represented; lines end at its base"
        if buoy.end_added_mass != "hemisphere":
            yield f"{of}: end_added_mass {buoy.end_added_mass!r} is not represented; MoorDyn: hemisphere"
        if scene.point(buoy.point).has_body:
            yield f"point {buoy.point!r}: its own body, in addition to the {of}, is not represented"


def _body(body: BodySpec, bed: bool) -> Iterator[str]:
    of = f"body {body.name!r}"
    for i, cylinder in enumerate(body.cylinders):
        if cylinder.ends != "both":
            yield f"{of}: cylinder {i} has exposed ends {cylinder.ends!r}; MoorDyn exposes both"
    if body.spheres:
        yield f"{of}: its sphere can leave the water; in MoorDyn the volume of a body stays submerged"
    if np.any(body.velocity) or np.any(body.angular_velocity):
        yield f"{of}: velocities at the start are not represented"
    if body.bed_friction != 0.0:
        yield f"{of}: bed_friction is not represented"
    if bed and body.cylinders and not body.touches_bed:
        yield f"{of}: touches_bed = false is not represented; MoorDyn's rods touch the seabed"
    if bed and body.spheres and body.touches_bed:
        yield f"{of}: in MoorDyn the volume of a body does not touch the seabed"


def _others(scene: Scene) -> Iterator[str]:
    if scene.season is not None and scene.season.attachment is not None:
        yield "growth.attachment: not represented; mussels are part of the links and do not detach"
    if scene.fit is not None:
        yield "fit: not represented; it is for fits to measured traces"
