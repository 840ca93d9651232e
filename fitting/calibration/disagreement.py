"""Where the recordings of one motion disagree: mean deviations of each from the common motion, by stretches of time."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fitting.calibration.preparation import Prepared
from fitting.estimate.residuals import Solution

#: Stretches of time in which deviations are averaged.
STRETCHES = 10
#: Standard errors of such a mean above which a recording disagrees: one in 4000 links by chance.
DISAGREES = 5.0


@dataclass(frozen=True)
class Disagreement:
    """A link of a recording, and the stretch in which it is farthest from the motion, in its errors.

    Attributes:
        recording, link: name, and number from 1.
        samples: in all.
        rms, noise: of the deviations, and as estimated [rad].
        low, high: of the stretch [s].
        mean, std_error: of measured minus common motion there [rad].
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

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON."""
        return asdict(self)


def disagreements(prepared: Prepared, solution: Solution) -> list[Disagreement]:
    """A row for every link of every recording; empty unless several recordings show one motion."""
    found = []
    windows = solution.windows
    times = windows.times()
    for run, trace in enumerate(prepared.traces):
        mine = (windows.run == run)[:, None]
        edges = np.linspace(trace.t[0], trace.t[-1] + trace.interval, STRETCHES + 1)
        for column in range(len(trace.recordings) * trace.links):
            known = mine & (windows.weight[..., column] > 0)
            if not known.any():
                continue
            recording, link = divmod(column, trace.links)
            off = -solution.errors[..., column][known]
            noise = 1 / windows.weight[..., column][known]
            part = np.clip(np.searchsorted(edges, times[known], side="right") - 1, 0, STRETCHES - 1)
            count = np.bincount(part, minlength=STRETCHES)
            mean = np.bincount(part, off, STRETCHES) / np.maximum(count, 1)
            # correlated samples count as fewer
            number = count / solution.problem.memory
            error = np.bincount(part, noise, STRETCHES) / np.maximum(count, 1) / np.sqrt(np.maximum(number, 1e-9))
            size = np.where(number >= 1, np.abs(mean) / np.maximum(error, 1e-300), 0.0)
            worst = int(np.argmax(size))
            found.append(
                Disagreement(
                    recording=trace.recordings[recording].name,
                    link=link + 1,
                    samples=int(known.sum()),
                    rms=float(np.sqrt(np.mean(off**2))),
                    noise=float(np.sqrt(np.mean(noise**2))),
                    low=float(edges[worst]),
                    high=float(edges[worst + 1]),
                    mean=float(mean[worst]),
                    std_error=float(error[worst]),
                    stretches=int((size > DISAGREES).sum()),
                )
            )
    return found


def disagreement_warnings(rows: list[Disagreement]) -> list[str]:
    """A line for each recording that disagrees, with its worst link."""
    found = []
    for name in dict.fromkeys(row.recording for row in rows if row.disagrees):
        mine = [row for row in rows if row.recording == name]
        found.append(str(max(mine, key=lambda row: abs(row.mean) / row.std_error)))
    return found
