"""Results of running all windows: angles, residuals, both ends, and their derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fitting.estimate.windows import Starts

#: Ratio to the median over windows with samples above which a window's derivative counts as undefined. A joint that is
#: just about to stick has no derivative (measured: 1e20), and one such window would block all parameters; chaos reaches
#: 400 at most.
WILD = 1e4


class Evaluation(NamedTuple):
    """All windows at one point; derivatives are by the chart coordinates z (m angles, m rates) and the parameters.

    Attributes:
        theta: simulated angles minus the camera's offset (K, S, n) [rad].
        residual: (simulated - measured)/sigma (K, S, n), 0 where there is no sample.
        jacobian: of `residual` (K, S, n, 2 m + k).
        start, end: angles and rates at both ends of each window (K, 2 n).
        start_jacobian, end_jacobian: (K, 2 n, 2 m + k).
        failed: steps above tolerance (K,).
    """

    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    start: np.ndarray
    end: np.ndarray
    start_jacobian: np.ndarray
    end_jacobian: np.ndarray
    failed: np.ndarray

    @property
    def starts(self) -> Starts:
        """The starts after closure by the simulator."""
        n = self.start.shape[1] // 2
        return Starts(self.start[:, :n], self.start[:, n:])


def drop_wild(e: Evaluation) -> Evaluation:
    """The evaluation, with zero derivative and one more failed step for windows whose derivative is undefined."""
    size = np.abs(e.jacobian).max(axis=(1, 2, 3), initial=0.0)
    moving = size[size > 0]  # windows without samples have no derivative
    wild = ~(size <= WILD * max(float(np.median(moving)) if len(moving) else 0.0, 1e-300))
    if not wild.any():
        return e
    keep = ~wild
    derivatives = ("jacobian", "start_jacobian", "end_jacobian")
    zeroed = {f: np.where(keep.reshape(-1, *[1] * (getattr(e, f).ndim - 1)), getattr(e, f), 0.0) for f in derivatives}
    return e._replace(failed=e.failed + wild, **zeroed)
