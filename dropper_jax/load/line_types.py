"""Line types: `[[line_type]]`, a rope or chain with values per metre, its EA, or its tension tabulated over strain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from dropper_jax.axial import LAWS
from dropper_jax.axial.force_table import ForceTable
from dropper_jax.base.errors import Check, raise_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    Plain,
    declared_fields,
    read_fields,
    read_table,
)


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
