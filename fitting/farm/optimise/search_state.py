"""State of a search for a design."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dropper_jax.base.read import Table


@dataclass(frozen=True)
class Start:
    """The design at the start (p,): its objective, and its constraints by name, both of whole runs."""

    x: list[float]
    objective: float
    constraints: dict[str, float]


@dataclass
class Search:
    """State of the search; everything that a restart needs.

    Attributes:
        x: the design (p,); `reach`: largest fraction of the ranges by which a step moves it; `round`: rounds done.
        scale: objective at the start.
        best: the best design whose whole runs meet all constraints, and its objective; None before the first one.
        fixed: variables that have been set to a size of their catalogue (p,); `sized`: rounds done by then.
        history: one row per evaluation.
        residual: maximum difference of the last windows' constraints from those of whole runs, in limits, before
            windows and factors were updated; None before the first time. `best_residual`: of the best design.
    """

    x: np.ndarray
    reach: float
    scale: float = 0.0
    round: int = 0
    best: np.ndarray | None = None
    best_objective: float = np.inf
    before: Start | None = None
    fixed: np.ndarray | None = None
    sized: int = 0
    history: list[Table] = field(default_factory=list)
    done: bool = False
    residual: float | None = None
    best_residual: float | None = None
