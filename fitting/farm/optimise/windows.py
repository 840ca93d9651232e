"""Windows of load cases that a search uses, and their runs for a design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fitting.farm.optimise.window_peaks import Peaks
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


@dataclass(frozen=True)
class WindowRuns:
    """Runs of the windows of a design.

    Attributes:
        x: the design (p,).
        factors: ratio of the whole run's hard peaks to the soft ones, for each window (q,).
        windows: one of each case.
        slopes: derivatives of `peaks` by variables and assumptions, for each case (q, p + a); empty if unknown.
    """

    x: np.ndarray
    factors: Sequence[np.ndarray]
    windows: Sequence[Peaks]
    slopes: Sequence[np.ndarray] = ()

    @property
    def peaks(self) -> list[np.ndarray]:
        """Peaks of whole runs as the windows predict them, for each case (q,)."""
        return [window.soft * factor for window, factor in zip(self.windows, self.factors, strict=True)]

    @property
    def solved(self) -> bool:
        """Whether every step of every window was."""
        return all(window.solved for window in self.windows)
