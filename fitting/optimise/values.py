"""Values of a design, and what they are found from: windows of storms, and where runs begin."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from fitting.optimise.models import Still
from fitting.optimise.rest import Rest
from fitting.site import Case


@dataclasses.dataclass(frozen=True)
class Window:
    """Where in a case the optimiser looks.

    Attributes:
        begin: [s].
        factor: from its soft peaks to the whole run's hard ones (q,); height: that sizes the soft peaks (q,).
        polished: whether a line that breaks is gone from the begin on.
    """

    case: Case
    begin: float
    factor: np.ndarray
    height: np.ndarray
    polished: bool = False


class RunStart(NamedTuple):
    """Where a run begins: calm model with its slopes, pose at rest, what a window with a broken line goes on with."""

    still: Still
    rest: Rest
    after: Still | None = None


@dataclasses.dataclass(frozen=True)
class Values:
    """Objective and constraints of a design; a constraint is met where it is at most 1.

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
