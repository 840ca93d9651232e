"""What stands before any estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dropper_jax.load.scene import Scene
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import Starts, Windows
from fitting.parameters.parameter import Parameter
from fitting.traces.trace import Trace


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

    @property
    def values(self) -> np.ndarray:
        """Start values (k,)."""
        return np.array([p.value for p in self.parameters])
