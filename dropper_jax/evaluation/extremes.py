"""Maximum in a storm from the maxima of several runs: Gumbel distribution, with a confidence interval."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.evaluation.settings import Settings
from dropper_jax.scene import LineSpec

#: Euler's constant: the mean of the standard Gumbel distribution.
EULER = 0.5772156649015329
#: Minimum number of runs for a spread.
LEAST_RUNS = 3


class Gumbel(NamedTuple):
    """`P(x) = exp(-exp(-(x - mode)/scale))`."""

    mode: float
    scale: float

    def quantile(self, p: float) -> float:
        """Value that is not exceeded with probability p."""
        return self.mode - self.scale * float(np.log(-np.log(p)))

    @property
    def mean(self) -> float:
        return self.mode + EULER * self.scale

    def over(self, times: float) -> Gumbel:
        """Distribution of the maximum of `times` such maxima: the same scale, the mode higher by scale * log(times)."""
        return Gumbel(self.mode + self.scale * float(np.log(times)), self.scale)


def fit_gumbel(maxima: np.ndarray) -> Gumbel:
    """Gumbel distribution of maxima (runs,) by probability-weighted moments: `scale = (2 b1 - b0)/ln 2`.

    b0 is the mean, `b1 = sum_i (i - 1)/(n - 1) x_i/n` over the sorted maxima; `mode = b0 - 0.5772 scale`
    (Landwehr, Matalas and Wallis 1979, Water Resources Research 15: 1055; unbiased, and steady with few runs).
    """
    mode, scale = _fit(np.sort(np.asarray(maxima, float)))
    return Gumbel(float(mode), float(scale))


def _fit(ordered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mode and scale of sorted samples (..., n)."""
    n = ordered.shape[-1]
    b0 = ordered.mean(axis=-1)
    b1 = ordered @ (np.arange(n) / (n - 1)) / n
    scale = (2 * b1 - b0) / np.log(2.0)
    return b0 - EULER * scale, scale


def storm_extreme(maxima: np.ndarray, duration: float, storm: float, confidence: float) -> Table:
    """Most probable and mean maximum in a storm, and its 90th percentile, with their intervals.

    Args:
        maxima: maximum of each run (runs,).
        duration: of a run [s]; the storm is storm/duration such runs, their maxima taken as independent.
        confidence: level of the interval: that of the pivot `(estimate - truth)/scale` of fits to drawn samples, which
            has the correct coverage also with few runs (3 to 20 runs, 1000 draws each: 0.88 to 0.92 for 0.9).

    Returns:
        values by name, or `skipped` and why.
    """
    maxima = np.asarray(maxima, float)
    if len(maxima) < LEAST_RUNS:
        return {"skipped": f"{len(maxima)} run(s); needed: at least {LEAST_RUNS}, of different seeds"}
    one = fit_gumbel(maxima)
    rounding = 1e-9 * np.abs(maxima).max()
    if one.scale <= rounding:
        return {"skipped": "all runs have the same maximum: runs of different seeds are needed"}
    idle = int(np.count_nonzero(np.abs(maxima) <= rounding))
    if idle:  # a load that is zero in some runs has no single distribution of maxima
        return {"skipped": f"no load at all in {idle} of {len(maxima)} runs"}
    times = storm / duration
    whole = one.over(times)
    # the seed makes the report reproducible
    drawn = -np.log(-np.log(np.random.default_rng(20240901).random((4000, len(maxima)))))
    mode, scale = _fit(np.sort(drawn, axis=1))
    found = {
        "runs": len(maxima),
        "maxima": maxima,
        "run_duration_s": duration,
        "storm_s": storm,
        "gumbel_mode": one.mode,
        "gumbel_scale": one.scale,
        "confidence": confidence,
        "extrapolated": times,
    }
    numbers = {"most_probable": whole.mode, "mean": whole.mean, "percentile_90": whole.quantile(0.9)}
    for key, value in numbers.items():
        # (estimate - truth)/estimated scale has the same distribution for every Gumbel distribution
        reduced = (value - one.mode) / one.scale
        pivot = np.quantile(
            (mode + reduced * scale - reduced) / scale, [0.5 * (1 + confidence), 0.5 * (1 - confidence)]
        )
        found[key] = value
        found[f"{key}_interval"] = (value - one.scale * pivot).tolist()
    return found


