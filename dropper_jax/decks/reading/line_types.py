"""Line types of a MoorDyn file of version 1 or 2, as `[[line_type]]` tables."""

from __future__ import annotations

import numpy as np

from dropper_jax.axial.force_table import ForceTable
from dropper_jax.base.errors import SceneError
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
