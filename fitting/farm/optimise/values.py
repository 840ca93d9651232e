"""Values of a design: objective and constraints, their derivatives, and which constraints are active."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

#: Distance from its limit up to which a constraint is active.
NEAR_LIMIT = 0.03


@dataclass(frozen=True)
class Values:
    """Objective and constraints of a design; a constraint is met if it is at most 1.

    Attributes:
        objective, slope: and its derivative by variables and assumptions (p + a,).
        names: of the constraints; `value` (m,), `slopes` (m, p + a).
        solved: whether all runs were.
        by_seed: by constraint on a storm, derivatives of the seeds (n, p + a); their mean is that of the constraint.
    """

    objective: float
    slope: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    slopes: np.ndarray
    solved: bool = True
    by_seed: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def worst(self) -> float:
        """The largest constraint."""
        return np.max(self.value, initial=-np.inf)


def active_constraints(values: Values, limit: float) -> np.ndarray:
    """Numbers of the constraints that count as active: within `NEAR_LIMIT` of their limit, or beyond."""
    return np.flatnonzero(values.value >= limit - NEAR_LIMIT)


class Dominated(NamedTuple):
    """Derivative of a constraint that one seed dominates [1 per unit of the variable]; `seed` counts from 0."""

    constraint: str
    variable: int
    seed: int
    mean: float
    median: float


def dominated_slopes(values: Values, span: np.ndarray, limit: float) -> list[Dominated]:
    """Derivatives of constraints near their limit that one seed moves by more than a quarter of their size.

        max_i |d_i - median(d)| / n > 0.25 max(|mean(d)|, |median(d)|)

    A seed whose peak occurs as a rope becomes taut has such a derivative. Fewer than three seeds have no median.

    Args:
        span: range of each variable (p,); those with less than 5 % of a constraint's largest derivative are left out.
    """
    found = []
    for name in (values.names[i] for i in active_constraints(values, limit)):
        rows = values.by_seed.get(name, np.zeros((0, len(span))))[:, : len(span)]
        if len(rows) < 3:
            continue
        mean = rows.mean(axis=0)
        median = np.median(rows, axis=0)
        size = np.maximum(np.abs(mean), np.abs(median))
        off = np.abs(rows - median)
        seed = off.argmax(axis=0)
        dominated = (off.max(axis=0) / len(rows) > 0.25 * size) & (size * span > 0.05 * np.max(size * span))
        for k in np.flatnonzero(dominated):
            found.append(Dominated(name, k, seed[k], mean[k], median[k]))
    return found
