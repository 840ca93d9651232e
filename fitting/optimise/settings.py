"""`[optimise]`: settings of the search for a design.

window = 60.0           [s] of each storm with derivatives; `before` = 45.0 of it before the peak load
renew = 3               steps after which windows and factors are updated from whole runs
rounds = 8              maximum number of such rounds; the search ends if a round gains less than `enough` = 0.003
reach = 0.15            fraction of its range that a variable may move in the first step
margin = 0.01           distance of constraints from their limits
"""

from __future__ import annotations

import dataclasses

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import parameter
from dropper_jax.base.read import Plain, read_fields, read_table
from dropper_jax.base.read import count as whole_number
from fitting.optimise.storm import RAMP


@dataclasses.dataclass(frozen=True)
class Settings:
    """Values of `[optimise]`."""

    window: float = parameter("length of a window", unit="s", low=0.0, open_low=True, default=60.0)
    before: float = parameter("part of it before the peak load", unit="s", low=0.0, default=45.0)
    renew: int = whole_number("steps until windows are updated", default=3)
    rounds: int = whole_number("most rounds", default=8)
    enough: float = parameter("minimum relative gain of a round", unit="-", low=0.0, default=0.003)
    reach: float = parameter("first reach of a step", unit="-", low=0.0, open_low=True, high=1.0, default=0.15)
    margin: float = parameter("below the limits", unit="-", low=0.0, high=0.5, default=0.01)

    @classmethod
    def read(cls, table: Plain) -> Settings:
        """Checked values.

        Raises:
            SceneError: a value out of range, or a window that is filled by its ramp.
        """
        found = cls(**read_fields(cls, dict(read_table(table, "optimise")), "optimise", {}))
        if not RAMP < found.before <= found.window:
            raise SceneError(
                f"optimise.before: {found.before:g} s; allowed: more than the {RAMP:g} s in which waves rise, up to "
                f"the window of {found.window:g} s"
            )
        return found
