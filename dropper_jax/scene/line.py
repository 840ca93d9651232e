"""`[[line]]`: a path of links between two points, with its axial law; lines combined into one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, fields, replace
from itertools import chain
from operator import attrgetter

import numpy as np

from dropper_jax.axial import LAWS, Rope
from dropper_jax.axial.force_table import ForceTable, read_tables, tables_of
from dropper_jax.base.errors import Check, SceneError
from dropper_jax.base.fields import option, parameter, section
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    as_table,
    check_keys,
    count,
    items,
    part,
    read_fields,
    read_table,
    refuse,
    section_keys,
)
from dropper_jax.base.records import without_keys, without_none
from dropper_jax.scene.growth import GrowthSpec
from dropper_jax.scene.length_in_time import LengthInTimeSpec, check_changing_lengths

#: Keys that `line_types.expand` removes from lines defined per metre.
BY_THE_METRE = ("type", "sections", "attach", "shelter")
#: Maximum number of links of a line: with more, solvers would take hours per step.
LINK_LIMIT = 100_000


@section
class LineSpec(DeclaredSection):
    """`[[line]]`: a path of links from point `start` to point `end`, one value per link in every array."""

    name: str = option("name", type=str)
    start: str = option("name of the point where the line starts", type=str, key="from")
    end: str = option("name of the point where the line ends", type=str, key="to")
    links: int = count("number of links", high=LINK_LIMIT)
    length: np.ndarray = parameter("length of each link", unit="m", shape="link", above=0.0)
    mass: np.ndarray = parameter("mass of each link", unit="kg", shape="link", above=0.0)
    centre_of_mass: np.ndarray | None = parameter(
        "distance of the centre of mass from the link's first node", unit="m", shape="link", low=0.0, default=None
    )
    inertia: np.ndarray | None = parameter(
        "moment of inertia about the centre of mass", unit="kg m^2", shape="link", low=0.0, default=None
    )
    diameter: np.ndarray | None = parameter(
        "diameter of the displaced volume", unit="m", shape="link", above=0.0, default=None
    )
    outer_diameter: np.ndarray | None = parameter(
        "diameter for drag and added mass (default: `diameter`)",
        unit="m",
        shape="link",
        above=0.0,
        default=None,
    )
    breaking_load: np.ndarray | None = parameter("breaking load", unit="N", shape="link", above=0.0, default=None)
    nodes: str | None = option(
        "nodes of a link's mass and water forces: its far node, or half at both; default: `far` for a line "
        "defined by the link that shares no point with a line, buoy or body and does not start at a free point, "
        "`shared` for others",
        choices=("far", "shared"),
        default=None,
    )
    piece_of: str | None = option("original line, from which attached points cut this one", type=str, default=None)
    axial_law: str = "rigid"
    EA: np.ndarray | None = None
    axial_damping: np.ndarray | None = None
    tables: tuple[ForceTable, ...] | None = None
    #: Further fields declared by the law's class, per link.
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    growth: GrowthSpec | None = part(GrowthSpec.read, default=None)
    length_in_time: tuple[LengthInTimeSpec, ...] = part(items(LengthInTimeSpec), default=())

    @classmethod
    def read(cls, table: Plain, path: str) -> LineSpec:
        own = dict(read_table(table, path))
        check_keys(own, [*section_keys(cls), "axial", *BY_THE_METRE], path)
        for key in BY_THE_METRE:
            if key in own:
                raise SceneError(f"{path}.{key}: is only used together with `type` or `sections`")
        axial = own.pop("axial", {"law": "rigid"})
        count = own.get("links")
        if not isinstance(count, int) or not 0 < count <= LINK_LIMIT:
            count = 1  # a wrong number is rejected when the field is read
        values = read_fields(cls, own, path, {"link": count}) | _read_axial(axial, f"{path}.axial", count)
        per_link = [f.name for f in fields(cls) if f.metadata.get("shape") == "link"]
        for key in (*per_link, "EA", "axial_damping"):
            if values[key] is not None:
                values[key] = _per_link(values[key], count)
        values["constants"] = {key: _per_link(value, count) for key, value in values.get("constants", {}).items()}
        spec = cls(**values)
        spec.check(path)
        check_changing_lengths(spec.length_in_time, f"{path}.length_in_time", spec.name, spec.length, spec.rigid)
        return spec

    @property
    def total(self) -> float:
        """Length of the full line [m]."""
        return np.sum(self.length)

    @property
    def needed_diameter(self) -> np.ndarray:
        """Diameters of the links [m], for what needs them.

        Raises:
            SceneError: the line has none.
        """
        if self.diameter is None:
            raise SceneError(f"line.{self.name}.diameter: missing; needed: the diameter of the line [m]")
        return self.diameter

    @property
    def rigid(self) -> bool:
        return self.axial_law == "rigid"

    @property
    def goes_slack(self) -> bool:
        """Whether its links carry no compression."""
        law = LAWS[self.axial_law]
        return isinstance(law, type) and issubclass(law, Rope)

    def table(self) -> Table:
        found = {key: _one_or_all(value) for key, value in as_table(self).items()}
        if self.rigid:
            return found
        axial = {"EA": self.EA, "damping": self.axial_damping, **self.constants}
        tables = {}
        if self.tables is not None:
            del axial["EA"]
            tables = tables_of(self.tables)
        numbers = {key: _one_or_all(value.tolist()) for key, value in axial.items() if value is not None}
        return {**found, "axial": {"law": self.axial_law, **tables, **numbers}}

    def checks(self) -> Iterator[Check]:
        missing = [key for key in ("centre_of_mass", "inertia") if getattr(self, key) is None]
        yield (
            self.outer_diameter is not None and self.diameter is None,
            "outer_diameter: needs `diameter`, that of the displaced volume",
        )
        yield (
            len(missing) == 1,
            f"{' '.join(missing)}: missing; a compound link needs both `centre_of_mass` and `inertia`",
        )
        yield (
            self.nodes is not None and not missing,
            f"nodes: {self.nodes!r} does not apply to a compound link, which is divided between its nodes by its "
            "centre of mass; allowed: leave it out",
        )


def join_lines(lines: tuple[LineSpec, ...]) -> LineSpec:
    """All lines as one, with their arrays concatenated.

    A field that is missing in some lines becomes None; a missing internal damping becomes zero, and a missing outer
    diameter that of the displaced volume.
    """
    if len(lines) == 1:
        return lines[0]
    found: Table = {"links": sum(line.links for line in lines), "end": lines[-1].end, "constants": {}, "tables": None}
    for key in ("length", "mass", "centre_of_mass", "inertia", "diameter", "breaking_load", "EA"):
        found[key] = _join(lines, key)
    found["axial_damping"] = _join(lines, "axial_damping", lambda line: np.zeros(line.links))
    found["outer_diameter"] = _join(lines, "outer_diameter", attrgetter("diameter"))
    if len({line.axial_law for line in lines}) == 1:
        for key in lines[0].constants:
            found["constants"][key] = np.concatenate([line.constants[key] for line in lines])
    tables = [line.tables for line in lines]
    if None not in tables:
        found["tables"] = tuple(chain.from_iterable(tables))
    return replace(lines[0], **found)


def _join(
    lines: tuple[LineSpec, ...], key: str, default: Callable[[LineSpec], np.ndarray | None] | None = None
) -> np.ndarray | None:
    """The arrays of a key of all lines in one, with defaults of lines without it; None if no line has it, or if one has
    neither."""
    arrays = [getattr(line, key) for line in lines]
    if default is not None and any(array is not None for array in arrays):
        arrays = [default(line) if array is None else array for line, array in zip(lines, arrays, strict=True)]
    if any(array is None for array in arrays):
        return None
    return np.concatenate(arrays)


def _read_axial(table: Plain, path: str, links: int) -> Table:
    """Law and constants of `axial = {law = ..., ...}`; the constants are the fields of the law's class.

    Without `law` it is a rope, as for a `[[line_type]]`.
    """
    table = dict(read_table(table, path))
    law = table.pop("law", "rope")
    if law not in LAWS:
        raise refuse(f"{path}.law", law, "is unknown", ", ".join(LAWS))
    tables = None
    if law == "tabulated":
        tables = read_tables(table, path, links)
        if "EA" in table:
            raise SceneError(f"{path}.EA: cannot be combined with a table; allowed: `strain` and `tension`")
        table = without_keys(table, ("strain", "tension"))
        table["EA"] = [t.stiffness for t in tables]
    values = read_fields(LAWS[law], table, path, {"link": links})
    found = {"axial_law": law, "tables": tables, "EA": values.pop("EA", None)}
    found["axial_damping"] = values.pop("damping", None)
    return {**found, "constants": without_none(values)}


def _per_link(value: Plain, links: int) -> np.ndarray:
    """One value for each link (n,), from one for all or one each."""
    return np.full(links, value, float)


def _one_or_all(value: Plain) -> Plain:
    """One number if all entries of a list of numbers are equal, so that the number of links can be changed."""
    if isinstance(value, list) and isinstance(value[0], float) and value.count(value[0]) == len(value):
        return value[0]
    return value
