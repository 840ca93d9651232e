"""What stands before any estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dropper_jax.load.scene import Scene
from fitting.estimate.loss import LEAST_SQUARES, Loss
from fitting.estimate.problem import Problem
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.traces.trace import Trace

#: Half width of the smoother for the starts, as a part of the shortest link's period.
SMOOTH_PART = 0.12


@dataclass(frozen=True)
class Prepared:
    """Everything an estimator needs: what `prepare` made of the caller's input."""

    scene: Scene
    traces: list[Trace]
    sigma: list[np.ndarray]
    parameters: tuple[Parameter, ...]
    simulator: Simulator
    windows: Windows
    starts: Starts
    held_out: tuple[tuple[float, float], ...]
    lyapunov: float
    period: float
    warnings: tuple[str, ...]
    begun: float = 0.0
    compiled_before: float = 0.0

    def problem(self, loss: Loss = LEAST_SQUARES, frozen: np.ndarray | None = None) -> Problem:
        """What there is to minimise."""
        return Problem(self.simulator, self.windows, self.parameters, loss, frozen)

    @property
    def smooth(self) -> float:
        """Half width [s] of the smoother for the starts."""
        return SMOOTH_PART * self.period

    @property
    def values(self) -> np.ndarray:
        """Start values (k,)."""
        return np.array([p.value for p in self.parameters])
