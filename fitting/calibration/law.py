"""A damping law that was compared with a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Law:
    """One rung of the ladder: a damping law, its number of coefficients (one per joint or link where separate), scores.

    Attributes:
        held_out: RMS angle error [rad] of windows predicted from others, with the standard error of its difference to
            that of the best law.
        free: fitted parameters, including those outside damping laws.
        bic: lower is better.
        cost: minus the log likelihood of the fitted windows, in units of independent samples.
        unreached: remaining gain in log likelihood predicted by the fit's own model; large if dry joints make the cost
            non-smooth, so that steps do not achieve the predicted decrease.
        joined: the cost with windows joined, of laws that separate windows leave undecided; otherwise NaN.
        score, score_error: log score of windows predicted from others, minus that of the best law, and its standard
            error.
        extrapolated: RMS angle error [rad] of the last third of every run, predicted from the first two.
        other_run: RMS angle error of every run predicted from the others; NaN if there is only one.
        share: weight of the law among all, by its log scores.
        equals: laws that give the same motion, left out.
        unseen: parts that may dissipate 10 % of the energy as far as the traces show, significant or not.
        refuted: the reason why the law was rejected, or "".
        chosen: the simplest law that is not refuted; it is the only one if the traces decide.
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
        """Whether the law is not refuted."""
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
