"""Load cases of a site, and their runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dropper_jax.base.read import Table
from fitting.farm.site.sections import SeaState
from fitting.farm.site.states import BROKEN, INTACT, Break


@dataclass(frozen=True)
class Storm:
    """A load case without its seed.

    Attributes:
        number: from 0.
        direction: of the waves [rad]; `level`: of the tide [m].
        current: table of `[sea.current]`, None for that of the scene.
        current_name, month: names; month None for the bare scene.
        broken: the line that breaks; None for the intact farm.
        crop: which values of `[crop]`; None for those of the scene.
        periods: return periods of waves and current, as texts; None where they are not given.
    """

    number: int
    sea_state: SeaState
    direction: float
    current: Table | None
    current_name: str | None
    level: float
    month: str | None
    broken: Break | None
    crop: str | None = None
    periods: tuple[str | None, str | None] = (None, None)

    @property
    def state(self) -> str:
        """`intact`, or the name of the broken line."""
        if self.broken is None:
            return INTACT
        return self.broken.name

    @property
    def kind(self) -> str:
        """`intact` or `broken`: selects the factor."""
        return INTACT if self.broken is None else BROKEN

    @property
    def heading(self) -> float | None:
        """Direction of the current [rad]; None for that of the scene."""
        return None if self.current is None else self.current["direction"]

    @property
    def still(self) -> tuple[object, ...]:
        """The values that the equilibrium depends on."""
        return self.current_name, self.heading, self.level, self.month, self.crop

    @property
    def name(self) -> str:
        """A short label."""
        parts = [self.sea_state.name, f"{np.degrees(self.direction):g} deg", self.current_name]
        if self.level:
            parts.append(f"level {self.level:+g} m")
        parts.append(self.month)
        if self.crop:
            parts.append(f"crop {self.crop}")
        if self.broken is not None:
            parts.append(f"{self.state} broken")
        return ", ".join(filter(None, parts))


@dataclass(frozen=True)
class Case:
    """A run: a load case with a seed."""

    storm: Storm
    seed: int


def name_waters(storms: Sequence[Storm]) -> list[str]:
    """Names of the equilibria of load cases: current and level, and what else differs between them."""
    names = [f"{storm.current_name or ''} level {storm.level:+g} m".strip() for storm in storms]
    headings = ["" if storm.heading is None else f"{np.degrees(storm.heading):g} deg" for storm in storms]
    for values in (headings, [storm.month for storm in storms], [storm.crop for storm in storms]):
        if len(set(values)) > 1:
            names = [f"{name} {value}" for name, value in zip(names, values, strict=True)]
    return names
