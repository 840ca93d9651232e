"""MoorDyn's options and line types: their names, and their counterparts in a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dropper_jax.axial.force_table import ForceTable
from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.files import read_lines
from dropper_jax.base.read import Table
from dropper_jax.base.references import find_referenced
from dropper_jax.decks.reading.sections import Deck, Row, is_number

#: Coefficients in the columns after BA in version 1, and after EI in version 2.
COEFFICIENTS_1 = ("can", "cat", "cdn", "cdt")
COEFFICIENTS_2 = ("cdn", "can", "cdt", "cat")


def read_types(deck: Deck) -> dict[str, Table]:
    """Line types by name, each with its line of the file under `row`.

    Version 1 has nine columns, version 2 ten or more, with EI in the sixth.
    """
    found: dict[str, Table] = {}
    for row in deck.require("line types"):
        row.need(9, "line type")
        name = row.words[0]
        if name in found:
            row.refuse(f"line type {name!r} is given twice")
        kind: Table = {
            "name": name,
            "row": row.number,
            "diameter": row.value(1, "Diam", above=0.0),
            "mass": row.value(2, "Mass/m", above=0.0),
            **_stiffness(row),
            **_damping(row),
        }
        second = _is_second_version(row)
        columns = enumerate(COEFFICIENTS_1, start=5)
        if second:
            columns = enumerate(COEFFICIENTS_2, start=6)
        for i, key in columns:
            kind[key] = row.value(i, key, 0.0)
        if second:
            kind |= _bending(row)
        if len(row.words) > 10 and row.value(10, "Cl", 0.0) > 0.0:
            row.note(f"Cl of {name!r} is not represented: no vortex-induced forces")
        found[name] = kind
    return found


def _is_second_version(row: Row) -> bool:
    """Whether a row has EI and the order of version 2, by the column names; without these by their number."""
    names = {*row.deck.columns("line types")}
    if "ei" in names:
        row.need(10, "line type")
        return True
    if names & {"cdax", "caax"}:
        at = row.deck.first["line types"] + 1
        row.deck.refuse(at, "LINE TYPES: columns CdAx CaAx without EI; needed: EI before Cd")
    if names & {"can", "cat", "cdt"} and len(row.words) > 9:
        row.refuse(f"line type: has {len(row.words)} values under a header of version 1; allowed: 9")
    return len(row.words) >= 10


def _bending(row: Row) -> dict[str, float]:
    """`EI` [N m^2] if there is any; a table of moments is ignored, with a note."""
    text = row.words[5]
    if not is_number(text):
        row.note(f"EI {text} of {row.words[0]!r} is not represented: lines bend freely")
        return {}
    value = row.read(text, "EI", 0.0)
    if value:
        return {"EI": value}
    return {}


def _stiffness(row: Row) -> Table:
    """`EA` [N], or the table of a file; for a viscoelastic rope its static part, with a note."""
    text = row.words[3]
    if "|" in text:
        static = text.split("|")[0]
        row.note(f"EA {text} is not represented: the static part {static} is used")
        if static.upper().startswith("SYROPE:"):
            row.refuse("EA: working curves (SYROPE) are not represented; allowed: a number or a table")
        text = static
    if not is_number(text):
        return {"law": "tabulated", **_table(row, text)}
    return {"EA": row.read(text, "EA", above=0.0)}


def _table(row: Row, text: str) -> dict[str, list[float]]:
    """Strain and tension [N] of a file with three header lines; `force_table` interpolates its rows smoothly."""
    file = find_referenced(text, f"{row.deck.path.name}:{row.number}: EA", row.deck.path.parent)
    try:
        lines = file.read_text(encoding="utf-8").splitlines()[3:]
        table = np.array([line.split()[:2] for line in lines if line.strip()], float)
        strain, tension = table.T.tolist()
    except OSError as error:
        row.refuse(f"EA: {text!r} is neither a number nor a readable file: {error.strerror}")
    except ValueError:
        row.refuse(f"EA: {text!r} is not a table of strain and tension after three header lines")
    try:
        ForceTable.read(strain, tension, text)
    except SceneError as error:
        row.refuse(f"EA: {error}")
    return {"strain": strain, "tension": tension}


def _damping(row: Row) -> dict[str, float]:
    """BA [N s] or, if negative, the ratio of critical damping."""
    text = row.words[4]
    if "|" in text:
        row.note(f"BA {text} is not represented: the static part is used")
        text = text.split("|")[0]
    value = row.read(text, "BA/-zeta")
    if value < 0.0:
        return {"damping_ratio": -value}
    if value > 0.0:
        return {"damping": value}
    return {}


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
