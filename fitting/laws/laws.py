"""Damping laws: every subset of linear drag, quadratic drag, viscous and dry friction in the joints.

A law is named by its parts, such as `linear + dry`. Coefficients outside it are zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dropper_jax.base.json_values import Json, jsonable

#: Paths of the coefficients of linear and of quadratic drag.
DRAG_PATHS = ("effects.linear_damping.b_l", "effects.quadratic_damping.b_q")
#: Parts of a law, and the path of the coefficient of each.
LAW_PARTS = {
    "linear": DRAG_PATHS[0],
    "quadratic": DRAG_PATHS[1],
    "joint viscous": "effects.joint_friction.viscous",
    "dry": "effects.joint_friction.dry",
}
#: Parts that are friction in the joints; their coefficient is a list where joints have separate values.
JOINT_PARTS = ("joint viscous", "dry")
#: Parts of every law by its name, the simplest first, each after all laws that it contains.
LAWS: dict[str, tuple[str, ...]] = {}
for size in range(len(LAW_PARTS) + 1):
    for parts in combinations(LAW_PARTS, size):
        LAWS[" + ".join(parts) or "none"] = parts


def part_of(name: str) -> str | None:
    """The part of a damping law that a parameter of this name belongs to."""
    return next((part for part, path in LAW_PARTS.items() if name.startswith(path)), None)


def contains(law: str, other: str) -> bool:
    """Whether `law` has all parts of `other`, and more."""
    return set(LAWS[law]) > set(LAWS[other])


def has_dry_friction(law: str) -> bool:
    """Whether a law has dry friction, for which it is fitted by another scheme."""
    return "dry" in LAWS[law]


@dataclass(frozen=True)
class Law:
    """A damping law of a comparison: its fit and its scores.

    Attributes:
        name: key of `LAWS`.
        coefficients: number of its coefficients, one per joint where joints have separate ones.
        rms: RMS angle error [rad] of the fitted windows.
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

    def to_json(self) -> Json:
        """Plain values."""
        found = {**vars(self), "possible": self.possible}
        del found["free"]
        return jsonable(found)
