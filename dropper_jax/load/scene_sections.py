"""All sections of a scene, each with its head in a file and the class that declares its keys."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from dropper_jax.effects import EFFECTS
from dropper_jax.integrators import OPTIONS
from dropper_jax.load.line_types import LineType
from dropper_jax.scene import (
    AnchorSpec,
    BodySpec,
    BuoySpec,
    CylinderSpec,
    FailureSpec,
    FitSpec,
    GrowthSpec,
    LineSpec,
    PointSpec,
    PriorSpec,
    RaoSpec,
    RunSpec,
    SeasonSpec,
    SensorSpec,
    SphereSpec,
    StartSpec,
    VesselSpec,
)
from dropper_jax.scene.length_in_time import LengthInTimeSpec, WinchSpec
from dropper_jax.sea.current_spec import CurrentSpec, LevelSpec
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.sea.wave_spec import WaveSpec

#: A section of a scene: its path with `*` for the number or name of an item, its head in TOML, the class that declares
#: its keys.
SectionRow = tuple[str, str, type | None]
#: Keys that are read by hand, by section.
KEYS_BY_HAND: dict[str, Iterable[str]] = {
    "": ("name", "description"),
    "run": OPTIONS,
    "line.*.axial": ("law", "EA", "damping", "strain", "tension"),
    "sea": ("packaged",),
}


def declared_sections(effects: Collection[str] | None = None) -> list[SectionRow]:
    """All sections of a scene in the order of a file, with those of these effects only, or with effects registered
    from outside."""
    named = [name for name in EFFECTS if effects is None or name in effects]
    return [
        ("", "", None),
        ("run", "[run]", RunSpec),
        ("point.*", "[[point]]", PointSpec),
        ("point_type.*", "[[point_type]]", PointSpec),
        ("line.*", "[[line]]", LineSpec),
        ("line.*.axial", "line.axial", None),
        ("line.*.growth", "line.growth", GrowthSpec),
        ("line.*.length_in_time.*", "[[line.length_in_time]]", LengthInTimeSpec),
        ("line.*.length_in_time.*.control", "line.length_in_time.control", WinchSpec),
        ("line_type.*", "[[line_type]]", LineType),
        ("buoy.*", "[[buoy]]", BuoySpec),
        ("body.*", "[[body]]", BodySpec),
        ("body.*.cylinders.*", "body.cylinders", CylinderSpec),
        ("body.*.spheres.*", "body.spheres", SphereSpec),
        ("vessel.*", "[[vessel]]", VesselSpec),
        ("vessel.*.rao", "vessel.rao", RaoSpec),
        *((f"effects.{name}", f"[effects.{name}]", EFFECTS[name]) for name in named),
        ("start", "[start]", StartSpec),
        ("growth", "[growth]", SeasonSpec),
        ("sea", "[sea]", SeaSpec),
        ("sea.waves", "[sea.waves]", WaveSpec),
        ("sea.current", "[sea.current]", CurrentSpec),
        ("sea.level", "[sea.level]", LevelSpec),
        ("failure.*", "[[failure]]", FailureSpec),
        ("anchor.*", "[[anchor]]", AnchorSpec),
        ("fit", "[fit]", FitSpec),
        ("fit.sensor.*", "[[fit.sensor]]", SensorSpec),
        ("fit.prior.*", "[[fit.prior]]", PriorSpec),
        ("parameters", "[parameters]", None),
        ("unit.*", "[unit.NAME]", None),
        ("array.*", "[[array]]", None),
    ]
