"""Sections of a site as specified in the file, each with the ranges of its values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dropper_jax.base.errors import Check
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    Values,
    check_keys,
    declared_fields,
    part,
    read_fields,
    read_number,
    read_table,
    read_text,
    refuse,
    section_keys,
)
from dropper_jax.base.read import count as whole_number
from dropper_jax.base.records import select_keys, without_keys, without_none
from dropper_jax.scene import AnchorSpec, GrowthSpec
from dropper_jax.sea.wave_spec import WaveSpec
from fitting.farm.site.standards import read_years, standards

#: Hours of a year of 365.25 days.
HOURS_PER_YEAR = 8766.0


class Section(DeclaredSection):
    """A section with declared fields, whose lists of texts may be a single text, and empty if that is their default."""

    @classmethod
    def read(cls, table: Plain, path: str) -> Self:
        """A checked section.

        Raises:
            SceneError: the first key or value that cannot be used.
        """
        section = cls(**cls.values_of(read_table(table, path), path))
        section.check(path)
        return section

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        """The fields that its table gives, by name."""
        own = dict(table)
        for key, declared in declared_fields(cls).items():
            if declared.metadata.get("type") is not list or key not in own:
                continue
            if isinstance(own[key], str):
                own[key] = [own[key]]
            if own[key] == [] and declared.default != ():
                raise refuse(f"{path}.{key}", [], "is empty", "at least one name or pattern")
        return read_fields(cls, own, path, {})


@dataclass(frozen=True)
class RunValues(Section):
    """`[run]`: settings of every run, and the statistics over its seeds."""

    duration: float = parameter("simulated time of a run", unit="s", above=0.0)
    accuracy: float | None = parameter(
        "required relative accuracy, which the steps follow", unit="-", above=0.0, high=1.0, default=None
    )
    dt: float | None = parameter("equal time step instead", unit="s", above=0.0, default=None)
    seeds: int = whole_number("realisations of each sea", default=10)
    first_seed: int = whole_number("seed of the first one", low=0, default=1)
    skip: float = parameter("time at the start that is not counted", unit="s", low=0.0, default=30.0)
    ramp: float | None = parameter("time to full waves", unit="s", above=0.0, default=None)
    storm: float = parameter("duration of the storm", unit="s", above=0.0, default=10800.0)
    characteristic: str = option("characteristic load", choices=("mean", "most_probable"), default="mean")
    confidence: float = parameter("level of intervals", unit="-", low=0.5, high=0.999, default=0.9)
    halvings: int = whole_number("of the step, for its error", low=0, high=2, default=1)
    step_seeds: int = whole_number("seeds of the runs with halved steps", default=3)

    def checks(self) -> Iterator[Check]:
        both = self.accuracy is not None and self.dt is not None
        yield both, f"dt: {self.dt} excludes accuracy; allowed: one of both"


@dataclass(frozen=True)
class SeaState(Section):
    """`[[sea_state]]`: an irregular sea; Hs = 0 is calm water."""

    name: str = option("name", type=str)
    hours: float | None = parameter("hours of it in a year", unit="h", low=0.0, high=HOURS_PER_YEAR, default=None)
    return_period: str | None = option("years, or `associated`", type=str, default=None)
    sea: WaveSpec = field(kw_only=True)

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        own = dict(table)
        if "return_period" in own:
            own["return_period"] = read_years(own["return_period"], f"{path}.return_period")
        of_sea = [key for key in WaveSpec.FIELDS["spectrum"] if key not in ("seed", "direction")]
        check_keys(own, [*declared_fields(cls), *of_sea], path)
        sea = {key: own.pop(key) for key in of_sea if key in own}
        return super().values_of(own, path) | {"sea": WaveSpec.read({"kind": "spectrum", **sea}, path)}

    def waves(self, direction: float, seed: int) -> Table:
        """`[sea.waves]` for a travel direction [rad] and a seed."""
        return {**self.sea.table(), "direction": direction, "seed": seed}


@dataclass(frozen=True)
class GrowthTable(Section):
    """`[[growth]]`: mussels of a month on some lines."""

    month: str = option("name of the month", type=str)
    lines: tuple[str, ...] = option("lines that carry them", type=list)
    growth: GrowthSpec = field(kw_only=True)

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        where = select_keys(table, ("month", "lines"))
        return super().values_of(where, path) | {"growth": GrowthSpec.read(without_keys(table, where), path)}


@dataclass(frozen=True)
class Factors(Section):
    """`[factors]`: the user's table of factors on loads."""

    intact: float | None = parameter("with all lines intact", unit="-", low=1.0, default=None)
    broken: float | None = parameter("if a line breaks", unit="-", low=1.0, default=None)
    source: str = option("source of the factors", type=str, default="not given: check against your standard")
    edition: str = option("edition of the source", type=str, default="not given")
    clause: str = option("clause of the source", type=str, default="not given")
    checked: str = option("what the factors were compared with", type=str, default="to be checked by you")

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        """Factors of a table; those of `standard = NAME` (see `standards`) where it has none of its own."""
        own = dict(table)
        if "standard" not in own:
            return super().values_of(own, path)
        known = standards("factors")
        standard = known[read_text(own.pop("standard"), f"{path}.standard", known)]
        source = standard["source"]
        for kind in ("intact", "broken"):
            if kind in own:
                source += f"; {kind}: given for this site"
        return super().values_of({**standard, "source": source, **own}, path)

    @property
    def by_kind(self) -> dict[str, float]:
        """The factors that are given, by kind of state."""
        return without_none({"intact": self.intact, "broken": self.broken})

    @classmethod
    def of(cls, value: Plain, path: str) -> Factors:
        """Factors of a part: a number for all states, the name of a standard, or a table."""
        if isinstance(value, str):
            return cls.read({"standard": value}, path)
        if isinstance(value, Mapping):
            return cls.read(value, path)
        number = read_number(value, path, {"low": 1.0}, "a number >= 1, a standard, or { intact = ..., broken = ... }")
        return cls(number, number)


