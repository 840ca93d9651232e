"""Damping laws for comparison with a fit: subsets of one full set of coefficients."""

from __future__ import annotations

from itertools import combinations

#: Every damping coefficient that a law may use.
PARTS = {
    "linear": "effects.linear_damping.b_l",
    "quadratic": "effects.quadratic_damping.b_q",
    "joint viscous": "effects.joint_friction.viscous",
    "dry": "effects.joint_friction.dry",
}
#: Coefficients of friction in the joints, each a list if joints have separate values.
OF_JOINTS = ("joint viscous", "dry")


def _join_names(parts: tuple[str, ...]) -> str:
    return " + ".join(parts) or "none"


#: Every law: name and parts, the simplest first, each after all laws that it contains.
LADDER = {_join_names(parts): parts for size in range(len(PARTS) + 1) for parts in combinations(PARTS, size)}


def contains(law: str, other: str) -> bool:
    """Whether `law` has all parts of `other`, and more."""
    return set(LADDER[law]) > set(LADDER[other])
