"""Files that do not belong to the scene, found after a fit that does not explain the trace.

Short windows are fitted as given and for each change that a file may need. They use the programs of that fit, with only
starts and damping free. A change that lowers chi-square by a factor ten is reported. If none does, the likeliest cause
is reported (`likely_cause`), provided that short windows miss the angles by more than right models do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fitting.calibration.likely_cause import fit_short_windows, likely_cause
from fitting.calibration.prepared import Prepared
from fitting.estimate.windows import Span
from fitting.traces.conventions import resting_angles
from fitting.traces.file_mistakes import Correction, corrections, late_columns, shifted_zero
from fitting.traces.planar import wrap
from fitting.traces.trace import Convention, Trace

#: Fraction of chi-square that a reported change may leave.
CHI_SQUARE_LEFT = 0.1
#: Frames by which one column may be late that short windows try: within 20 % of the true one.
TRIED_DELAYS = (1, 2, 3, 5, 8, 12, 18, 26)
#: Chi-square per degree of freedom above which short windows are tried, and per sample above which they are wrong.
SUSPECT_CHI_SQUARE = 1000.0
WRONG_CHI_SQUARE = 25.0
#: Fraction of their motion by which short windows miss another rig. Low noise shows the errors of any model: those of a
#: measured double pendulum are 8 times its noise, 0.05 % of the motion.
OTHER_RIG_MISS = 3e-3
#: Short windows, as many as one program runs in parallel; their length as a fraction of the shortest link's period and
#: in frames. An acceleration that is wrong by g moves a link by a radian in that time.
SHORT_WINDOWS = 8
WINDOW_PERIODS = 0.35
WINDOW_FRAMES = 6
#: Maximum chi-square per sample of a reported change: right ones give 0.5 to 4.
LARGEST_CHI_SQUARE = 9.0


def name_wrong_file(prepared: Prepared) -> str:
    """The change of the traces that short windows suggest, in a line; empty if they fit as given, and of several
    recordings of one motion, which show each other's mistakes."""
    if any(trace.recordings for trace in prepared.traces):
        return ""
    pieces = _moving_pieces(prepared)
    links = prepared.traces[0].links
    found = fit_short_windows(prepared, pieces)
    given = float(np.median(found.chi2))
    if not given > WRONG_CHI_SQUARE:
        return ""
    name = ", ".join(trace.name for trace in prepared.traces)
    size = f"short windows miss the angles by {np.sqrt(given):.0f} times their noise as given"
    frequent = [*corrections(links), *_resting_shifts(prepared)]
    rare = list(late_columns(links, TRIED_DELAYS))
    for group in (frequent, rare):
        tried = []
        for change in group:
            traces = [_apply_change(trace, change) for trace in prepared.traces]
            tried.append(float(np.median(fit_short_windows(prepared, pieces, traces=traces).chi2)))
        left = min(tried)
        change = group[int(np.argmin(tried))]
        if left < min(CHI_SQUARE_LEFT * given, LARGEST_CHI_SQUARE):
            return (
                f"{name}: {change.mistake}, as it seems: {size}, {np.sqrt(left):.2g} times without this mistake; "
                f"to correct it: {change.fix}"
            )
    if not found.part > OTHER_RIG_MISS:
        return ""
    cause = likely_cause(prepared, pieces)
    return f"{name}: {size}; likeliest cause: {cause.words}; {cause.remedy}"


def _moving_pieces(prepared: Prepared) -> list[Span]:
    """Run, start and end of short windows, spread over those of the fit's that move more than the median."""
    windows = prepared.windows
    interval = max(trace.interval for trace in prepared.traces)
    length = min(windows.length, max(WINDOW_PERIODS * prepared.period, WINDOW_FRAMES * interval))
    known = windows.weight > 0
    mean = np.sum(windows.theta * known, axis=1) / np.maximum(known.sum(axis=1), 1)
    moved = np.sum(known * (windows.theta - mean[:, None]) ** 2, axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1)
    moved = np.where(windows.lengths > length * (1 - 1e-6), moved, -1.0)  # the rest of a window is too short
    moving = np.flatnonzero((moved >= np.median(moved[moved >= 0])) & (moved >= 0))
    some = moving[np.unique(np.linspace(0, len(moving) - 1, SHORT_WINDOWS).round().astype(int))]
    begins = zip(windows.run[some].tolist(), windows.begin[some].tolist(), strict=True)
    return [Span(run, begin, begin + length) for run, begin in begins]


def _apply_change(trace: Trace, change: Correction) -> Trace:
    """A trace in the model's convention, changed in the convention of its file."""
    at = Convention(trace.convention.zero or "horizontal", trace.convention.sign or 1, "rad")
    raw = (at.sign or 1) * replace(at, sign=1).in_model(trace.theta)
    return replace(trace, theta=at.in_model(change.apply(raw)), se=None)


def _resting_shifts(prepared: Prepared) -> Iterator[Correction]:
    """Shifts of one column, or of all, that bring the mean directions of a free line to those at rest."""
    model = prepared.simulator.model
    trace = prepared.traces[0]
    if model.end_held:
        return  # open frames were handled before
    mean = np.angle(np.nanmean(np.exp(1j * trace.theta), axis=0))
    off = wrap(resting_angles(model) - mean) * trace.convention.turn
    for part in (0.7, 1.0, 1.3):  # the mean of a few swings differs from the angle at rest
        for j, by in enumerate(off):
            yield shifted_zero(j, part * float(by))
        yield shifted_zero(None, part * float(np.mean(off)))
