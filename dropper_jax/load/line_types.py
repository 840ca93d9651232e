"""Line types, sections and attached points: from the user's input to lines with one value per link.

    [[line_type]]                      a rope or chain, values per metre: EA, or tension tabulated over strain
    [[line]] type, length, links       one section of one type, or
    [[line]] sections = [{type, length, links}, ...]
    [[line]] attach = [{point, at}]    points along the line, by arc length from its first end
    [[line]] shelter                   factor on the current that reaches the line (`effects.morison_drag.shelter`)

A line with attached points is split into one line per piece, named `NAME-1`, `NAME-2`, ...
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from dropper_jax.axial import LAWS
from dropper_jax.axial.force_table import ForceTable, tables_of
from dropper_jax.base.errors import Check, SceneError, nearest, raise_first, raises_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    Values,
    count,
    declared_fields,
    read_fields,
    read_items,
    read_list,
    read_number,
    read_table,
    refuse,
)
from dropper_jax.scene.length_in_time import of_pieces
from dropper_jax.scene.line import LINK_LIMIT

Item = TypeVar("Item")

#: Spacing of attached points, relative to the line's length, below which a piece would have no length.
SAME_POSITION = 1e-9
#: Keys of a section of a line, or of a line without sections.
SECTION_KEYS = ("type", "length", "links")
#: Keys of a line defined by the link that a line with a type takes from its type.
TYPE_KEYS = ("mass", "diameter", "outer_diameter", "axial", "centre_of_mass", "inertia")
#: Effect and key that take a coefficient of the line types if the scene omits it.
COEFFICIENTS = {"cdn": "morison_drag", "cdt": "morison_drag", "can": "morison_inertia", "cat": "morison_inertia"}


@dataclass(frozen=True)
class LineType:
    """`[[line_type]]`: a rope or chain, values per metre; coefficients if the scene's effects require them.

    Attributes:
        constants: further fields declared by the law's class.
    """

    name: str = option("name", type=str)
    mass: float = parameter("mass per metre", unit="kg/m", above=0.0)
    diameter: float = parameter("diameter of the displaced volume", unit="m", above=0.0)
    outer_diameter: float | None = parameter(
        "diameter for drag and added mass (default: `diameter`)", unit="m", above=0.0, default=None
    )
    EA: float | None = parameter("axial stiffness", unit="N", above=0.0, default=None)
    strain: np.ndarray | None = parameter("strains of a table, rising", unit="-", shape="table", default=None)
    tension: np.ndarray | None = parameter("tensions at those strains", unit="N", shape="table", default=None)
    law: str = option("axial law", choices=tuple(LAWS), default="rope")
    damping: float | None = parameter("internal damping BA", unit="N s", low=0.0, default=None)
    damping_ratio: float | None = parameter(
        "damping ratio (internal damping over critical), per link", unit="-", low=0.0, default=None
    )
    EI: float | None = parameter("bending stiffness", unit="N m^2", low=0.0, default=None)
    breaking_load: float | None = parameter("breaking load", unit="N", above=0.0, default=None)
    cdn: float | None = parameter("drag coefficient across", unit="-", low=0.0, default=None)
    cdt: float | None = parameter("drag coefficient along", unit="-", low=0.0, default=None)
    can: float | None = parameter("added mass coefficient across", unit="-", low=0.0, default=None)
    cat: float | None = parameter("added mass coefficient along", unit="-", low=0.0, default=None)
    constants: dict[str, float] = field(default_factory=dict)

    @classmethod
    def read(cls, table: Plain, path: str) -> LineType:
        own = dict(read_table(table, path))
        law = own.get("law", "rope")
        more: list[str] = []
        if law in list(LAWS):  # an unknown law is rejected with the other fields
            more = law_constants(law)
        given = {key: own.pop(key) for key in more if key in own}
        kind = cls(**read_fields(cls, own, path, {}))
        if more:
            values = read_fields(LAWS[law], {"EA": 1.0, **given}, path, {"link": 1})
            kind = replace(kind, constants={key: values[key] for key in more if values[key] is not None})
        raise_first(kind.checks(), path)
        if law == "tabulated":
            ForceTable.read(kind.strain, kind.tension, path)
        return kind

    @property
    def table(self) -> ForceTable | None:
        """The table of a tabulated type."""
        if self.strain is None or self.tension is None:
            return None
        return ForceTable(self.strain, self.tension)

    @property
    def stiffness(self) -> float:
        """EA [N], of a table its maximum slope; zero of a rigid type."""
        if self.table is not None:
            return self.table.stiffness
        return self.EA or 0.0

    def internal_damping(self, link: float) -> float:
        """BA [N s] of links of this length [m]: as given, or `ratio * link * sqrt(EA m)`, m per metre (as MoorDyn)."""
        if self.damping is not None:
            return self.damping
        return (self.damping_ratio or 0.0) * link * np.sqrt(self.stiffness * self.mass)

    def checks(self) -> Iterator[Check]:
        """Checks for `EA`, a table if the law is `tabulated`, or neither if it is `rigid`; at most one kind of
        damping."""
        needed = {"tabulated": ("strain", "tension"), "rigid": ()}.get(self.law, ("EA",))
        used = needed
        if self.law != "rigid":
            used = (*needed, "damping", "damping_ratio")
        takes = " and ".join(needed) or "no stiffness and no damping"
        for key in ("EA", "strain", "tension", "damping", "damping_ratio"):
            given = getattr(self, key) is not None
            yield not given and key in needed, f"{key}: missing; law {self.law!r} needs {takes}"
            yield given and key not in used, f"{key}: not used by law {self.law!r}, which takes {takes}"
        both = self.damping is not None and self.damping_ratio is not None
        yield both, ": `damping` and `damping_ratio` are both given; allowed: one of the two"


def law_constants(law: str) -> list[str]:
    """Constants that the class of an axial law declares besides those of every line type."""
    common = declared_fields(LineType)
    return [key for key in declared_fields(LAWS[law]) if key not in common]


@dataclass(frozen=True)
class Section(DeclaredSection):
    """A section of a line: its type, unstretched length [m] and number of links."""

    type: str = option("name of a [[line_type]]", type=str)
    length: float = parameter("length", unit="m", above=0.0)
    links: int = count("number of links", high=LINK_LIMIT)
    kind: LineType = field(kw_only=True)

    @classmethod
    def read(cls, table: Plain, path: str, types: Mapping[str, LineType]) -> Section:
        values = read_fields(cls, table, path, {})
        name = values["type"]
        if name not in types:
            raise SceneError(f"{path}.type: {name!r} is not a line type; {nearest(name, types)}")
        return cls(**values, kind=types[name])

    @property
    def link(self) -> float:
        """Length of a link [m]."""
        return self.length / self.links

    def cut(self, length: float) -> Section:
        """A part of it, with a proportional number of links, at least one."""
        return replace(self, length=length, links=max(1, round(self.links * length / self.length)))


@dataclass(frozen=True)
class AttachedPoint(DeclaredSection):
    """An entry of `attach`: a point along a line."""

    at: float = parameter("arc length from the first end of the line", unit="m")
    point: str | None = option("name of the point", type=str, default=None)

    def on(self, path: str, line: str, total: float) -> tuple[float, str]:
        """Arc length [m] and name of the point on a line of that name and length [m]."""
        if not SAME_POSITION * total < self.at < (1.0 - SAME_POSITION) * total:
            raise refuse(f"{path}.at", self.at, "is not on the line", f"above 0 and below its length, {total:g} m")
        return self.at, self.point or f"{line}-at-{self.at:g}"


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
        sections = _sections(line, f"line.{i}", types)
        factor = read_number(line.pop("shelter", 1.0), f"line.{i}.shelter", {"low": 0.0})
        for piece, part in _split(line, f"line.{i}", sections, table["point"]):
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


def _sections(line: Table, path: str, types: dict[str, LineType]) -> tuple[Section, ...]:
    """The sections of a line; removes their keys from it."""
    if "sections" not in line:
        return (Section.read({key: line.pop(key) for key in SECTION_KEYS if key in line}, path, types),)
    found = read_items(Section.read, line.pop("sections"), f"{path}.sections", types)
    if not found:
        raise refuse(f"{path}.sections", [], "is empty", "at least one {type, length, links}")
    return found


def _read_position(value: Plain) -> np.ndarray | None:
    """A position (3,) [m]; None if it is invalid, which is rejected when the point is read."""
    try:
        return np.array([read_number(x, "", {}) for x in read_list(value, "", 3, "")])
    except SceneError:
        return None


def _split(
    line: Table, path: str, sections: Sequence[Section], points: list[Values]
) -> list[tuple[Table, Sequence[Section]]]:
    """The pieces between attached points. A point that the scene does not have is created, free, on the straight
    line."""
    attached = line.pop("attach", None)
    if attached is None:
        return [(line, sections)]
    total = sum(s.length for s in sections)
    name = line.get("name", "line")
    given = read_items(AttachedPoint.read, attached, f"{path}.attach")
    stops = sorted(stop.on(f"{path}.attach.{i}", name, total) for i, stop in enumerate(given))
    for (at, one), (further, other) in pairwise(stops):
        if further - at <= SAME_POSITION * total:
            raise SceneError(
                f"{path}.attach: {one!r} and {other!r} are both at {at:g} m; allowed: one point per position"
            )
    positions = {str(p.get("name")): p.get("position") for p in points}
    start = _read_position(positions.get(str(line.get("from"))))
    end = _read_position(positions.get(str(line.get("to"))))
    for at, stop in stops:
        if stop not in positions and start is not None and end is not None:
            position = start + (end - start) * at / total
            points.append({"name": stop, "kind": "free", "position": position.tolist()})
    changing = line.pop("length_in_time", None)
    found = []
    for (low, first), (high, last) in pairwise([(0.0, line.get("from")), *stops, (total, line.get("to"))]):
        piece = {**line, "name": f"{name}-{len(found) + 1}", "piece_of": name, "from": first, "to": last}
        found.append((piece, _between(sections, low, high)))
    if changing is not None:
        for (piece, _), own in zip(found, of_pieces(changing, f"{path}.length_in_time", len(found)), strict=True):
            piece["length_in_time"] = own
    return found


def _between(sections: Sequence[Section], low: float, high: float) -> list[Section]:
    """The part of the sections from arc length `low` to `high` [m]."""
    found = []
    start = 0.0
    for section in sections:
        length = min(high, start + section.length) - max(low, start)
        if length > 1e-9 * section.length:
            found.append(section.cut(length))
        start += section.length
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
    found = {"law": laws.pop(), "EA": _each(sections, lambda s: s.kind.stiffness), "damping": damping}
    for key in sections[0].kind.constants:
        found[key] = _each(sections, lambda s, key=key: s.kind.constants[key])
    return found


def _per_link(sections: Sequence[Section], path: str) -> Table:
    """Keys of a `[[line]]` with one value per link."""
    found = {
        "links": sum(s.links for s in sections),
        "length": _each(sections, lambda s: s.link),
        "mass": _each(sections, lambda s: s.kind.mass * s.link),
        "diameter": _each(sections, lambda s: s.kind.diameter),
        "axial": _axial(sections, path),
    }
    if any(s.kind.outer_diameter is not None for s in sections):
        found["outer_diameter"] = _each(sections, lambda s: s.kind.outer_diameter or s.kind.diameter)
    if all(s.kind.breaking_load is not None for s in sections):
        found["breaking_load"] = _each(sections, lambda s: s.kind.breaking_load)
    return found


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
        lacking = [s.kind.name for s in sections if getattr(s.kind, key) is None]
        if not lacking:
            effects[effect][key] = _each(sections, lambda s, key=key: float(getattr(s.kind, key)))
        elif len(lacking) < len(sections):
            raise SceneError(
                f"line_type.{lacking[0]}.{key}: missing; other types have it, and effects.{effect} uses it"
            )
    return effects
