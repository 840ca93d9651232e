"""`[[line]]`: a path of links between two points, with its axial law, and several lines combined into one."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np

from dropper_jax.axial import LAWS
from dropper_jax.axial.force_table import ForceTable, read_tables, tables_of
from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import Plain, as_table, check_keys, count, field_keys, read_fields, read_table, refuse
from dropper_jax.scene.growth import GrowthSpec

#: Keys that `line_types.expand` removes from lines defined per metre.
BY_THE_METRE = ("type", "sections", "attach", "shelter")


#: Maximum number of links of a line: with more, solvers would take hours per step.
MOST_LINKS = 100_000


@dataclasses.dataclass(frozen=True, eq=False)
class LineSpec:
    """`[[line]]`: a path of links from point `start` to point `end`, one value per link in every array."""

    KEYS: ClassVar[dict[str, str]] = {"start": "from", "end": "to"}

    name: str = option("name", type=str)
    start: str = option("name of the point where the line starts", type=str)
    end: str = option("name of the point where the line ends", type=str)
    links: int = count("number of links", high=MOST_LINKS)
    length: np.ndarray = parameter("length of each link", unit="m", shape="link", low=0.0, open_low=True)
    mass: np.ndarray = parameter("mass of each link", unit="kg", shape="link", low=0.0, open_low=True)
    centre_of_mass: np.ndarray | None = parameter(
        "distance of the centre of mass from the link's first node", unit="m", shape="link", low=0.0, optional=True
    )
    inertia: np.ndarray | None = parameter(
        "moment of inertia about the centre of mass", unit="kg m^2", shape="link", low=0.0, optional=True
    )
    diameter: np.ndarray | None = parameter(
        "diameter of the displaced volume", unit="m", shape="link", low=0.0, open_low=True, optional=True
    )
    breaking_load: np.ndarray | None = parameter(
        "breaking load", unit="N", shape="link", low=0.0, open_low=True, optional=True
    )
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
    constants: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    growth: GrowthSpec | None = None

    @classmethod
    def read(cls, table: Plain, path: str) -> LineSpec:
        own = dict(read_table(table, path))
        check_keys(own, [*field_keys(cls, cls.KEYS), "axial", "growth", *BY_THE_METRE], path)
        for key in BY_THE_METRE:
            if key in own:
                raise SceneError(f"{path}.{key}: is only used together with `type` or `sections`")
        axial = own.pop("axial", {"law": "rigid"})
        growth = own.pop("growth", None)
        links = own.get("links")
        known = isinstance(links, int) and 0 < links <= MOST_LINKS
        count = links if known else 1  # a wrong number is rejected when the field is read
        values = read_fields(cls, own, path, {"link": count}, cls.KEYS)
        if (values["centre_of_mass"] is None) != (values["inertia"] is None):
            missing = "inertia" if values["inertia"] is None else "centre_of_mass"
            raise SceneError(f"{path}.{missing}: missing; a compound link needs both `centre_of_mass` and `inertia`")
        if values["nodes"] is not None and values["inertia"] is not None:
            why = "does not apply to a compound link, which is divided between its nodes by its centre of mass"
            raise refuse(f"{path}.nodes", values["nodes"], why, "leave it out")
        values.update(_read_axial(axial, f"{path}.axial", count))
        spread = ("length", "mass", "centre_of_mass", "inertia", "diameter", "breaking_load", "EA", "axial_damping")
        values.update({key: _per_link(values[key], count) for key in spread if values.get(key) is not None})
        values["constants"] = {key: _per_link(value, count) for key, value in values.get("constants", {}).items()}
        return cls(**values, growth=None if growth is None else GrowthSpec.read(growth, f"{path}.growth"))

    @property
    def total(self) -> float:
        """Length of the full line [m]."""
        return float(np.sum(self.length))

    @property
    def rigid(self) -> bool:
        return self.axial_law == "rigid"

    def table(self) -> dict[str, Any]:
        found = {key: _one_or_all(value) for key, value in as_table(self, self.KEYS).items()}
        if self.growth is not None:
            found["growth"] = self.growth.table()
        if self.rigid:
            return found
        stiffness = {"EA": _one_or_all(self.EA.tolist())} if self.tables is None else tables_of(self.tables)
        axial = {"law": self.axial_law, **stiffness}
        if self.axial_damping is not None:
            axial["damping"] = _one_or_all(self.axial_damping.tolist())
        axial.update({key: _one_or_all(value.tolist()) for key, value in self.constants.items()})
        return {**found, "axial": axial}


def join_lines(lines: tuple[LineSpec, ...]) -> LineSpec:
    """All lines as one, with their arrays concatenated.

    Fields missing in some lines become None, a missing internal damping zero.
    """
    if len(lines) == 1:
        return lines[0]

    def together(key: str) -> np.ndarray | None:
        values = [getattr(line, key) for line in lines]
        return None if any(v is None for v in values) else np.concatenate(values)

    arrays = ("length", "mass", "centre_of_mass", "inertia", "diameter", "breaking_load", "EA")
    damping = None
    if any(line.axial_damping is not None for line in lines):
        damping = np.concatenate([np.zeros(n.links) if n.axial_damping is None else n.axial_damping for n in lines])
    keys = lines[0].constants if len({line.axial_law for line in lines}) == 1 else ()
    tables = None
    if all(line.tables is not None for line in lines):
        tables = tuple(table for line in lines for table in line.tables)
    return dataclasses.replace(
        lines[0],
        tables=tables,
        links=sum(line.links for line in lines),
        end=lines[-1].end,
        axial_damping=damping,
        constants={key: np.concatenate([line.constants[key] for line in lines]) for key in keys},
        **{key: together(key) for key in arrays},
    )


def _read_axial(table: Plain, path: str, links: int) -> dict[str, Any]:
    """Law and constants of `axial = {law = ..., ...}`; the constants are the fields of the law's class."""
    table = dict(read_table(table, path))
    law = table.pop("law", None)
    if law not in LAWS:
        raise refuse(f"{path}.law", law, "is unknown", ", ".join(LAWS))
    if law == "tabulated":
        tables = read_tables(table, path, links)
        rest = {key: value for key, value in table.items() if key not in ("strain", "tension", "EA")}
        if "EA" in table:
            raise SceneError(f"{path}.EA: cannot be combined with a table; allowed: `strain` and `tension`")
        damping = read_fields(LAWS[law], {**rest, "EA": 1.0}, path, {"link": links})["damping"]
        stiffness = np.array([t.stiffness for t in tables])
        return {"axial_law": law, "EA": stiffness, "axial_damping": damping, "tables": tables}
    values = read_fields(LAWS[law], table, path, {"link": links})
    stiffness, damping = values.pop("EA", None), values.pop("damping", None)
    constants = {key: value for key, value in values.items() if value is not None}
    return {"axial_law": law, "EA": stiffness, "axial_damping": damping, "constants": constants}


def _per_link(value: Plain, links: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, float), (links,)).copy()


def _one_or_all(value: Plain) -> Plain:
    """One number if all entries of a list are equal, so that the number of links can be changed."""
    return value[0] if isinstance(value, list) and value and value.count(value[0]) == len(value) else value
