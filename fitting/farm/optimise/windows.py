"""Windows of load cases that a search uses, and the starts of their runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fitting.farm.optimise.equilibria import Rest
from fitting.farm.optimise.models import Still
from fitting.farm.site import Case


@dataclass(frozen=True)
class Window:
    """Window of a case used by the optimiser.

    Attributes:
        begin: [s].
        factor: ratio of the whole run's hard peaks to its soft ones (q,); height: that sizes the soft peaks (q,).
        starts_broken: whether a line that breaks is missing from the start on.
    """

    case: Case
    begin: float
    factor: np.ndarray
    height: np.ndarray | None = None
    starts_broken: bool = False


class RunStart(NamedTuple):
    """Start of a run: calm model with its slopes, equilibrium, and the later model of a window with a broken line."""

    still: Still
    rest: Rest
    after: Still | None = None
