"""`[optimise]` of a site: settings of the search for a design."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dropper_jax.base.errors import Check
from dropper_jax.base.fields import parameter
from dropper_jax.base.read import DeclaredSection
from dropper_jax.base.read import count as whole_number

#: Time [s] in which the waves of a window rise; it is not counted.
WINDOW_RAMP = 10.0


@dataclass(frozen=True)
class SearchSettings(DeclaredSection):
    """Values of `[optimise]`, settings of the search for a design.

    window = 60.0           [s] of each storm with derivatives; `before` = 45.0 of it before the peak load
    renew = 3               steps after which windows and factors are updated from whole runs
    rounds = 8              maximum number of such rounds; the search ends if a round gains less than `enough` = 0.003
    reach = 0.15            fraction of its range that a variable may move in the first step
    margin = 0.01           distance of constraints from their limits
    """

    window: float = parameter("length of a window", unit="s", above=0.0, default=60.0)
    before: float = parameter("part of it before the peak load", unit="s", low=0.0, default=45.0)
    renew: int = whole_number("steps until windows are updated", default=3)
    rounds: int = whole_number("maximum number of rounds", default=8)
    enough: float = parameter("minimum relative gain of a round", unit="-", low=0.0, default=0.003)
    reach: float = parameter("first reach of a step", unit="-", above=0.0, high=1.0, default=0.15)
    margin: float = parameter("below the limits", unit="-", low=0.0, high=0.5, default=0.01)

    def checks(self) -> Iterator[Check]:
        yield (
            not WINDOW_RAMP < self.before <= self.window,
            f"before: {self.before:g} s; allowed: more than the {WINDOW_RAMP:g} s in which waves rise, up to "
            f"the window of {self.window:g} s",
        )
