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

from dropper_jax.base.constants import SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import Table

#: Start of the name of a part in a scene.
PREFIX = "library:"
#: Density of foam and shell of a float over its volume [kg/m^3], and its coefficients as a sphere: drag on its frontal
#: area (subcritical: Hoerner 1965, Fluid-dynamic drag), added mass of a sphere (Lamb 1932, article 92).
FLOAT_DENSITY = 80.0
FLOAT_DRAG = 0.5
FLOAT_ADDED_MASS = 0.5
#: Damping ratio of a link (internal damping over critical): numerical, not a property of the part; as in packaged
#: scenes.
PART_DAMPING = 0.1
#: Drag coefficient of ropes across them, on the diameter d (DNV-OS-E301).
ROPE_DRAG = 1.6
#: The paper's sock of fully grown mussels [kg/m], the density assumed in `edulis-longline` [kg/m^3], and the months to
#: full growth: the cycle with thinning-out of Galician ropes.
SOCK_MASS = 21.8
SOCK_DENSITY = 1300.0
SOCK_MONTHS = 15.0
#: Drag coefficient of the sock across it: that of `edulis-longline` (assumed).
SOCK_DRAG = 1.4
#: Bare rope in a sock [kg/m] and [m] (assumed).
CORE_MASS = 0.1
CORE_DIAMETER = 0.012
#: Half-grown dropper on a collector rope: outer diameter [m] at a mass [kg/m] (Knysh et al. 2020), drag coefficient on
#: the outer diameter (assumed by Zhu et al. 2020).
COLLECTOR_DIAMETER = 0.13
COLLECTOR_MASS = 7.53
COLLECTOR_DRAG = 1.3
#: Drag coefficient of mussels along the rope (assumed).
MUSSEL_DRAG_ALONG = 0.02
#: Lantern net: mass with its scallops [kg/m] and their density [kg/m^3] (assumed), drag coefficient on the net's
#: diameter (Fishes 2023, 8(4), 204), and along the net (assumed).
NET_MASS = 10.0
NET_DENSITY = 1500.0
NET_DRAG = 0.83
NET_DRAG_ALONG = 0.05
#: Axial stiffness of the rope that carries a crop [N]: that of the sock in `edulis-longline` (assumed).
CROP_STIFFNESS = 4e5


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
    mass: float, stiffness: float, displaced: float, across: float, along: float, strength: float, d: float
) -> Table:
    """Chain of bar diameter d [m], with the displaced diameter over d.

    Drag given over d (across) and d/pi (along) is converted to the displaced diameter.
    """
    return {
        "mass": mass * d**2,
        "diameter": displaced * d,
        "EA": stiffness * d**2,
        "damping_ratio": PART_DAMPING,
        "breaking_load": strength * d**2 * (44.0 - 80.0 * d),
        "cdn": across / displaced,
        "cdt": along / (math.pi * displaced),
        "can": 1.0,
        "cat": 0.5,
    }


def _rope(mass: float, density: float, square: float, cube: float, stiffness: float, d: float) -> Table:
    """Fibre rope of diameter d [m]: breaking load `square d^2 + cube d^3` [N], stiffness relative to it."""
    load = square * d**2 + cube * d**3
    return _rope_values(d, mass, _displaced_diameter(mass, density), stiffness * load, load)


def _rope_values(d: float, mass: float, displaced: float, stiffness: float, load: float) -> Table:
    """Values of a rope of diameter d [m]: mass over d^2, displaced diameter over d, EA and breaking load [N]."""
    return {
        "mass": mass * d**2,
        "diameter": displaced * d,
        "EA": stiffness,
        "damping_ratio": PART_DAMPING,
        "breaking_load": load,
        "cdn": ROPE_DRAG / displaced,
        "cdt": 0.0,
        "can": 1.1,
        "cat": 0.15,
    }


def _plaited(mass: float, displaced: float, stiffness: float, strength: float, d: float) -> Table:
    """Rope of eight strands of diameter d [m], all values proportional to d^2; drag as for the other ropes."""
    return _rope_values(d, mass, displaced, stiffness * d**2, strength * d**2)


def float_of(volume: float, density: float = FLOAT_DENSITY) -> Table:
    """A spherical float [m^3] at a free point: mass, volume, drag coefficient times frontal area, added mass."""
    frontal = math.pi / 4 * (6 * volume / math.pi) ** (2 / 3)
    water = {"drag_area": FLOAT_DRAG * frontal, "added_mass": FLOAT_ADDED_MASS}
    return {"kind": "free", "mass": density * volume, "volume": volume, **water}


def _displaced_diameter(mass: float, density: float) -> float:
    """Diameter of a cylinder of a mass per length and a density; over d if the mass is given over d^2."""
    return math.sqrt(4.0 * mass / (math.pi * density))


def _crop_values(mass: float, diameter: float, drag: float, along: float) -> Table:
    """Values of a crop of a mass [kg/m] and displaced diameter [m] on its rope, drag across and along it."""
    return {
        "mass": mass,
        "diameter": diameter,
        "EA": CROP_STIFFNESS,
        "damping_ratio": PART_DAMPING,
        "cdn": drag,
        "cdt": along,
        "can": 1.0,
        "cat": 0.0,
    }


def _crop(density: float, drag: float, along: float, mass: float) -> Table:
    """A crop of a mass [kg/m], which displaces water by its density."""
    return _crop_values(mass, _displaced_diameter(mass, density), drag, along)


def _sock(months: float) -> Table:
    """A mussel sock of this age: mass and cross-section grow linearly from those of the bare rope."""
    share = months / SOCK_MONTHS
    mass = CORE_MASS + (SOCK_MASS - CORE_MASS) * share
    core = CORE_DIAMETER**2
    full = 4.0 * SOCK_MASS / (math.pi * SOCK_DENSITY)
    return _crop_values(mass, math.sqrt(core + (full - core) * share), SOCK_DRAG, MUSSEL_DRAG_ALONG)


def _dropper(mass: float) -> Table:
    """A mussel dropper of a mass [kg/m], whose outer cross-section is proportional to it."""
    outer = COLLECTOR_DIAMETER * math.sqrt(mass / COLLECTOR_MASS)
    return {**_crop(SOCK_DENSITY, COLLECTOR_DRAG, MUSSEL_DRAG_ALONG, mass), "outer_diameter": outer}


def _lantern(width: float) -> Table:
    """A lantern net of this diameter [m]; its drag coefficient is converted to the displaced diameter."""
    diameter = _displaced_diameter(NET_MASS, NET_DENSITY)
    return _crop_values(NET_MASS, diameter, NET_DRAG * width / diameter, NET_DRAG_ALONG)


#: Functions that make the values of a part, by the `law` of its family: of the family's numbers, then of a size.
MAKERS: dict[str, Callable[..., Table]] = {
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
    return Family(make=partial(MAKERS[law], *numbers), **values)


#: Families of parts by name.
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
    rows = []
    for family, kind in FAMILIES.items():
        if not kind.spread:
            continue
        name = f"{family}-{kind.example:g}"
        values = part(name)[1]
        rows.append(
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
    return rows


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
