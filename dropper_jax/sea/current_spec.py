"""`[sea.current]` and `[sea.level]` of a scene, validated, each steady or in time by a table or constituents."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from dropper_jax.base.errors import Check, raises_first
from dropper_jax.base.read import DeclaredSection, Plain, Table, read_fields, rises
from dropper_jax.sea.current import Current, Level

#: Exponent of a power law that gives none: the one-seventh law.
ONE_SEVENTH_LAW = 1.0 / 7.0


@dataclasses.dataclass(frozen=True, eq=False)
class CurrentSpec(Current, DeclaredSection):
    """`[sea.current]`: see `dropper_jax.sea.current.Current`."""

    #: Numbers of the profile that a kind does not use.
    UNUSED: ClassVar[dict[str, tuple[str, ...]]] = {
        "uniform": ("exponent", "reference"),
        "power": (),
        "table": ("speed", "direction", "exponent", "reference"),
    }

    @classmethod
    def read(cls, table: Plain, path: str) -> CurrentSpec:
        values = read_fields(cls, table, path, {})
        if values["kind"] == "power":
            if values["exponent"] is None:
                values["exponent"] = ONE_SEVENTH_LAW
            if values["reference"] is None:
                values["reference"] = 0.0
        _check_pair(values, path, "heights", "velocities", values["kind"] == "table")
        _check_pair(values, path, "time", "factor")
        _check_constituents(values, path)
        current = cls(**values)
        current.check(path)
        return current

    def checks(self) -> Iterator[Check]:
        yield (
            self.time is not None and self.amplitude is not None,
            "amplitude: cannot be combined with `time`; allowed: one of the two",
        )
        yield (
            self.veer is not None and self.velocities is not None,
            "veer: given with kind 'table', which turns itself; allowed: uniform, power",
        )
        for key in self.UNUSED[self.kind]:
            value = getattr(self, key)
            kinds = [kind for kind, unused in self.UNUSED.items() if key not in unused]
            yield (
                value is not None and value != 0.0,
                f"{key}: not used by kind {self.kind!r}; allowed: with {', '.join(kinds)}",
            )


@dataclasses.dataclass(frozen=True, eq=False)
class LevelSpec(Level, DeclaredSection):
    """`[sea.level]`: see `dropper_jax.sea.current.Level`."""

    @classmethod
    def read(cls, table: Plain, path: str) -> LevelSpec:
        values = read_fields(cls, table, path, {})
        _check_pair(values, path, "time", "height")
        _check_constituents(values, path)
        return cls(**values)

    @property
    def lowest(self) -> float:
        """A level [m] below which it never falls."""
        level = float(self.offset)
        if self.amplitude is not None:
            level -= float(np.sum(np.abs(self.amplitude)))
        if self.height is not None:
            level += float(np.min(self.height))
        return level


@raises_first
def _check_constituents(values: Table, path: str) -> Iterator[Check]:
    """Reject incomplete constituents or unequal lengths; phases are 0 by default."""
    sizes = {key: len(values[key]) for key in ("amplitude", "period", "phase") if values[key] is not None}
    if not sizes:
        return
    for key in ("amplitude", "period"):
        yield key not in sizes, f"{path}.{key}: missing; constituents need `amplitude` and `period`"
    count = sizes["amplitude"]
    if values["phase"] is None:
        values["phase"] = np.zeros(count)
    for key, size in sizes.items():
        yield size != count, f"{path}.{key}: has {size} entries; allowed: {count}, one per constituent"
    shortest = float(np.min(values["period"], initial=np.inf))
    yield shortest <= 0.0, f"{path}.period: {shortest:g} is out of range; allowed: > 0 s"


@raises_first
def _check_pair(values: Table, path: str, axis: str, other: str, needed: bool | None = None) -> Iterator[Check]:
    """Check two tables of equal length over a rising axis: both with `needed`, none if it is False, both or none if it
    is None."""
    a = values[axis]
    b = values[other]
    if needed is None:
        needed = a is not None
    yield (
        (a is not None) != needed or (b is not None) != needed,
        f"{path}: `{axis}` and `{other}` belong together (kind 'table' for heights); one is missing",
    )
    yield (
        a is not None and (len(a) != len(b) or not rises(a, 2)),
        f"{path}.{axis}: needs at least 2 rising values, as many as `{other}`",
    )
