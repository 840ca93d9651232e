"""A damping law that a fit was compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Law:
    """One rung: a damping law, its coefficients (each as many as joints or links have their own), how well it does.

    Attributes:
        held_out: RMS angle error [rad] of windows predicted from others, with the standard error of its difference to
            that of the best law.
        free: parameters fitted, those of no damping law too.
        bic: less is better.
        cost: minus the log likelihood of the fitted windows, in units of independent samples.
        unreached: what the fit's own model would gain still, in log likelihood: much where dry joints make the cost
            rough, and steps that should lower it do not.
        joined: the same with windows joined, of laws that separate windows leave undecided; else NaN.
        score, score_error: log score of windows predicted from others, less that of the best law, and its standard
            error.
        extrapolated: RMS angle error [rad] of the last third of every run, predicted from what comes before.
        other_run: the same of every run, predicted from the others; NaN where there is one.
        share: weight of the law among all, by its log scores.
        equals: laws that give the same motion, left out.
        unseen: parts of it that may take a tenth of the energy for all that the traces tell, shown or not.
        refuted: why the law was left behind, or "".
        chosen: the simplest law that nothing speaks against; alone where the traces decide.
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
    cost: float = np.nan
    unreached: float = 0.0
    joined: float = np.nan
    score: float = np.nan
    score_error: float = np.nan
    extrapolated: float = np.nan
    other_run: float = np.nan
    share: float = np.nan
    equals: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    refuted: str = ""
    chosen: bool = False

    @property
    def possible(self) -> bool:
        """Whether nothing speaks against the law."""
        return not self.refuted

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        keys = (
            "name",
            "coefficients",
            "rms",
            "held_out",
            "held_out_error",
            "bic",
            "status",
            "values",
            "chosen",
            "cost",
            "unreached",
            "joined",
            "score",
            "score_error",
            "extrapolated",
            "other_run",
            "share",
            "equals",
            "unseen",
            "refuted",
            "possible",
        )
        found = {key: getattr(self, key) for key in keys}
        return {key: None if isinstance(x, float) and not np.isfinite(x) else x for key, x in found.items()}
