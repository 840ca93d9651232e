"""A damping law that a fit was compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Law:
    """One rung: a damping law, its coefficients (each as many as joints or links have their own), how well it does.

    Attributes:
        held_out: RMS angle error [rad] of the windows that were not fitted, with its standard error.
        free: parameters fitted, those of no damping law too.
        bic: less is better; `chosen` marks the simplest law within one standard error of the best held-out score.
    """

    name: str
    coefficients: int
    rms: float
    held_out: float
    held_out_error: float
    status: str
    values: dict[str, float]
    free: int
    bic: float = np.nan
    chosen: bool = False

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        keys = ("name", "coefficients", "rms", "held_out", "held_out_error", "bic", "status", "values", "chosen")
        return {key: getattr(self, key) for key in keys}
