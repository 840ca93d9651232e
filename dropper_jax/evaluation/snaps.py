"""Snap loads: links that go slack and are then pulled taut."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dropper_jax.base.read import Table
from dropper_jax.evaluation.record import Record, arc
from dropper_jax.evaluation.settings import Settings
from dropper_jax.scene import LineSpec, WholeLine

#: Maximum number of events that are listed for a line, the largest first.
MOST_EVENTS = 10


class Snap(NamedTuple):
    """One event: start and end of slack [s], time of the threshold [s], the following peak [N] and its time [s]."""

    slack_from_s: float
    slack_to_s: float
    threshold_passed_s: float
    peak_n: float
    peak_s: float


def snap_events(
    t: np.ndarray,
    tension: np.ndarray,
    slack: float,
    shortest: float,
    snap: float,
    peaks: tuple[np.ndarray, np.ndarray] | None = None,
) -> list[Snap]:
    """Events in the tension (k,) [N] of one link at t (k,) [s]: below `slack` for `shortest` [s] or more, then above
    `snap`.

    The time below is that between the crossings of `slack`, linear between samples. The rise counts until the tension
    falls below `slack` again; the peak is the maximum tension until then.

    Args:
        peaks: maximum tension over the steps since the previous sample (k,) [N] and its time (k,) [s]; default: the
            samples.
    """
    largest = tension
    largest_at = t
    if peaks is not None:
        largest, largest_at = peaks
    # the ends of slack, each with the sample at which it started, and the next start, up to which the peak counts
    change = np.diff((tension < slack).astype(int), prepend=0)
    starts = np.flatnonzero(change > 0)
    found = []
    for begin, end, until in zip(starts, np.flatnonzero(change < 0), [*starts[1:], len(t)], strict=False):
        start = t[0]
        if begin > 0:
            start = _crossing(t, tension, begin - 1, slack)
        stop = _crossing(t, tension, end - 1, slack)
        over = np.flatnonzero(largest[end:until] > snap)
        if stop - start < shortest or not over.size:
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
    if slack is None and spec.rigid:
        slack = 0.0
    elif slack is None:
        slack = 0.1 * mean
    snap = settings.snap
    if snap is None:
        snap = 2.0 * mean
    return slack, max(snap, slack)


def line_snaps(record: Record, settings: Settings) -> list[Table]:
    """Per line: number of events, per link and in its worst link, fraction of time slack, and the largest events.

    A rigid link is never slack: for it the fraction is that of compression.
    """
    return [_snaps(record, line, settings) for line in record.written_lines]


def _snaps(record: Record, line: WholeLine, settings: Settings) -> Table:
    """The events of one line."""
    s = arc(line.spec.length)
    extremes = record.extremes["tension"].of(line.links)
    counts = []
    share = []
    events = []
    for j, tension in enumerate(record.tension[:, line.links].T):
        slack, snap = _thresholds(line.spec, tension, settings)
        peaks = extremes.largest[:, j], extremes.largest_at[:, j]
        own = snap_events(record.t_tension, tension, slack, settings.slack_time, snap, peaks)
        counts.append(len(own))
        share.append(float(np.mean(tension < slack)))
        for event in own:
            events.append({"at_m": float(s[j]), **event._asdict(), "slack_n": slack, "snap_n": snap})
    events.sort(key=lambda event: -event["peak_n"])
    return {
        "line": line.name,
        "rigid": line.spec.rigid,
        "arc_length_m": s,
        "events": counts,
        "most_events": max(counts),
        "slack_share": share,
        "largest_share_slack": max(share),
        "shown": events[:MOST_EVENTS],
        "not_shown": max(len(events) - MOST_EVENTS, 0),
    }
