"""MoorDyn's options: their names, their other names, and what becomes of each in a scene."""

from __future__ import annotations

from dataclasses import dataclass, field

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import nearest
from dropper_jax.moordyn.reading.sections import Deck, Row

#: Other names of an option, in lower case.
OTHER_NAMES = {
    "dt": "dtm",
    "gravity": "g",
    "wtrdnsty": "rho",
    "rhow": "rho",
    "wtrdens": "rho",
    "wdens": "rho",
    "depth": "wtrdpth",
    "waterdepth": "wtrdpth",
    "water_depth": "wtrdpth",
    "kb": "kbot",
    "cb": "cbot",
    "ictmax": "tmaxic",
    "icdfac": "cdscaleic",
    "icthresh": "threshic",
    "cv": "fricdamp",
    "mc": "statdynfricscale",
    "fric_coeff": "frictioncoefficient",
}
#: Numbers that a scene has a place for, with MoorDyn's defaults.
NUMBERS = {
    "dtm": None,
    "g": GRAVITY,
    "rho": SEA_WATER,
    "wtrdpth": None,
    "kbot": 3.0e6,
    "cbot": 3.0e5,
    "tmaxic": 120.0,
    "wavekin": 0.0,
    "dtwave": 0.25,
    "wavekin_rampt": 0.0,
    "currents": 0.0,
    "frictioncoefficient": 0.0,
    "fricdamp": 200.0,
    "statdynfricscale": 1.0,
    "dtout": 0.0,
}
#: Options with text values that a scene has a place for.
TEXTS = ("seafloorfile",)
#: Known, but with no counterpart in a scene: how MoorDyn integrates, starts, prints and couples.
WITHOUT = (
    *("writelog", "cfl", "tscheme", "dtic", "cdscaleic", "threshic", "icgendynamic", "unifycurrentgrid", "writeunits"),
    *("disableoutput", "disableouttime", "inertialf", "inertialf_rampt"),
    *("outswitch", "echo", "fileic"),
)
#: Known, without a counterpart, and missed in the results: each is named by itself, and what is lacking without it.
MISSED = {
    "waterkin": "the water has no waves or current of that file",
    "mu_kt": "the bed has no friction across the lines (MoorDyn-F); effects.seabed_friction brings friction",
    "mu_ka": "the bed has no friction along the lines (MoorDyn-F); effects.seabed_friction brings friction",
}
#: Values with which such an option changes nothing.
NOTHING = ("0", "0.0", "none", "-", '""', "''")


@dataclass
class Options:
    """Options of a file.

    Attributes:
        values: numbers, MoorDyn's defaults where the file has none.
        texts: those with text values.
        lines: line of each option that the file gives.
        left: names of options that no scene has a place for.
        missed: a line for each of those that the results lack.
    """

    values: dict[str, float | None] = field(default_factory=lambda: dict(NUMBERS))
    texts: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)


def read_options(deck: Deck) -> Options:
    """The options section.

    Raises:
        SceneError: an option that MoorDyn does not have, or a value that is no number, with its line.
    """
    found = Options()
    for row in deck.rows.get("options", []):
        if len(row.words) < 2:
            deck.refuse(row.number, f"{' '.join(row.words)!r} is not an option; allowed: a value and a name")
        value, given = row.words[0], row.words[1]
        name = OTHER_NAMES.get(given.lower(), given.lower())
        found.lines[name] = row.number
        if name in WITHOUT:
            found.left.append(given)
        elif name in MISSED:
            if value.lower() not in NOTHING:
                found.missed.append(f"line {row.number}: {given} {value} is not represented: {MISSED[name]}")
        elif name in TEXTS:
            found.texts[name] = value
        elif name in NUMBERS:
            _number(deck, row, found, name)
        else:
            known = [*NUMBERS, *TEXTS, *WITHOUT, *MISSED, *OTHER_NAMES]
            deck.refuse(row.number, f"option {given!r} is unknown; {nearest(name, known)}")
    return found


def _number(deck: Deck, row: Row, found: Options, name: str) -> None:
    text = row.words[0]
    try:
        found.values[name] = float(text)
    except ValueError:
        if name == "wtrdpth":  # MoorDyn-F takes the path of a bathymetry file here
            found.texts["seafloorfile"] = text
            return
        deck.refuse(row.number, f"{row.words[1]}: {text!r} is not a number")
