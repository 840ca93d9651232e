"""Ropes, chains, floats and crops by name and size: `library:chain-studless-0.03`; needs no JAX.

A name consists of a family and one number: the nominal diameter [m] of ropes and chains, the volume [m^3] of floats,
the age [months] of mussel socks, the biomass [kg/m] of kelp, the diameter [m] of lantern nets. Sizes d in m below.

    chain, studless   m = 19.9e3 d^2 kg/m, EA = 0.854e11 d^2 N, displaced diameter 1.80 d   Orcina, OrcaFlex help, Chain
    chain, studlink   m = 21.9e3 d^2 kg/m, EA = 1.010e11 d^2 N, displaced diameter 1.89 d   the same
    chain's breaking load  c d^2 (44 - 80 d), c = 13.7e6 (grade 2), 19.6e6 (3), 22.3e6 (R3), 27.4e6 N/m^2 (R4)
                      class rules, IACS W22 (R3, R4); makers' tables of all four agree to 1 %
    polyester, nylon, HMPE  m, breaking load (MBL), EA = 14, 5 and 56 MBL              MoorPy, MoorProps_default
    plaited ropes     m, EA, breaking load and displaced diameter by d^2                          OrcaFlex, Rope/wire

The paper's chain is `chain-studlink-0.022`: EA 48 884 kN, displaced diameter 0.042 m (its Tables 1 and 4).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import resources
from typing import Any

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table

PREFIX = "library:"
#: Density of foam and shell of a float over its volume [kg/m^3], and its coefficients as a sphere: drag on its frontal
#: area (subcritical: Hoerner 1965, Fluid-dynamic drag), added mass of a sphere (Lamb 1932, article 92).
FLOAT_DENSITY = 80.0
FLOAT_DRAG = 0.5
FLOAT_ADDED_MASS = 0.5
#: Damping ratio of a link (internal damping over critical): numerical, not a property of the part; as in packaged
#: scenes.
PART_DAMPING = 0.1
#: The paper's sock of fully grown mussels [kg/m], the density assumed in `edulis-longline` [kg/m^3], and the months to
#: full growth: the cycle with thinning-out of Galician ropes.
SOCK = 21.8
SOCK_DENSITY = 1300.0
SOCK_MONTHS = 15.0
#: Bare rope in a sock [kg/m] and [m] (assumed).
CORE_MASS = 0.1
CORE_DIAMETER = 0.012
#: Density of the sea water in `crop_values` [kg/m^3].
SEA_WATER = 1025.0


@dataclass(frozen=True)
class Family:
    """Parts of a kind.

    Attributes:
        section: section of the scene for it, `line_type` or `point`.
        size, unit: meaning of the number in its name.
        low, high: valid range of the size.
        example: an example size.
        source: sources of its numbers, and which of them are assumed.
        make: plain values for a size.
        spread: of a crop, how far its numbers scatter; empty for other parts.
        EI: of a crop, the bending stiffness [N m^2] at its example size, which a scene takes with [effects.bending].
    """

    section: str
    size: str
    unit: str
    low: float
    high: float
    example: float
    source: str
    make: Callable[[float], Table]
    spread: str = ""
    EI: float | None = None


def _chain(
    mass: float, stiffness: float, volume: float, across: float, along: float, strength: float, d: float
) -> Table:
    """Chain of bar diameter d; drag given over d (across) and d/pi (along) is converted to the displaced diameter."""
    return {
        "mass": mass * d**2,
        "diameter": volume * d,
        "EA": stiffness * d**2,
        "damping_ratio": PART_DAMPING,
        "breaking_load": strength * d**2 * (44.0 - 80.0 * d),
        "cdn": across / volume,
        "cdt": along / (math.pi * volume),
        "can": 1.0,
        "cat": 0.5,
    }


def _rope(mass: float, density: float, square: float, cube: float, stiffness: float, d: float) -> Table:
    """Fibre rope of diameter d: breaking load `square d^2 + cube d^3`, stiffness relative to it."""
    load = square * d**2 + cube * d**3
    return _rope_values(d, mass, math.sqrt(4.0 * mass / (math.pi * density)), stiffness * load, load)


def _rope_values(d: float, mass: float, volume: float, stiffness: float, load: float) -> Table:
    """Values of a rope of diameter d [m], mass by d^2 and displaced diameter over d; drag 1.6 over d
    (DNV-OS-E301)."""
    return {
        "mass": mass * d**2,
        "diameter": volume * d,
        "EA": stiffness,
        "damping_ratio": PART_DAMPING,
        "breaking_load": load,
        "cdn": 1.6 / volume,
        "cdt": 0.0,
        "can": 1.1,
        "cat": 0.15,
    }


def _plaited(mass: float, volume: float, stiffness: float, strength: float, d: float) -> Table:
    """Rope of eight strands of diameter d, all values proportional to d^2; drag as for the other ropes."""
    return _rope_values(d, mass, volume, stiffness * d**2, strength * d**2)


def float_of(volume: float, density: float = FLOAT_DENSITY) -> Table:
    """A spherical float [m^3] at a free point: mass, volume, drag coefficient times frontal area, added mass."""
    frontal = math.pi / 4 * (6 * volume / math.pi) ** (2 / 3)
    water = {"drag_area": FLOAT_DRAG * frontal, "added_mass": FLOAT_ADDED_MASS}
    return {"kind": "free", "mass": density * volume, "volume": volume, **water}


def _crop(density: float, drag: float, along: float, mass: float) -> Table:
    """A crop of a mass [kg/m] and density as it displaces water, on a rope with the stiffness of the Edulis sock."""
    return {
        "mass": mass,
        "diameter": math.sqrt(4.0 * mass / (math.pi * density)),
        "EA": 4e5,
        "damping_ratio": PART_DAMPING,
        "cdn": drag,
        "cdt": along,
        "can": 1.0,
        "cat": 0.0,
    }


def _sock(months: float) -> Table:
    share = months / SOCK_MONTHS
    mass = CORE_MASS + (SOCK - CORE_MASS) * share
    core = CORE_DIAMETER**2
    full = 4.0 * SOCK / (math.pi * SOCK_DENSITY)
    return {**_crop(1.0, 1.4, 0.02, mass), "diameter": math.sqrt(core + (full - core) * share)}


def _dropper(mass: float) -> Table:
    return {**_crop(SOCK_DENSITY, 1.3, 0.02, mass), "outer_diameter": 0.13 * math.sqrt(mass / 7.53)}


def _lantern(width: float) -> Table:
    net = _crop(1500.0, 0.0, 0.05, 10.0)
    return {**net, "cdn": 0.83 * width / net["diameter"]}


#: What makes the values of a part of a size, after the numbers of its family.
LAWS: dict[str, Callable[..., Table]] = {
    "chain": _chain,
    "rope": _rope,
    "plaited": _plaited,
    "float": float_of,
    "crop": _crop,
    "sock": _sock,
    "dropper": _dropper,
    "lantern": _lantern,
}


def _rows(file: str) -> Table:
    return tomllib.loads((resources.files("dropper_jax") / "data" / file).read_text(encoding="utf-8"))


def _family(law: str, numbers: list[float], **values: Any) -> Family:
    return Family(make=partial(LAWS[law], *numbers), **values)


FAMILIES = {name: _family(**row) for name, row in _rows("library.toml").items()}


def part(name: str) -> tuple[str, Table]:
    """Section of the scene and plain values of a part, from its name without `library:`.

    Raises:
        SceneError: an unknown family (with the nearest), no size, or a size outside the range of its source.
    """
    family, size = _split_name(name)
    kind = FAMILIES[family]
    if not kind.low <= size <= kind.high:
        allowed = f"{kind.low:g} to {kind.high:g} {kind.unit}"
        raise SceneError(f"library: {name!r}: {kind.size} {size:g} {kind.unit} is out of range; allowed: {allowed}")
    values: Table = {"name": PREFIX + name}
    for key, value in kind.make(size).items():
        if isinstance(value, float):
            value = float(f"{value:.6g}")
        values[key] = value
    return kind.section, values


def crop_values() -> list[Table]:
    """Numbers of each crop at its example size: name, mass per metre in air and in sea water of 1025 kg/m^3, displaced
    and outer diameter, drag and added mass coefficients across the outer one, bending stiffness (None: unknown), source
    and spread."""
    found = []
    for family, kind in FAMILIES.items():
        if not kind.spread:
            continue
        name = f"{family}-{kind.example:g}"
        values = part(name)[1]
        found.append(
            {
                "name": name,
                "mass_kg_per_m": values["mass"],
                "mass_in_water_kg_per_m": values["mass"] - SEA_WATER * 0.25 * math.pi * values["diameter"] ** 2,
                "diameter_m": values["diameter"],
                "outer_diameter_m": values.get("outer_diameter", values["diameter"]),
                "cdn": values["cdn"],
                "can": values["can"],
                "EI_n_m2": kind.EI,
                "source": kind.source,
                "spread": kind.spread,
            }
        )
    return found


def published_crops() -> list[Table]:
    """Published values of crops, rows of `data/crops.toml`; None for a number that is not at hand."""
    keys = ("crop", "like", "mass", "outer_diameter", "cdn", "can", "EI", "source", "read", "conditions")
    return [{**dict.fromkeys(keys), **row} for row in _rows("crops.toml")["crop"]]


def _split_name(name: str) -> tuple[str, float]:
    """Family and size of a name."""
    family, _, text = name.rpartition("-")
    if family not in FAMILIES:
        if kind := FAMILIES.get(name):
            needed = f"its {kind.size} [{kind.unit}], as {name}-{kind.example:g}"
            raise SceneError(f"library: {name!r} has no size; needed: {needed}")
        known = [f"{f}-{kind.example:g}" for f, kind in FAMILIES.items()]
        raise SceneError(f"library: {name!r} is unknown; {nearest(name, known)}")
    try:
        size = float(text)
    except ValueError:
        size = math.nan
    if not math.isfinite(size):
        kind = FAMILIES[family]
        raise SceneError(f"library: {name!r}: {text!r} is not a number; needed: {kind.size} [{kind.unit}]")
    return family, size
