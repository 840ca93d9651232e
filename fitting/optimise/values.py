"""Values of a design, and their inputs: windows of storms, and the starts of runs."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from fitting.optimise.models import Still
from fitting.optimise.rest import Rest
from fitting.site import Case


@dataclasses.dataclass(frozen=True)
class Window:
    """Window of a case used by the optimiser.

    Attributes:
        begin: [s].
        factor: ratio of the whole run's hard peaks to its soft ones (q,); height: that sizes the soft peaks (q,).
        polished: whether a line that breaks is missing from the start on.
    """

    case: Case
    begin: float
    factor: np.ndarray
    height: np.ndarray
    polished: bool = False


class RunStart(NamedTuple):
    """Start of a run: calm model with its slopes, equilibrium, and the later model of a window with a broken line."""

    still: Still
    rest: Rest
    after: Still | None = None


@dataclasses.dataclass(frozen=True)
class Values:
    """Objective and constraints of a design; a constraint is met if it is at most 1.

    Attributes:
        objective, slope: and its derivative by variables and assumptions (p + a,).
        names: of the constraints; `value` (m,), `slopes` (m, p + a).
        solved: whether all runs were.
    """

    objective: float
    slope: np.ndarray
    names: tuple[str, ...]
    value: np.ndarray
    slopes: np.ndarray
    solved: bool = True

    @property
    def worst(self) -> float:
        return float(np.max(self.value, initial=-np.inf))
