"""MoorDyn's options: their names, their aliases, and their counterparts in a scene."""

from __future__ import annotations

from dataclasses import dataclass, field

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import nearest
from dropper_jax.moordyn.reading.sections import Deck, Row

#: Aliases of an option, in lower case.
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
#: Numbers with a counterpart in a scene, with MoorDyn's defaults.
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
#: Options with text values that have a counterpart in a scene.
TEXTS = ("seafloorfile",)
#: Known, but without a counterpart in a scene: how MoorDyn integrates, starts, prints and couples.
WITHOUT = (
    *("writelog", "cfl", "tscheme", "dtic", "cdscaleic", "threshic", "icgendynamic", "unifycurrentgrid", "writeunits"),
    *("disableoutput", "disableouttime", "inertialf", "inertialf_rampt"),
    *("outswitch", "echo", "fileic"),
)
#: Known, without a counterpart, and relevant to the results: each is reported separately, with what is missing without
#: it.
MISSED = {
    "waterkin": "the water has no waves or current of that file",
    "mu_kt": "the bed has no friction across the lines (MoorDyn-F); effects.seabed_friction adds friction",
    "mu_ka": "the bed has no friction along the lines (MoorDyn-F); effects.seabed_friction adds friction",
}
#: Values with which such an option has no effect.
NOTHING = ("0", "0.0", "none", "-", '""', "''")


@dataclass
class Options:
    """Options of a file.

    Attributes:
        values: numbers, MoorDyn's defaults if the file does not give them.
        texts: those with text values.
        lines: line number of each option that the file gives.
        left: names of options without a counterpart in a scene.
        missed: one line for each of those that affect the results.
    """

    values: dict[str, float | None] = field(default_factory=lambda: dict(NUMBERS))
    texts: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)


def read_options(deck: Deck) -> Options:
    """The options section.

    Raises:
        SceneError: an option that MoorDyn does not have, or a value that is not a number, with its line.
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
        if name == "wtrdpth":  # MoorDyn-F accepts the path of a bathymetry file here
            found.texts["seafloorfile"] = text
            return
        deck.refuse(row.number, f"{row.words[1]}: {text!r} is not a number")