@dataclass(frozen=True)
class Curve(Section):
    """A part's own fatigue curve, `N = k (range/capacity)^-m`."""

    k: float = parameter("cycles at a range equal to the capacity", unit="-", above=0.0)
    m: float = parameter("slope", unit="-", above=0.0)
    source: str = option("source of the curve", type=str, default="not given")


@dataclass(frozen=True)
class PartTable(Section):
    """`[[part]]` as specified."""

    name: str = option("name in reports", type=str)
    lines: tuple[str, ...] = option("lines of the part", type=list)
    capacity: float | None = parameter("breaking load", unit="N", above=0.0, default=None)
    factor: Factors | None = part(Factors.of, default=None)
    curve: Curve | None = part(Curve.read, default=None)


@dataclass(frozen=True, eq=False, kw_only=True)
class AnchorTable(Section, AnchorSpec):
    """`[[anchor]]` of a site: an anchor as in scenes at several points, with the factors of the site."""

    points: tuple[str, ...] = option("fixed points", type=list)
    name: str | None = option("name in reports", type=str, default=None)
    uplift: float | None = parameter("maximum angle of the load", unit="deg", low=0.0, high=90.0, default=None)
    factor: Factors | None = part(Factors.of, default=None)

    @classmethod
    def values_of(cls, table: Values, path: str) -> Table:
        of_scene = ("point", "behind", "safety_factor")
        check_keys(table, [key for key in section_keys(cls) if key not in of_scene], path)
        return super().values_of({"point": "", "kind": "tested", **table}, path)


@dataclass(frozen=True)
class Exclusion(Section):
    """`[exclusion]`: maximum displacement of nodes from their positions in calm water."""

    excursion: float = parameter("maximum horizontal displacement", unit="m", above=0.0)
    lines: tuple[str, ...] = option("lines whose nodes count", type=list, default=("*",))


@dataclass(frozen=True)
class Backbone(Section):
    """`[backbone]`: range of depths below the water's level for lines at rest."""

    lines: tuple[str, ...] = option("lines of the backbone", type=list)
    shallowest: float | None = parameter("minimum depth", unit="m", default=None)
    deepest: float | None = parameter("maximum depth", unit="m", above=0.0, default=None)

    def check(self, path: str) -> None:
        low = self.shallowest
        high = self.deepest
        if low is not None and high is not None and not low < high:
            raise refuse(f"{path}.deepest", high, "is not below shallowest", f"> {low:g} m")

    def margins(self, shallowest: float, deepest: float) -> tuple[float | None, float | None]:
        """Distances [m] of depths from both limits, before sinking and before lifting; None without a limit."""
        sinking = None if self.deepest is None else self.deepest - deepest
        lifting = None if self.shallowest is None else shallowest - self.shallowest
        return sinking, lifting

    def holds(self, shallowest: float, deepest: float) -> bool:
        """Whether depths [m] are within the limits."""
        return all(margin is None or margin >= 0.0 for margin in self.margins(shallowest, deepest))


@dataclass(frozen=True)
class SeasonValues(Section):
    """`[season]`: floats that carry the growing weight."""

    points: tuple[str, ...] = option("free points with a volume that carry floats", type=list)
    volume: float = parameter("of one float", unit="m^3", above=0.0)
    density: float = parameter("of a float over its volume", unit="kg/m^3", low=0.0, default=80.0)
    reserve: float = parameter("minimum ratio of the lift of all floats to the need", unit="-", low=1.0, default=1.3)
    least_share: float = parameter(
        "minimum ratio of the need to the lift: floats that carry less rise", unit="-", low=0.0, high=1.0, default=0.1
    )
    start: int | None = whole_number("floats before the first month", low=0, default=None)
    currents: np.ndarray | None = parameter("of the static poses", unit="m/s", shape="table", default=None)
    levels: np.ndarray | None = parameter("of the static poses", unit="m", shape="table", default=None)

    def checks(self) -> Iterator[Check]:
        for key, values in (("currents", self.currents), ("levels", self.levels)):
            empty = values is not None and len(values) == 0
            yield empty, f"{key}: [] is empty; allowed: at least one; or leave the key out"
