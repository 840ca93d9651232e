"""`[sea.waves]` of a scene, validated. Files are read here, so that a scene is self-contained."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from dropper_jax.base.errors import Check, SceneError
from dropper_jax.base.fields import option, parameter
from dropper_jax.base.read import (
    DeclaredSection,
    Plain,
    Table,
    as_table,
    check_kind_keys,
    plain,
    read_fields,
    read_table,
    short_text,
)
from dropper_jax.base.read import count as whole_number
from dropper_jax.base.records import select_keys, without_none
from dropper_jax.base.references import find_referenced
from dropper_jax.sea.spectrum import SHAPES
from dropper_jax.sea.steady import CRITERIA, THEORIES
from dropper_jax.sea.wave_files import read_components, read_elevation

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

    def checks(self) -> Iterator[Check]:
        needed = NEEDED[self.kind]
        for key in needed:
            other = REPLACEMENTS[key] if self.kind == "regular" else key
            is_given = getattr(self, key) is not None
            other_is_given = getattr(self, other) is not None
            yield (
                not (is_given or other_is_given),
                f"{key}: missing; kind {self.kind!r} needs {' and '.join(needed)}",
            )
            yield (
                other != key and is_given and other_is_given,
                f"{other}: cannot be combined with `{key}`; allowed: one of the two",
            )
        theory = self.theory
        yield (
            self.order is not None and theory != "stream",
            f"order: {self.order} is not used by theory {theory!r}; allowed: with 'stream'",
        )
        yield (
            self.current_criterion != "euler" and theory == "linear",
            "current_criterion: 'stokes' is not used by theory 'linear'; allowed: with stokes5, stream, auto",
        )
        yield (
            theory != "linear" and self.amplitude is not None and not np.all(np.asarray(self.amplitude) > 0.0),
            f"amplitude: {short_text(plain(self.amplitude))} is not a wave; allowed: > 0 m with theory {theory!r}",
        )
        given = without_none(select_keys(vars(self), ("amplitude", "period", "phase", "direction")))
        count = 1
        allowed = "one number"
        if self.kind not in ("regular", "spectrum"):
            count = max(map(np.size, given.values()))
        if count != 1:
            allowed = f"{count}, one per component"
        for key, value in given.items():
            size = np.size(value)
            yield (
                size != count and (size != 1 or key in ("amplitude", "period")),
                f"{key}: {short_text(plain(value))} has {size} entries; allowed: {allowed}",
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
