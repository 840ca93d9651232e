"""Options of a MoorDyn file: their names, and their counterparts in a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import read_lines
from dropper_jax.decks.reading.sections import Deck, is_number


def read_seafloor(path: Path) -> dict[str, list[float]]:
    """`bed_x`, `bed_y`, `bed_depth` of `[effects.seabed]` from a file of MoorDyn-C: sizes, x, y, then x y depth."""
    lines = [line.split() for line in read_lines(path) if line.strip()]
    try:
        x = sorted(map(float, lines[1]))
        y = sorted(map(float, lines[2]))
        positions = {(float(a), float(b)): abs(float(z)) for a, b, z, *_ in lines[3:]}
        depths = [positions[a, b] for a in x for b in y]
    except (ValueError, IndexError):
        raise SceneError(
            f"{path}: is not a seafloor file; needed: sizes, all x, all y, then rows of x y depth"
        ) from None
    except KeyError as error:
        raise SceneError(f"{path}: has no depth at x, y = {error.args[0]}") from None
    return {"bed_x": x, "bed_y": y, "bed_depth": depths}


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
#: Numbers with a counterpart in a scene, with MoorDyn's defaults; a step or depth of 0 is not given.
NUMBERS = {
    "dtm": 0.0,
    "g": GRAVITY,
    "rho": SEA_WATER,
    "wtrdpth": 0.0,
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
    "writelog",
    "cfl",
    "tscheme",
    "dtic",
    "cdscaleic",
    "threshic",
    "icgendynamic",
    "unifycurrentgrid",
    "writeunits",
    "disableoutput",
    "disableouttime",
    "inertialf",
    "inertialf_rampt",
    "outswitch",
    "echo",
    "fileic",
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
    """

    values: dict[str, float] = field(default_factory=lambda: dict(NUMBERS))
    texts: dict[str, str] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)


def read_options(deck: Deck) -> Options:
    """The options section; those that affect the results and have no counterpart in a scene are added to the notes.

    Raises:
        SceneError: an option that MoorDyn does not have, or a value that is not a number, with its line.
    """
    found = Options()
    for row in deck.rows["options"]:
        if len(row.words) < 2:
            row.refuse(f"{' '.join(row.words)!r} is not an option; allowed: a value and a name")
        value, given = row.words[:2]
        name = OTHER_NAMES.get(given.lower(), given.lower())
        found.lines[name] = row.number
        if name in WITHOUT:
            found.left.append(given)
        elif name in MISSED:
            if value.lower() not in NOTHING:
                row.note(f"{given} {value} is not represented: {MISSED[name]}")
        elif name in TEXTS:
            found.texts[name] = value
        elif name not in NUMBERS:
            known = [*NUMBERS, *TEXTS, *WITHOUT, *MISSED, *OTHER_NAMES]
            row.refuse(f"option {given!r} is unknown; {nearest(name, known)}")
        elif is_number(value):
            found.values[name] = row.read(value, given)
        elif name == "wtrdpth":  # MoorDyn-F accepts the path of a bathymetry file here
            found.texts["seafloorfile"] = value
        else:
            row.refuse(f"{given}: {value!r} is not a number")
    return found
