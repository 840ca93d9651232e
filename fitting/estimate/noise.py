"""The noise of traces: its size, its memory, and delays of whole frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.estimate.windows import Windows
from fitting.traces.trace import Trace, smooth

#: Half width [s] of the smoother that tells rates from a trace.
SMOOTH = 0.05


@dataclass(frozen=True)
class Noise:
    """The noise of R runs of n links.

    Attributes:
        factor: deviation over the one that the traces claim (R, n).
        decay: rate at which it forgets itself (R, n) [1/s]; infinite where it is white.
        delay: deviation of the frames' delays (R,) [s].
    """

    factor: np.ndarray
    decay: np.ndarray
    delay: np.ndarray

    @classmethod
    def claimed(cls, runs: int, links: int) -> Noise:
        """What the traces claim."""
        return cls(np.ones((runs, links)), np.full((runs, links), np.inf), np.zeros(runs))

    @property
    def kind(self) -> str:
        """`white`, `correlated` or `jitter`."""
        return "correlated" if np.isfinite(self.decay).any() else "jitter" if self.delay.any() else "white"

    def put(self, windows: Windows, traces: Sequence[Trace]) -> Windows:
        """Windows of the claimed noise with this one."""
        run = windows.run
        weight = windows.weight / self.factor[run][:, None, :]
        decay = self.decay[run] if np.isfinite(self.decay).any() else None
        jitter = weight * self.delay[run][:, None, None] * rates(windows, traces) if self.delay.any() else None
        return replace(windows, weight=weight, decay=decay, jitter=jitter)

    def apart(self, other: Noise) -> float:
        """Largest relative difference of two noises' parts."""
        share = lambda a, b: np.max(np.abs(np.log((a + 1e-9) / (b + 1e-9))), initial=0.0)  # noqa: E731
        memory = np.max(np.abs(kept(self.decay) - kept(other.decay)), initial=0.0)
        return float(max(share(self.factor, other.factor), memory, 0.5 * share(self.delay, other.delay)))


def kept(decay: np.ndarray) -> np.ndarray:
    """Share of its noise that a sample hands on to one a sixtieth of a second later."""
    return np.exp(-decay / 60.0)


def rates(windows: Windows, traces: Sequence[Trace]) -> np.ndarray:
    """Rates of the links at the windows' samples (K, S, n) [rad/s], from smoothed traces."""
    found = np.zeros_like(windows.theta)
    t = windows.times()
    for run in np.unique(windows.run):
        trace, mine = traces[run], windows.run == run
        even = np.arange(trace.t[0], trace.t[-1], trace.interval)
        reach = 2 * max(2, round(SMOOTH / trace.interval)) + 1
        rate = smooth(trace.at(even), min(reach, 2 * ((len(even) - 1) // 2) + 1), trace.interval)[1]
        for j, column in enumerate(rate.T):
            found[mine, :, j] = np.interp(t[mine], even, column)
    return np.where(windows.weight > 0, found, 0.0)
