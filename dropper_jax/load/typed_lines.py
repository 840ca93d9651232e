"""Lines of types, sections and attached points, written out as lines with one value per link.

    [[line]] shelter                   factor on the current that reaches the line (`effects.morison_drag.shelter`)

Line types and sections are those of `line_types` and `line_sections`. A line with attached points becomes one line per
piece.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import TypeVar

from dropper_jax.axial.force_table import ForceTable, tables_of
from dropper_jax.base.errors import Check, SceneError, raises_first
from dropper_jax.base.read import Plain, Table, Values, read_items, read_number, refuse
from dropper_jax.base.records import column
from dropper_jax.load.line_sections import SECTION_KEYS, Section, read_sections, split_line
from dropper_jax.load.line_types import LineType

Item = TypeVar("Item")
#: Keys of a line defined by the link that a line with a type takes from its type.
TYPE_KEYS = ("mass", "diameter", "outer_diameter", "axial", "centre_of_mass", "inertia")
#: Effect and key that take a coefficient of the line types if the scene omits it.
COEFFICIENTS = {"cdn": "morison_drag", "cdt": "morison_drag", "can": "morison_inertia", "cat": "morison_inertia"}


def expand(table: Values) -> Table:
    """The scene's plain values without line types, sections and attached points; a table without them is unchanged.

    Raises:
        SceneError: an unknown type, a type without a coefficient that the scene's effects need, a point attached
            outside its line, or shelter factors of both lines and drag.
    """
    table = dict(table)
    types = _types(table.pop("line_type", []))
    lines = table.get("line", [])
    if not any({"type", "sections", "attach"} & set(line) for line in lines):
        if types:
            raise SceneError("line_type: no line uses a type. Use `type` or `sections` in a line")
        return table
    table["point"] = list(table.get("point", []))
    pieces: list[Table] = []
    used: list[Section] = []
    shelter: list[float] = []
    for i, line in enumerate(lines):
        line = dict(line)
        _check_keys_of_types(line, f"line.{i}")
        sections = read_sections(line, f"line.{i}", types)
        factor = read_number(line.pop("shelter", 1.0), f"line.{i}.shelter", {"low": 0.0})
        for piece, part in split_line(line, f"line.{i}", sections, table["point"]):
            pieces.append({"nodes": "shared", **piece, **_per_link(part, f"line.{i}")})
            used += part
            shelter += [factor] * pieces[-1]["links"]
    table["line"] = pieces
    table["effects"] = _with_coefficients(table.get("effects", {}), used)
    if any(factor != 1.0 for factor in shelter):
        drag = table["effects"].get("morison_drag")
        if drag is None:
            raise SceneError("line.shelter: reduces the current of [effects.morison_drag]; it is missing")
        if "shelter" in drag:
            raise SceneError(
                "effects.morison_drag.shelter: cannot be combined with line.shelter. Remove one of the two"
            )
        drag["shelter"] = shelter
    return table


@raises_first
def _check_keys_of_types(line: Values, path: str) -> Iterator[Check]:
    typeless = not {"type", "sections"} & set(line)
    yield (
        typeless and "attach" in line,
        f"{path}.attach: the line has no type; `attach` needs one, because it cuts the line by arc length. "
        "Give the line `type` (the name of a [[line_type]]), `length` and `links`, or `sections`",
    )
    yield (
        typeless,
        f"{path}: no type. If one line has a type, all lines need `type` or `sections`",
    )
    for key in TYPE_KEYS:
        yield key in line, f"{path}.{key}: belongs to the line's type. Set it in its [[line_type]]"
    for key in SECTION_KEYS:
        yield (
            key in line and "sections" in line,
            f"{path}.{key}: cannot be combined with `sections`. Set it inside each section",
        )


def _types(items: Plain) -> dict[str, LineType]:
    found: dict[str, LineType] = {}
    for i, kind in enumerate(read_items(LineType.read, items, "line_type")):
        if kind.name in found:
            raise refuse(f"line_type.{i}.name", kind.name, "is used twice", "a unique name")
        found[kind.name] = kind
    return found


def _each(sections: Sequence[Section], value: Callable[[Section], Item]) -> list[Item]:
    """One value for each link."""
    found = []
    for section in sections:
        found += [value(section)] * section.links
    return found


def _axial(sections: Sequence[Section], path: str) -> Table:
    """The axial law with one value per link; together with `tabulated` sections, ropes become tables as well."""
    laws = {s.kind.law for s in sections}
    if laws == {"rigid"}:
        return {"law": "rigid"}
    if len(laws) > 1 and not laws <= {"rope", "tabulated"}:
        raise SceneError(f"{path}.sections: the types have different axial laws; allowed: one law per line")
    damping = _each(sections, lambda s: float(s.kind.internal_damping(s.link)))
    if "tabulated" in laws:
        tables = _each(sections, lambda s: s.kind.table or ForceTable.straight(s.kind.stiffness))
        return {"law": "tabulated", **tables_of(tables), "damping": damping}
    found = {"law": laws.pop(), "EA": _each(sections, attrgetter("kind.stiffness")), "damping": damping}
    constants = _each(sections, attrgetter("kind.constants"))
    for key in constants[0]:
        found[key] = column(constants, key)
    return found


def _per_link(sections: Sequence[Section], path: str) -> Table:
    """Keys of a `[[line]]` with one value per link."""
    found = {
        "links": sum(s.links for s in sections),
        "length": _each(sections, attrgetter("link")),
        "mass": _each(sections, lambda s: s.kind.mass * s.link),
        "diameter": _each(sections, attrgetter("kind.diameter")),
        "axial": _axial(sections, path),
    }
    if any(s.kind.outer_diameter is not None for s in sections):
        found["outer_diameter"] = _each(sections, lambda s: s.kind.outer_diameter or s.kind.diameter)
    if not _lack(sections, "breaking_load"):
        found["breaking_load"] = _each(sections, attrgetter("kind.breaking_load"))
    return found


def _lack(sections: Sequence[Section], key: str) -> list[str]:
    """Names of the types of sections that have no value of a key."""
    return [s.kind.name for s in sections if getattr(s.kind, key) is None]


def breaking_load_warnings(types: Sequence[Table], lines: Sequence[Table]) -> Iterator[str]:
    """A warning for each line, or piece of one, that has no breaking load because only some of its types have one.

    Args:
        types, lines: plain values of `[[line_type]]` and `[[line]]`.
    """
    kinds = _types(types)
    for i, line in enumerate(lines):
        path = f"line.{i}"
        line = dict(line)
        sections = read_sections(line, path, kinds)
        for piece, part in split_line(line, path, sections, []):
            lacking = _lack(part, "breaking_load")
            if 0 < len(lacking) < len(part):
                yield (
                    f"line {piece.get('name', 'line')!r}: has no breaking load, as its type {lacking[0]!r} has none; "
                    "give one to all types of the line, or attach a point between them"
                )


def _with_coefficients(given: Values, sections: Sequence[Section]) -> Table:
    """Effects with the coefficients of the line types if the scene omits them."""
    effects = {name: dict(values) for name, values in given.items()}
    stiff = [s.kind.name for s in sections if s.kind.EI]
    if stiff and "bending" not in effects:
        raise SceneError(f"line_type.{stiff[0]}.EI: needs [effects.bending], which is missing")
    if stiff:
        effects["bending"].setdefault("EI", _each(sections, lambda s: s.kind.EI or 0.0))
    for key, effect in COEFFICIENTS.items():
        if effect not in effects or key in effects[effect]:
            continue
        if key in ("cdn", "can") and effects[effect].get("coefficients", "given") != "given":
            continue
        lacking = _lack(sections, key)
        if not lacking:
            effects[effect][key] = _each(sections, attrgetter(f"kind.{key}"))
        elif len(lacking) < len(sections):
            raise SceneError(
                f"line_type.{lacking[0]}.{key}: missing; other types have it, and effects.{effect} uses it"
            )
    return effects
