"""Where the recordings of one motion disagree: mean deviations of each from the common motion, by stretches of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.estimate.solution import Solution
from fitting.windows.prepared import Prepared

#: Stretches of time in which deviations are averaged.
STRETCHES = 10
#: Standard errors of such a mean above which a recording disagrees: of normal noise one link in 170 000.
DISAGREEMENT_ERRORS = 5.0


@dataclass(frozen=True)
class Disagreement:
    """A link of a recording, and the stretch in which it is farthest from the motion, in its errors.

    Attributes:
        recording, link: name, and number from 1.
        samples: in all.
        rms, noise: of the deviations, and as estimated [rad].
        low, high: of the stretch [s].
        mean, std_error: of its readings minus the others' there [rad], each corrected for its zeros, scale and delay.
        stretches: number of the stretches in which it disagrees.
    """

    recording: str
    link: int
    samples: int
    rms: float
    noise: float
    low: float
    high: float
    mean: float
    std_error: float
    stretches: int

    @property
    def disagrees(self) -> bool:
        """Whether any stretch is too far off for chance."""
        return self.stretches > 0

    def __str__(self) -> str:
        return (
            f"{self.recording} disagrees with the others in {self.stretches} of {STRETCHES} stretches of link "
            f"{self.link}, most from {self.low:.3g} to {self.high:.3g} s: {self.mean:+.2g} +- {self.std_error:.1g} rad"
        )


@dataclass(frozen=True)
class Deviations:
    """Of one link of one recording: deviations (k,) from the motion and noise (k,) [rad]; by stretches (s,) the mean
    and its weight, the inverse of its variance, 0 without samples."""

    off: np.ndarray
    noise: np.ndarray
    mean: np.ndarray
    weight: np.ndarray


def deviations(solution: Solution, run: int, column: int, edges: np.ndarray) -> Deviations:
    """Measured minus simulated angles of a run's column, averaged between the edges (s + 1,) [s]."""
    windows = solution.windows
    known = (windows.run == run)[:, None] & (windows.weight[..., column] > 0)
    off = -solution.errors[..., column][known]
    noise = 1 / windows.weight[..., column][known]
    part = np.clip(np.searchsorted(edges, windows.times()[known], side="right") - 1, 0, STRETCHES - 1)
    count = np.bincount(part, minlength=STRETCHES)
    mean = np.bincount(part, off, STRETCHES) / np.maximum(count, 1)
    # jitter of frames is not in the weights, but in the scatter
    square = np.bincount(part, np.maximum((off - mean[part]) ** 2, noise**2), STRETCHES)
    number = np.maximum(count / solution.problem.memory, 1.0)  # correlated samples count as fewer
    weight = np.where(count > 1, number * count / np.maximum(square, 1e-300), 0.0)
    return Deviations(off, noise, mean, weight)


def disagreements(prepared: Prepared, solution: Solution) -> list[Disagreement]:
    """A row for every link of every recording; empty unless several recordings show one motion.

    A recording is compared with the others' mean of the same link and stretch: what all of them show is not theirs.
    """
    found = []
    for run, trace in enumerate(prepared.traces):
        edges = np.linspace(trace.t[0], trace.t[-1] + trace.interval, STRETCHES + 1)
        each = [deviations(solution, run, i, edges) for i in range(len(trace.recordings) * trace.links)]
        for i, mine in enumerate(each):
            if len(mine.off):
                recording, link = divmod(i, trace.links)
                rest = [one for one in each[link :: trace.links] if one is not mine]
                found.append(_row(trace.recordings[recording].name, link, mine, rest, edges))
    return found


def _row(name: str, link: int, mine: Deviations, rest: list[Deviations], edges: np.ndarray) -> Disagreement:
    """A link of a recording against the same link of the others."""
    others = sum((one.weight for one in rest), np.zeros(STRETCHES))
    total = sum((one.weight * one.mean for one in rest), np.zeros(STRETCHES))
    both = (mine.weight > 0) & (others > 0)
    others = np.where(both, others, 1.0)
    mean = np.where(both, mine.mean - total / others, 0.0)
    error = np.sqrt(1 / np.where(mine.weight > 0, mine.weight, 1.0) + 1 / others)
    size = np.abs(mean) / error
    worst = np.argmax(size)
    return Disagreement(
        recording=name,
        link=link + 1,
        samples=len(mine.off),
        rms=float(np.sqrt(np.mean(mine.off**2))),
        noise=float(np.sqrt(np.mean(mine.noise**2))),
        low=edges[worst],
        high=edges[worst + 1],
        mean=mean[worst],
        std_error=error[worst],
        stretches=int((size > DISAGREEMENT_ERRORS).sum()),
    )


def disagreement_warnings(rows: list[Disagreement]) -> list[str]:
    """A line for each recording that disagrees, with its worst link."""
    found = []
    for name in dict.fromkeys(row.recording for row in rows if row.disagrees):
        mine = [row for row in rows if row.recording == name]
        found.append(str(max(mine, key=lambda row: abs(row.mean) / row.std_error)))
    return found
