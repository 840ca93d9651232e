"""`[sea]` of a scene, validated, and the packaged seas."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources

from dropper_jax.base.constants import GRAVITY, SEA_WATER
from dropper_jax.base.errors import Check, SceneError, nearest
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import DeclaredSection, Plain, Table, Values, part, read_table, read_text
from dropper_jax.base.records import names_of
from dropper_jax.sea.current_spec import CurrentSpec, LevelSpec
from dropper_jax.sea.wave_spec import WaveSpec
from dropper_jax.sea.waves import STRETCHING


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

    def checks(self) -> Iterator[Check]:
        lowest = self.level.lowest if self.level else 0.0
        yield (
            self.depth + lowest <= 0.0,
            f"level: falls to {lowest:.4g} m, below the seabed; allowed: above {-self.depth:g} m",
        )
        reference = 0.0
        if self.current is not None and self.current.reference is not None:
            reference = float(self.current.reference)
        yield (
            0.0 < self.depth + lowest <= -reference,
            f"current.reference: {reference} is not above the seabed; allowed: above {-self.depth - lowest:g} m",
        )
        yield (
            self.wave_current != "none" and (self.waves is None or self.current is None),
            f"wave_current: {self.wave_current!r} needs waves and a current; allowed: none",
        )
        yield (
            self.waves is not None and not self.gravity > 0.0,
            f"gravity: {self.gravity} makes no waves; allowed: > 0 m/s^2 with [sea.waves]",
        )
        theory = self.waves.theory if self.waves else "linear"
        for key, what, allowed in (("wave_current", "action", "none, doppler"), ("interpolation", "grid", "none")):
            yield (
                theory != "linear" and getattr(self, key) == what,
                f"{key}: {what!r} cannot be combined with waves of theory {theory!r}; allowed: {allowed}",
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
