"""Settings of the report; every value is printed with the report."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from dropper_jax.base.errors import SceneError
from dropper_jax.base.read import Table, limits


def _setting(meaning: str, unit: str, default: float | None, positive: bool = False) -> Any:
    """Declare a number that is at least 0, or above it if `positive`."""
    low = "low"
    if positive:
        low = "above"
    return dataclasses.field(default=default, metadata={"meaning": meaning, "unit": unit, low: 0.0})


@dataclasses.dataclass(frozen=True)
class Settings:
    """Thresholds and curve parameters. `None` is a value relative to the run, given in its meaning."""

    skip: float = _setting("time left out at the start", "s", 0.0)
    slack: float | None = _setting(
        "a link is slack below this tension; none: 0.1 times its mean, 0 if rigid", "N", None
    )
    slack_time: float = _setting("minimum time below it", "s", 0.1)
    snap: float | None = _setting(
        "tension above which slack is followed by a snap; none: twice the mean of the link", "N", None, positive=True
    )
    breaking_load: float | None = _setting("breaking load of lines without their own", "N", None, positive=True)
    safety_factor: float = _setting(
        "factor on the maximum tension in the utilisation with a factor", "-", 1.67, positive=True
    )
    curve_k: float | None = _setting(
        "K of the T-N curve N = K (range/breaking load)^-m; without it damage is not computed", "-", None, positive=True
    )
    curve_m: float = _setting("m of the T-N curve", "-", 3.0, positive=True)
    contact: float = _setting("a node within this distance of the seabed is on it", "m", 0.01)
    storm: float = _setting("duration of the storm of the extremes", "s", 10800.0, positive=True)
    confidence: float = _setting("confidence level of the interval of the extremes", "-", 0.9)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is None:
                continue
            inside = value > 0.0 or (value == 0.0 and "low" in field.metadata)
            if not (inside and math.isfinite(value)):
                allowed = f"a number {limits(field.metadata)}"
                raise SceneError(f"{option_of(field)}: {value:g} is out of range; allowed: {allowed}")
        if not 0 < self.confidence < 1:
            raise SceneError(f"--confidence: {self.confidence:g} is out of range; allowed: above 0 and below 1")
        if self.slack is not None and self.snap is not None and self.snap <= self.slack:
            raise SceneError(f"--snap: {self.snap:g} is not above --slack, {self.slack:g} N; allowed: more than that")

    def table(self) -> Table:
        """Values with meaning and unit, by name."""
        found = {}
        for field in dataclasses.fields(self):
            found[field.name] = {
                "value": getattr(self, field.name),
                "unit": field.metadata["unit"],
                "meaning": field.metadata["meaning"],
            }
        return found


def option_of(setting: dataclasses.Field) -> str:
    """The option of the command line that gives a setting."""
    return f"--{setting.name.replace('_', '-')}"


#: Settings of a report for which none are given.
DEFAULTS = Settings()
