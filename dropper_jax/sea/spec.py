"""`[sea]`, `[sea.waves]` and `[sea.current]` of a scene, validated. Files are read here, so that a scene is
self-contained."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any, ClassVar

import numpy as np

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.files import find_referenced
from dropper_jax.base.read import Plain, as_table, plain, read_fields, read_table, read_text, refuse
from dropper_jax.base.read import count as whole_number
from dropper_jax.sea.spectrum import SHAPES
from dropper_jax.sea.steady import CRITERIA, THEORIES
from dropper_jax.sea.water import KINDS, check_constituents
from dropper_jax.sea.waves import STRETCHING, read_components, read_elevation

#: Alternative keys of a regular wave.
OR = {"amplitude": "height", "period": "length"}


@dataclasses.dataclass(frozen=True, eq=False)
class WaveSpec:
    """`[sea.waves]`: `regular`, `components` (listed or from a file), `spectrum`, or an `elevation` series (a file)."""

    FIELDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "regular": (
            *("amplitude", "height", "period", "length", "phase", "direction"),
            *("theory", "order", "current_criterion"),
        ),
        "components": ("amplitude", "period", "phase", "direction", "file"),
        "spectrum": (
            *("spectrum", "hs", "tp", "gamma", "count", "frequencies", "spreading", "directions", "seed"),
            "direction",
        ),
        "elevation": ("file", "direction"),
    }

    kind: str = option("how the waves are given", choices=tuple(FIELDS))
    amplitude: Any = parameter("amplitude", unit="m", shape="numbers", low=0.0, optional=True)
    period: Any = parameter("period", unit="s", shape="numbers", low=0.0, open_low=True, optional=True)
    phase: Any = parameter("phase", unit="rad", shape="numbers", default=0.0)
    direction: Any = parameter(
        "direction of travel, +x towards +y", unit="rad", shape="numbers", low=-6.29, high=6.29, default=0.0
    )  # up to a turn: larger numbers are degrees
    file: str | None = option("CSV file", type=str, default=None)
    spectrum: str = option("shape", choices=SHAPES, default="jonswap")
    hs: float | None = parameter("significant wave height", unit="m", low=0.0, optional=True)
    tp: float | None = parameter("peak period", unit="s", low=0.0, open_low=True, optional=True)
    gamma: float = parameter("peak factor", unit="-", low=1.0, default=3.3)
    count: int = whole_number("number of frequencies", default=200)
    frequencies: str = option(
        "how they are chosen", choices=("equal_energy", "equal_frequency", "even"), default="equal_energy"
    )
    spreading: float | None = parameter("s of cos^2s spreading", unit="-", low=0.0, optional=True)
    directions: int = whole_number("directions per frequency", default=1)
    seed: int = whole_number("seed of the phases", low=0, default=0)
    height: float | None = parameter("trough to crest", unit="m", low=0.0, open_low=True, optional=True)
    length: float | None = parameter("wavelength", unit="m", low=0.0, open_low=True, optional=True)
    theory: str = option("of a regular wave", choices=THEORIES, default="linear")
    order: int | None = whole_number("number of harmonics of the stream function", low=3, default=None)
    current_criterion: str = option(
        "mean velocity of the water that the current represents", choices=CRITERIA, default="euler"
    )

    @classmethod
    def read(cls, table: Plain, path: str) -> WaveSpec:
        values = read_fields(cls, table, path, {})
        kind = values["kind"]
        for key in table:
            if key != "kind" and key not in cls.FIELDS[kind]:
                raise SceneError(f"{path}.{key}: not used by kind {kind!r}, which takes {', '.join(cls.FIELDS[kind])}")
        if values["file"] is not None:
            values.update(_from_file(values, path))
        needed = {"spectrum": ("hs", "tp"), "elevation": ("file",)}.get(values["kind"], ("amplitude", "period"))
        for key in needed:
            instead = OR.get(key) if kind == "regular" else None
            if values[key] is None and (instead is None or values[instead] is None):
                raise SceneError(f"{path}.{key}: missing; kind {kind!r} needs {' and '.join(needed)}")
            if instead is not None and values[key] is not None and values[instead] is not None:
                raise SceneError(f"{path}.{instead}: cannot be combined with `{key}`; allowed: one of the two")
        _check_theory(values, path)
        _check_sizes(values, path)
        return cls(**values)

    @property
    def size(self) -> Any:
        """Amplitude [m], one or one per component, if it or the height is given."""
        return 0.5 * self.height if self.height is not None else self.amplitude

    def table(self) -> dict[str, Any]:
        kept = ("kind", *self.FIELDS[self.kind])
        # keys that linear waves do not have are written only if given
        plain_wave = {"theory": "linear", "current_criterion": "euler"}
        return {k: v for k, v in as_table(self).items() if k in kept and plain_wave.get(k) != v}


def _check_theory(values: dict[str, Any], path: str) -> None:
    """Check of keys that only some theories of regular waves accept."""
    theory = values["theory"]
    if values["order"] is not None and theory != "stream":
        raise SceneError(f"{path}.order: {values['order']} is not used by theory {theory!r}; allowed: with 'stream'")
    if values["current_criterion"] != "euler" and theory == "linear":
        raise SceneError(
            f"{path}.current_criterion: 'stokes' is not used by theory 'linear'; allowed: with stokes5, stream, auto"
        )
    if theory != "linear" and values["amplitude"] is not None and not np.all(np.asarray(values["amplitude"]) > 0.0):
        raise refuse(f"{path}.amplitude", plain(values["amplitude"]), "is not a wave", f"> 0 m with theory {theory!r}")


def _from_file(values: dict[str, Any], path: str) -> dict[str, Any]:
    """The components of the file instead of its name."""
    clash = [key for key in ("amplitude", "period") if values[key] is not None]
    if clash:
        raise SceneError(f"{path}.{clash[0]}: given twice, here and in the file; allowed: one of the two")
    read = read_elevation if values["kind"] == "elevation" else read_components
    return {"kind": "components", "file": None, **read(find_referenced(values["file"], f"{path}.file"), f"{path}.file")}


def _check_sizes(values: dict[str, Any], path: str) -> None:
    """Check that each key has one value or one per component; one value in a regular sea."""
    given = {key: values[key] for key in ("amplitude", "period", "phase", "direction") if values[key] is not None}
    sizes = {key: np.size(value) for key, value in given.items()}
    most = max(sizes.values())
    if values["kind"] in ("regular", "spectrum") and most > 1:
        key = max(sizes, key=sizes.get)
        raise refuse(f"{path}.{key}", plain(values[key]), f"has {most} entries", "one number")
    for key, size in sizes.items():
        if size not in (1, most) or (key in ("amplitude", "period") and size != most):
            raise refuse(f"{path}.{key}", plain(values[key]), f"has {size} entries", f"{most}, one per component")


@dataclasses.dataclass(frozen=True, eq=False)
class CurrentSpec:
    """`[sea.current]`: see `dropper_jax.sea.water.Current`."""

    speed: float = parameter("speed at the reference height", unit="m/s", default=0.0)
    direction: float = parameter("direction of flow, +x towards +y", unit="rad", low=-6.29, high=6.29, default=0.0)
    exponent: float | None = parameter("exponent of the power law", unit="-", low=0.0, optional=True)
    reference: float | None = parameter("height where the speed is given", unit="m", high=0.0, optional=True)
    heights: Any = parameter("heights of the table, rising", unit="m", shape="table", optional=True)
    velocities: Any = parameter("velocities at the heights", unit="m/s", shape="vectors", optional=True)
    time: Any = parameter("times of the factor", unit="s", shape="table", optional=True)
    factor: Any = parameter("factor at those times", unit="-", shape="table", optional=True)
    amplitude: Any = parameter("constituents of the factor", unit="-", shape="table", optional=True)
    period: Any = parameter("their periods", unit="s", shape="table", optional=True)
    phase: Any = parameter("their lags", unit="rad", shape="table", optional=True)
    veer: float | None = parameter("turn of the direction per metre down", unit="rad/m", optional=True)
    kind: str = option("profile over depth", choices=KINDS, default="uniform")

    @classmethod
    def read(cls, table: Plain, path: str) -> CurrentSpec:
        values = read_fields(cls, table, path, {})
        if values["kind"] == "power":
            values["exponent"] = 1.0 / 7.0 if values["exponent"] is None else values["exponent"]
            values["reference"] = values["reference"] or 0.0
        _check_pair(values, path, "heights", "velocities", values["kind"] == "table")
        _check_pair(values, path, "time", "factor", values["time"] is not None or values["factor"] is not None)
        check_constituents(values, path, ("amplitude", "period", "phase"))
        if values["time"] is not None and values["amplitude"] is not None:
            raise SceneError(f"{path}.amplitude: cannot be combined with `time`; allowed: one of the two")
        if values["veer"] is not None and values["kind"] == "table":
            raise SceneError(f"{path}.veer: given with kind 'table', which turns itself; allowed: uniform, power")
        return cls(**values)

    def table(self) -> dict[str, Any]:
        return as_table(self)


@dataclasses.dataclass(frozen=True, eq=False)
class LevelSpec:
    """`[sea.level]`: see `dropper_jax.sea.water.Level`."""

    offset: float = parameter("constant part", unit="m", default=0.0)
    time: Any = parameter("times of a table", unit="s", shape="table", optional=True)
    height: Any = parameter("heights at those times", unit="m", shape="table", optional=True)
    amplitude: Any = parameter("of constituents", unit="m", shape="table", optional=True)
    period: Any = parameter("their periods", unit="s", shape="table", optional=True)
    phase: Any = parameter("their lags", unit="rad", shape="table", optional=True)

    @classmethod
    def read(cls, table: Plain, path: str, depth: float) -> LevelSpec:
        values = read_fields(cls, table, path, {})
        _check_pair(values, path, "time", "height", values["time"] is not None or values["height"] is not None)
        check_constituents(values, path, ("amplitude", "period", "phase"))
        lowest = values["offset"] + (0.0 if values["height"] is None else float(np.min(values["height"])))
        lowest -= 0.0 if values["amplitude"] is None else float(np.sum(np.abs(values["amplitude"])))
        if depth + lowest <= 0.0:
            raise SceneError(f"{path}: falls to {lowest:.4g} m, below the seabed; allowed: above {-depth:g} m")
        return cls(**values)

    def table(self) -> dict[str, Any]:
        return as_table(self)


def _check_pair(values: dict[str, Any], path: str, axis: str, other: str, needed: bool) -> None:
    """Check two tables of equal length over a rising axis, both or none."""
    if not needed and values[axis] is None and values[other] is None:
        return
    a, b = values[axis], values[other]
    if a is None or b is None or not needed:
        raise SceneError(f"{path}: `{axis}` and `{other}` belong together (kind 'table' for heights); one is missing")
    if len(a) != len(b) or len(a) < 2 or np.any(np.diff(a) <= 0):
        raise SceneError(f"{path}.{axis}: needs at least 2 rising values, as many as `{other}`")


@dataclasses.dataclass(frozen=True, eq=False)
class SeaSpec:
    """`[sea]`: water below z = 0. `packaged` names a packaged sea, whose values the scene may override."""

    depth: float = parameter("depth of the water", unit="m", low=0.0, open_low=True)
    density: float = parameter("density of the water", unit="kg/m^3", low=0.0, open_low=True, default=SEA_WATER)
    gravity: float = parameter("acceleration of gravity", unit="m/s^2", low=0.0, default=GRAVITY)
    ramp: float | None = parameter("time to full waves", unit="s", low=0.0, open_low=True, optional=True)
    stretching: str = option("kinematics above the mean surface", choices=STRETCHING, default="wheeler")
    dispersion: str = option("wave numbers", choices=("exact", "fenton"), default="exact")
    wave_current: str = option("effect of a current on waves", choices=("none", "doppler", "action"), default="none")
    interpolation: str = option("how kinematics are computed", choices=("none", "grid"), default="none")
    waves: WaveSpec | None = None
    current: CurrentSpec | None = None
    level: LevelSpec | None = None

    @classmethod
    def read(cls, table: Plain, path: str) -> SeaSpec:
        own = dict(read_table(table, path))
        if "packaged" in own:
            own = _merge(read_packaged(own.pop("packaged"), f"{path}.packaged"), own)
        waves, current, level = (own.pop(key, None) for key in ("waves", "current", "level"))
        values = read_fields(cls, own, path, {})
        values["waves"] = None if waves is None else WaveSpec.read(read_table(waves, f"{path}.waves"), f"{path}.waves")
        values["current"] = None if current is None else CurrentSpec.read(current, f"{path}.current")
        values["level"] = None if level is None else LevelSpec.read(level, f"{path}.level", values["depth"])
        if values["wave_current"] != "none" and (waves is None or current is None):
            raise refuse(f"{path}.wave_current", values["wave_current"], "needs waves and a current", "none")
        if waves is not None and not values["gravity"] > 0.0:
            raise refuse(f"{path}.gravity", values["gravity"], "makes no waves", "> 0 m/s^2 with [sea.waves]")
        _check_finite_waves(values, path)
        return cls(**values)

    def table(self) -> dict[str, Any]:
        found = as_table(self)
        parts = {"waves": self.waves, "current": self.current, "level": self.level}
        return {**found, **{key: part.table() for key, part in parts.items() if part is not None}}


def _check_finite_waves(values: dict[str, Any], path: str) -> None:
    """Check of keys that cannot be combined with waves of finite height."""
    theory = "linear" if values["waves"] is None else values["waves"].theory
    if theory == "linear":
        return
    for key, what in (("wave_current", "action"), ("interpolation", "grid")):
        if values[key] == what:
            left = "none, doppler" if key == "wave_current" else "none"
            raise SceneError(
                f"{path}.{key}: {what!r} cannot be combined with waves of theory {theory!r}; allowed: {left}"
            )


def _merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """`over` merged into `base`, except tables whose kind changes."""
    merged = dict(base)
    for key, value in over.items():
        old = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        same = both and value.get("kind", old.get("kind")) == old.get("kind")
        merged[key] = {**old, **value} if same else value
    return merged


def _folder() -> Traversable:
    return resources.files("dropper_jax") / "data" / "seas"


def sea_names() -> tuple[str, ...]:
    """Names of the packaged seas."""
    return tuple(sorted(item.name.removesuffix(".toml") for item in _folder().iterdir() if item.name.endswith(".toml")))


def read_packaged(name: Plain, path: str) -> dict[str, Any]:
    """The table of a packaged sea; its component file is next to it."""
    name, known = read_text(name, path), sea_names()
    if name not in known:
        raise SceneError(f"{path}: {name!r} is not a packaged sea; {nearest(name, known)}")
    table = tomllib.loads((_folder() / f"{name}.toml").read_text())
    table.pop("description")
    if "file" in table.get("waves", {}):
        table["waves"]["file"] = str(_folder() / table["waves"]["file"])
    return table
