"""Differences between a scene and a MoorDyn file of it, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dropper_jax.base.read import Values, declared_fields
from dropper_jax.decks.reading.points import wet_floats_note
from dropper_jax.decks.writing.pieces import detachment
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


#: Whether a scene has a feature, and the line that reports it.
Difference = tuple[bool, str]


def differences(scene: Scene) -> list[str]:
    """One line for each feature of the scene that a MoorDyn file omits or changes."""
    return [text for differs, text in (*_effects(scene), *_water(scene), *_things(scene)) if differs]


def _effects(scene: Scene) -> Iterator[Difference]:
    effects = scene.effects
    wet = scene.sea is not None
    for name, values in effects.items():
        for point in _named_points(values, MOTIONS.get(name, ())):
            yield True, f"effects.{name}: point {point!r} is Coupled; its motion is not in the file"
        yield name not in {*MOTIONS, *WRITTEN_FIELDS}, f"effects.{name}: not represented"
        for key in _given_values(EFFECTS[name], values):
            yield key not in WRITTEN_FIELDS.get(name, (key,)), f"effects.{name}.{key}: not represented"
    yield "weight" not in effects, "effects.weight: missing here, but MoorDyn's lines have weight"
    yield (
        effects.get("weight", {}).get("wet_weight") is not None,
        "effects.weight.wet_weight: not represented; the weight is mass times gravity",
    )
    yield wet and "buoyancy" not in effects, "effects.buoyancy: missing here, but MoorDyn's lines have buoyancy"
    yield (
        bool(effects.get("bending", {}).get("clamped")),
        "effects.bending.clamped: not represented; MoorDyn's lines are clamped on rods only",
    )
    inertia = effects.get("morison_inertia")
    yield (
        wet and scene.sea.waves is not None and inertia is None,
        "effects.morison_inertia: missing here, but MoorDyn applies the water's acceleration to lines",
    )
    if inertia is not None:
        yield (
            inertia["fluid_acceleration"] != "local",
            "effects.morison_inertia.fluid_acceleration: not represented; MoorDyn uses the local one",
        )
        yield (
            inertia["added_mass"] != "morison",
            "effects.morison_inertia.added_mass: not represented; MoorDyn's does not conserve energy",
        )
    law = effects.get("seabed_friction", {"law": "moordyn"})["law"]
    yield (
        law != "moordyn",
        f"effects.seabed_friction.law: {law!r} is not represented; MoorDyn's friction creeps by FricDamp",
    )
    yield "seabed" not in effects, "effects.seabed: missing here, but MoorDyn has a seabed at WtrDpth"
    if wet:
        depth = scene.sea.depth
        yield (
            effects.get("seabed", {}).get("depth") not in (None, depth),
            f"effects.seabed.depth: not represented; MoorDyn's seabed is at the water depth, {depth:g} m",
        )


def moved_points(scene: Scene) -> set[str]:
    """Names of the points moved by effects or vessels."""
    vessels = {vessel.name for vessel in scene.vessels}
    found = {point.name for point in scene.points if point.on in vessels}
    for name in MOTIONS.keys() & scene.effects.keys():
        found |= set(_named_points(scene.effects[name], MOTIONS[name]))
    return found


def _named_points(values: Values, keys: Sequence[str]) -> list[str]:
    words = [[values[key]] if isinstance(values[key], str) else values[key] for key in keys]
    return [name for names in words for name in names if name]


def _given_values(cls: type, values: Values) -> Iterator[str]:
    """Keys whose values differ from the defaults of the class."""
    for field in declared_fields(cls).values():
        value = values.get(field.name)
        if field.name in values and value is not None and not np.array_equal(value, field.default):
            yield field.name


def _water(scene: Scene) -> Iterator[Difference]:
    sea = scene.sea
    if sea is None:
        return
    yield (
        scene.effects.get("weight", {}).get("gravity", sea.gravity) != sea.gravity,
        "sea.gravity: differs from effects.weight.gravity; MoorDyn has one, and that of the weight is written",
    )
    waves = sea.waves
    current = sea.current
    if waves is not None:
        yield waves.kind == "spectrum", "sea.waves: the spectrum is written as its components"
        for name, value, same, instead in (
            ("waves.theory", waves.theory, "linear", "a linear wave of this height is written"),
            ("stretching", sea.stretching, "wheeler", "MoorDyn uses Wheeler stretching"),
            ("wave_current", sea.wave_current, "none", "the components are those in still water"),
            ("dispersion", sea.dispersion, "exact", "MoorDyn solves the dispersion relation"),
        ):
            yield value != same, f"sea.{name}: {value!r} is not represented; {instead}"
        yield sea.ramp is not None, "sea.ramp: MoorDyn's ramp is linear; here it is sin^2 of the same length"
        yield sea.interpolation != "none", "sea.interpolation: not represented; components are summed"
    if current is not None:
        yield current.kind != "table", f"sea.current: the {current.kind} profile is written as a table over height"
        for key in ("time", "amplitude"):
            yield getattr(current, key) is not None, f"sea.current.{key}: not represented; the current is steady"
    yield sea.level is not None, "sea.level: not represented; the water level is constant"


def _things(scene: Scene) -> Iterator[Difference]:
    for failure in scene.failures:
        if failure.link is None:
            which = "most loaded link"
        else:
            which = f"link {failure.link}"
        yield (
            detachment(scene, failure) is None,
            f"failure of line {failure.line!r}, {which}: not represented; MoorDyn detaches lines from points, at the "
            "first or last link",
        )
    nodes = scene.link_mass_nodes
    for line in scene.lines:
        of = f"line {line.name!r}"
        yield (
            line.axial_law == "tabulated",
            f"{of}: MoorDyn joins the rows of a table by straight lines and ends at the last one",
        )
        yield (
            not line.goes_slack,
            f"{of}: axial law {line.axial_law!r} is not represented; MoorDyn's lines cannot push",
        )
        yield (
            nodes[line.name] == "far",
            f"{of}: nodes 'far' is not represented; MoorDyn's links have half at each node",
        )
        yield line.breaking_load is not None, f"{of}: breaking load is not represented"
        yield bool(line.length_in_time), f"{of}: lengths that change in time are not represented"
    floats = [p.name for p in scene.points if scene.sea and scene.sea.density * (p.volume or 0.0) > (p.mass or 0.0)]
    yield bool(floats), wet_floats_note(floats)
    for vessel in scene.vessels:
        for name in vessel.attachments:
            yield True, f"vessel {vessel.name!r}: point {name!r} is Coupled; its motion is not in the file"
    for body in scene.bodies:
        yield from _body(body, "seabed" in scene.effects)
    for anchor in scene.anchors:
        yield (
            True,
            f"anchor at {anchor.point!r}: its resistance is not represented; MoorDyn's fixed points hold any load",
        )
    bodies = {point.name: point.body for point in scene.points}
    for buoy in scene.buoys:
        of = f"buoy {buoy.name!r}"
        yield (
            buoy.attachment != 0.0,
            f"{of}: attachment {buoy.attachment:g} m is not represented; lines end at its base",
        )
        yield (
            buoy.end_added_mass != "hemisphere",
            f"{of}: end_added_mass {buoy.end_added_mass!r} is not represented; MoorDyn: hemisphere",
        )
        yield bodies[buoy.point], f"point {buoy.point!r}: its own body, in addition to the {of}, is not represented"
    yield (
        scene.season is not None and scene.season.attachment is not None,
        "growth.attachment: not represented; mussels are part of the links and do not detach",
    )
    yield scene.fit is not None, "fit: not represented; it is for fits to measured traces"


def _body(body: BodySpec, bed: bool) -> Iterator[Difference]:
    of = f"body {body.name!r}"
    for i, cylinder in enumerate(body.cylinders):
        yield cylinder.ends != "both", f"{of}: cylinder {i} has exposed ends {cylinder.ends!r}; MoorDyn exposes both"
    yield bool(body.spheres), f"{of}: its sphere can leave the water; in MoorDyn the volume of a body stays submerged"
    yield (
        bool(np.any(body.velocity) or np.any(body.angular_velocity)),
        f"{of}: velocities at the start are not represented",
    )
    yield body.bed_friction != 0.0, f"{of}: bed_friction is not represented"
    yield (
        bed and bool(body.cylinders) and not body.touches_bed,
        f"{of}: touches_bed = false is not represented; MoorDyn's rods touch the seabed",
    )
    yield (
        bed and bool(body.spheres) and body.touches_bed,
        f"{of}: in MoorDyn the volume of a body does not touch the seabed",
    )
