"""`[sea]`, `[sea.waves]` and `[sea.current]` of a scene, validated. Files are read here, so that a scene is
self-contained."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from typing import ClassVar

import numpy as np

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import Check, SceneError, nearest, raises_first
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    Values,
    as_table,
    check_kind_keys,
    part,
    plain,
    read_fields,
    read_table,
    read_text,
    rises,
    short_text,
)
from dropper_jax.base.read import count as whole_number
from dropper_jax.base.records import names_of
from dropper_jax.base.references import find_referenced
from dropper_jax.sea.current import Current, Level
from dropper_jax.sea.spectrum import SHAPES
from dropper_jax.sea.steady import CRITERIA, THEORIES
from dropper_jax.sea.wave_files import read_components, read_elevation
from dropper_jax.sea.waves import STRETCHING

#: Keys that waves of a kind need; of regular ones each may be replaced by another one.
NEEDED = {
    "regular": ("amplitude", "period"),
    "components": ("amplitude", "period"),
    "spectrum": ("hs", "tp"),
    "elevation": ("file",),
}
REPLACEMENTS = {"amplitude": "height", "period": "length"}


@dataclasses.dataclass(frozen=True, eq=False)
class WaveSpec(DeclaredSection):
    """`[sea.waves]`: `regular`, `components` (listed or from a file), `spectrum`, or an `elevation` series (a file)."""

    FIELDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "regular": (
            "amplitude",
            "height",
            "period",
            "length",
            "phase",
            "direction",
            "theory",
            "order",
            "current_criterion",
        ),
        "components": ("amplitude", "period", "phase", "direction", "file"),
        "spectrum": (
            "spectrum",
            "hs",
            "tp",
            "gamma",
            "count",
            "frequencies",
            "spreading",
            "directions",
            "seed",
            "direction",
        ),
        "elevation": ("file", "direction"),
    }

    kind: str = option("how the waves are given", choices=tuple(FIELDS))
    amplitude: float | np.ndarray | None = parameter("amplitude", unit="m", shape="numbers", low=0.0, default=None)
    period: float | np.ndarray | None = parameter("period", unit="s", shape="numbers", above=0.0, default=None)
    phase: float | np.ndarray = parameter("phase", unit="rad", shape="numbers", default=0.0)
    direction: float | np.ndarray = parameter(
        "direction of travel, +x towards +y", unit="rad", shape="numbers", low=-6.29, high=6.29, default=0.0
    )  # up to a turn: larger numbers are degrees
    file: str | None = option("CSV file", type=str, default=None)
    spectrum: str = option("shape", choices=SHAPES, default="jonswap")
    hs: float | None = parameter("significant wave height", unit="m", low=0.0, default=None)
    tp: float | None = parameter("peak period", unit="s", above=0.0, default=None)
    gamma: float = parameter("peak factor", unit="-", low=1.0, default=3.3)
    count: int = whole_number("number of frequencies", default=200)
    frequencies: str = option(
        "how they are chosen", choices=("equal_energy", "equal_frequency", "even"), default="equal_energy"
    )
    spreading: float | None = parameter("s of cos^2s spreading", unit="-", low=0.0, default=None)
    directions: int = whole_number("directions per frequency", default=1)
    seed: int = whole_number("seed of the phases", low=0, default=0)
    height: float | None = parameter("trough to crest", unit="m", above=0.0, default=None)
    length: float | None = parameter("wavelength", unit="m", above=0.0, default=None)
    theory: str = option("of a regular wave", choices=THEORIES, default="linear")
    order: int | None = whole_number("number of harmonics of the stream function", low=3, default=None)
    current_criterion: str = option(
        "mean velocity of the water that the current represents", choices=CRITERIA, default="euler"
    )

    @classmethod
    def read(cls, table: Plain, path: str) -> WaveSpec:
        values = read_fields(cls, table, path, {})
        check_kind_keys(read_table(table, path), values["kind"], cls.FIELDS, path)
        if values["file"] is not None:
            values = read_fields(cls, _with_components(values, path, table), path, {})
        waves = cls(**values)
        waves.check(path)
        return waves

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        needed = NEEDED[self.kind]
        for key in needed:
            other = REPLACEMENTS[key] if self.kind == "regular" else key
            is_given = getattr(self, key) is not None
            other_is_given = getattr(self, other) is not None
            yield (
                not (is_given or other_is_given),
                f"{path}.{key}: missing; kind {self.kind!r} needs {' and '.join(needed)}",
            )
            yield (
                other != key and is_given and other_is_given,
                f"{path}.{other}: cannot be combined with `{key}`; allowed: one of the two",
            )
        theory = self.theory
        yield (
            self.order is not None and theory != "stream",
            f"{path}.order: {self.order} is not used by theory {theory!r}; allowed: with 'stream'",
        )
        yield (
            self.current_criterion != "euler" and theory == "linear",
            f"{path}.current_criterion: 'stokes' is not used by theory 'linear'; allowed: with stokes5, stream, auto",
        )
        yield (
            theory != "linear" and self.amplitude is not None and not np.all(np.asarray(self.amplitude) > 0.0),
            f"{path}.amplitude: {short_text(plain(self.amplitude))} is not a wave; allowed: > 0 m with theory "
            f"{theory!r}",
        )
        keys = [key for key in ("amplitude", "period", "phase", "direction") if getattr(self, key) is not None]
        count = 1
        allowed = "one number"
        if self.kind not in ("regular", "spectrum"):
            count = max(np.size(getattr(self, key)) for key in keys)
        if count != 1:
            allowed = f"{count}, one per component"
        for key in keys:
            value = getattr(self, key)
            size = np.size(value)
            yield (
                size != count and (size != 1 or key in ("amplitude", "period")),
                f"{path}.{key}: {short_text(plain(value))} has {size} entries; allowed: {allowed}",
            )

    @property
    def size(self) -> float | np.ndarray:
        """Amplitude [m], one or one per component; zero of a spectrum."""
        if self.height is not None:
            return 0.5 * self.height
        if self.amplitude is None:
            return 0.0
        return self.amplitude

    def table(self) -> Table:
        defaults = {"theory": "linear", "current_criterion": "euler"}  # left out, since linear waves do not use them
        keys = ("kind", *self.FIELDS[self.kind])
        return {key: value for key, value in as_table(self).items() if key in keys and defaults.get(key) != value}


def _with_components(values: Table, path: str, table: Plain) -> Table:
    """The table of the scene, with the components of the file in place of its name."""
    label = f"{path}.file"
    file = find_referenced(values["file"], label)
    if values["kind"] == "elevation":
        components = read_elevation(file, label)
    else:
        components = read_components(file, label)
    given = dict(read_table(table, path))
    for key in components:
        if key in given:
            raise SceneError(f"{path}.{key}: given twice, here and in the file; allowed: one of the two")
    del given["file"]
    return {**given, "kind": "components", **components}


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

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        yield (
            self.time is not None and self.amplitude is not None,
            f"{path}.amplitude: cannot be combined with `time`; allowed: one of the two",
        )
        yield (
            self.veer is not None and self.velocities is not None,
            f"{path}.veer: given with kind 'table', which turns itself; allowed: uniform, power",
        )
        for key in self.UNUSED[self.kind]:
            value = getattr(self, key)
            yield (
                value is not None and value != 0.0,
                f"{path}.{key}: not used by kind {self.kind!r}; allowed: with {', '.join(self._kinds_with(key))}",
            )

    @classmethod
    def _kinds_with(cls, key: str) -> list[str]:
        """The kinds of profile that use a key."""
        return [kind for kind, unused in cls.UNUSED.items() if key not in unused]


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


@dataclasses.dataclass(frozen=True, eq=False)
class SeaSpec(DeclaredSection):
    """`[sea]`: water below z = 0. `packaged` names a packaged sea, whose values the scene may override."""

    depth: float = parameter("depth of the water", unit="m", above=0.0)
    density: float = parameter("density of the water", unit="kg/m^3", above=0.0, default=SEA_WATER)
    gravity: float = parameter(
        "acceleration of gravity, by default that of the weight", unit="m/s^2", low=0.0, default=GRAVITY
    )
    ramp: float | None = parameter("time to full waves", unit="s", above=0.0, default=None)
    stretching: str = option("kinematics above the mean surface", choices=STRETCHING, default="wheeler")
    dispersion: str = option("wave numbers", choices=("exact", "fenton"), default="exact")
    wave_current: str = option("effect of a current on waves", choices=("none", "doppler", "action"), default="none")
    interpolation: str = option("how kinematics are computed", choices=("none", "grid"), default="none")
    waves: WaveSpec | None = part(WaveSpec.read, default=None)
    current: CurrentSpec | None = part(CurrentSpec.read, default=None)
    level: LevelSpec | None = part(LevelSpec.read, default=None)

    @classmethod
    def read(cls, table: Plain, path: str) -> SeaSpec:
        own = dict(read_table(table, path))
        if "packaged" in own:
            own = _merge(read_packaged(own.pop("packaged"), f"{path}.packaged"), own)
        return super().read(own, path)

    @raises_first
    def check(self, path: str) -> Iterator[Check]:
        lowest = self.level.lowest if self.level else 0.0
        yield (
            self.depth + lowest <= 0.0,
            f"{path}.level: falls to {lowest:.4g} m, below the seabed; allowed: above {-self.depth:g} m",
        )
        reference = 0.0
        if self.current is not None and self.current.reference is not None:
            reference = float(self.current.reference)
        yield (
            0.0 < self.depth + lowest <= -reference,
            f"{path}.current.reference: {reference} is not above the seabed; allowed: above {-self.depth - lowest:g} m",
        )
        yield (
            self.wave_current != "none" and (self.waves is None or self.current is None),
            f"{path}.wave_current: {self.wave_current!r} needs waves and a current; allowed: none",
        )
        yield (
            self.waves is not None and not self.gravity > 0.0,
            f"{path}.gravity: {self.gravity} makes no waves; allowed: > 0 m/s^2 with [sea.waves]",
        )
        theory = self.waves.theory if self.waves else "linear"
        for key, what, allowed in (("wave_current", "action", "none, doppler"), ("interpolation", "grid", "none")):
            yield (
                theory != "linear" and getattr(self, key) == what,
                f"{path}.{key}: {what!r} cannot be combined with waves of theory {theory!r}; allowed: {allowed}",
            )


def _merge(base: Values, over: Values) -> Table:
    """`over` merged into `base`, except tables whose kind changes."""
    merged = {**base, **over}
    for key in base.keys() & over.keys():
        old = base[key]
        new = over[key]
        if isinstance(new, Mapping) and isinstance(old, Mapping) and new.get("kind") in (None, old.get("kind")):
            merged[key] = {**old, **new}
    return merged


#: Folder of the packaged seas.
SEAS = resources.files("dropper_jax") / "data" / "seas"


def sea_names() -> tuple[str, ...]:
    """Names of the packaged seas."""
    names = names_of(SEAS.iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def read_packaged(name: Plain, path: str) -> Table:
    """The table of a packaged sea; its component file is next to it."""
    name = read_text(name, path)
    known = sea_names()
    if name not in known:
        raise SceneError(f"{path}: {name!r} is not a packaged sea; {nearest(name, known)}")
    table = tomllib.loads((SEAS / f"{name}.toml").read_text(encoding="utf-8"))
    table.pop("description")
    if "file" in table.get("waves", {}):
        table["waves"]["file"] = str(SEAS / table["waves"]["file"])
    return table
