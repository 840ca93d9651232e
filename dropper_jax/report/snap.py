"""Snap loads: a link that was slack for some time and becomes taut."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dropper_jax.report.record import Record, arc
from dropper_jax.report.settings import Settings

#: Relative thresholds of a link: slack below this part of its mean tension, a snap above this multiple of it.
SLACK, SNAP = 0.1, 2.0
#: Events listed per line, the largest first.
LISTED = 10


class Snap(NamedTuple):
    """One event: start and end of slack [s], time of the threshold [s], the following peak [N] and its time [s]."""

    slack_from: float
    slack_to: float
    passed: float
    peak: float
    peak_at: float


def snap_events(t: np.ndarray, tension: np.ndarray, slack: float, least: float, snap: float) -> list[Snap]:
    """Events in the tension of one link: below `slack` [N] for at least `least` [s], then above `snap` [N].

    The time below is that between the crossings of `slack`, linear between samples. The rise counts until the tension
    falls below `slack` again; the peak is the maximum tension until then.
    """
    low = tension < slack
    edges = np.flatnonzero(np.diff(low.astype(int)))
    found = []
    begins = [*([0] if low[0] else []), *(i + 1 for i in edges if not low[i])]
    for begin in begins:
        after = np.flatnonzero(~low[begin:])
        if not after.size:
            break  # slack to the end of the record
        end = begin + int(after[0])
        start = t[begin] if begin == 0 else _crossing(t, tension, begin - 1, slack)
        stop = _crossing(t, tension, end - 1, slack)
        again = np.flatnonzero(low[end:])
        until = end + int(again[0]) if again.size else len(t)
        over = np.flatnonzero(tension[end:until] > snap)
        if stop - start < least or not over.size:
            continue
        first = end + int(over[0])
        peak = end + int(np.argmax(tension[end:until]))
        over_at = _crossing(t, tension, first - 1, snap)
        found.append(Snap(*map(float, (start, stop, over_at, tension[peak], t[peak]))))
    return found


def _crossing(t: np.ndarray, tension: np.ndarray, i: int, level: float) -> float:
    """Time at which the tension passes `level` between samples i and i + 1."""
    rise = tension[i + 1] - tension[i]
    return t[i] if rise == 0 else t[i] + (level - tension[i]) / rise * (t[i + 1] - t[i])


def line_snaps(record: Record, settings: Settings) -> list[dict[str, Any]]:
    """Per line: number of events, per link and in its worst link, fraction of time slack, and the largest events."""
    found = []
    for where in record.written_lines:
        spec = where.spec
        s, counts, share, events = arc(spec.length), [], [], []
        for j in range(spec.links):
            tension = record.tension[:, where.links.start + j]
            mean = max(float(tension.mean()), 0.0)
            slack = SLACK * mean if settings.slack is None else settings.slack
            snap = max(SNAP * mean if settings.snap is None else settings.snap, slack)
            own = snap_events(record.t_tension, tension, slack, settings.slack_time, snap)
            counts.append(len(own))
            share.append(float(np.mean(tension < slack)))
            events += [_row(event, float(s[j]), slack, snap) for event in own]
        events.sort(key=lambda event: -event["peak_n"])
        found.append(
            {
                "line": where.name,
                "arc_length_m": s,
                "events": counts,
                "most_events": max(counts),
                "slack_share": share,
                "largest_share_slack": max(share),
                "shown": events[:LISTED],
                "not_shown": max(len(events) - LISTED, 0),
            }
        )
    return found


def _row(event: Snap, at: float, slack: float, snap: float) -> dict[str, float]:
    return {
        "at_m": at,
        "slack_from_s": event.slack_from,
        "slack_to_s": event.slack_to,
        "threshold_passed_s": event.passed,
        "peak_n": event.peak,
        "peak_s": event.peak_at,
        "slack_n": slack,
        "snap_n": snap,
    }