class Snap(NamedTuple):
    """One event: start and end of slack [s], time of the threshold [s], the following peak [N] and its time [s]."""

    slack_from: float
    slack_to: float
    passed: float
    peak: float
    peak_at: float


#: Keys of the fields of an event in a table.
EVENT_KEYS = ("slack_from_s", "slack_to_s", "threshold_passed_s", "peak_n", "peak_s")


def snap_events(
    t: np.ndarray,
    tension: np.ndarray,
    slack: float,
    least: float,
    snap: float,
    peaks: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Snap]:
    """Events in the tension of one link: below `slack` [N] for at least `least` [s], then above `snap` [N].

    The time below is that between the crossings of `slack`, linear between samples. The rise counts until the tension
    falls below `slack` again; the peak is the maximum tension until then.

    Args:
        peaks: maximum tension over the steps since the previous sample (k,) [N] and its time (k,) [s]; default: the
            samples.
    """
    largest, largest_at = (tension, t) if peaks is None else peaks
    # the ends of slack, each with the sample at which it started, and the next start, up to which the peak counts
    change = np.diff((tension < slack).astype(int), prepend=0)
    starts = np.flatnonzero(change > 0)
    found = []
    for begin, end, until in zip(starts, np.flatnonzero(change < 0), [*starts[1:], len(t)], strict=False):
        start = t[0] if begin == 0 else _crossing(t, tension, begin - 1, slack)
        stop = _crossing(t, tension, end - 1, slack)
        over = np.flatnonzero(largest[end:until] > snap)
        if stop - start < least or not over.size:
            continue
        first = end + int(over[0])
        peak = end + int(np.argmax(largest[end:until]))
        # a peak between two samples below the threshold passes it at an unknown time before
        passed = largest_at[first]
        if tension[first] > snap:
            passed = _crossing(t, tension, first - 1, snap)
        found.append(Snap(*map(float, (start, stop, passed, largest[peak], largest_at[peak]))))
    return found


def _crossing(t: np.ndarray, tension: np.ndarray, i: int, level: float) -> float:
    """Time at which the tension passes `level` between samples i and i + 1."""
    rise = tension[i + 1] - tension[i]
    if rise == 0:
        return t[i]
    return t[i] + (level - tension[i]) / rise * (t[i + 1] - t[i])


def _thresholds(spec: LineSpec, tension: np.ndarray, settings: Settings) -> tuple[float, float]:
    """Tensions [N] of a link below which it is slack and above which a snap follows; by default parts of its mean."""
    mean = max(float(tension.mean()), 0.0)
    slack = settings.slack
    if slack is None:
        slack = 0.0 if spec.rigid else 0.1 * mean
    snap = settings.snap
    if snap is None:
        snap = 2.0 * mean
    return slack, max(snap, slack)


def line_snaps(record: Record, settings: Settings) -> list[Table]:
    """Per line: number of events, per link and in its worst link, fraction of time slack, and the largest events.

    A rigid link is never slack: for it the fraction is that of compression.
    """
    listed = 10  # events listed per line, the largest first
    found = []
    for where in record.written_lines:
        s = arc(where.spec.length)
        extremes = record.extremes["tension"].of(where.links)
        counts = []
        share = []
        events = []
        for j, tension in enumerate(record.tension[:, where.links].T):
            slack, snap = _thresholds(where.spec, tension, settings)
            peaks = extremes.largest[:, j], extremes.largest_at[:, j]
            own = snap_events(record.t_tension, tension, slack, settings.slack_time, snap, peaks)
            counts.append(len(own))
            share.append(float(np.mean(tension < slack)))
            for event in own:
                times = dict(zip(EVENT_KEYS, event, strict=True))
                events.append({"at_m": float(s[j]), **times, "slack_n": slack, "snap_n": snap})
        events.sort(key=lambda event: -event["peak_n"])
        found.append(
            {
                "line": where.name,
                "rigid": where.spec.rigid,
                "arc_length_m": s,
                "events": counts,
                "most_events": max(counts),
                "slack_share": share,
                "largest_share_slack": max(share),
                "shown": events[:listed],
                "not_shown": max(len(events) - listed, 0),
            }
        )
    return found
