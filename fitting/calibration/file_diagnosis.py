"""What is wrong with a file, after a fit that does not explain the trace.

Short windows are fitted as given and with each correction that a file may need, by the programs of that fit. A
correction that lowers chi-square by a factor ten is reported. If none does, the likeliest cause is reported
(`likely_cause`), provided that short windows miss the angles by more than right models do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fitting.calibration.likely_cause import likely_cause
from fitting.traces.conventions import resting_angles
from fitting.traces.file_mistakes import Correction, corrections, late_columns, shifted_zero
from fitting.traces.planar import wrap
from fitting.traces.trace import Convention, Trace
from fitting.windows.prepared import Prepared
from fitting.windows.short_windows import fit_short_windows, moving_pieces

#: Fraction of chi-square that a reported correction may leave.
CHI_SQUARE_LEFT = 0.1
#: Delays of one column [frames] that are tried: one of them is within 20 % of any delay up to 30.
TRIED_DELAYS = (1, 2, 3, 5, 8, 12, 18, 26)
#: Chi-square per degree of freedom of a fit above which its file is diagnosed.
SUSPECT_CHI_SQUARE = 1000.0
#: Chi-square per sample of short windows above which the file is wrong.
WRONG_CHI_SQUARE = 25.0
#: Fraction of their motion by which short windows miss another rig. Low noise shows the errors of any model: those of a
#: measured double pendulum are 8 times its noise, 0.05 % of the motion.
OTHER_RIG_MISS = 3e-3
#: Maximum chi-square per sample with a reported correction: right ones give 0.5 to 4.
LARGEST_CHI_SQUARE = 9.0


def name_wrong_file(prepared: Prepared) -> str:
    """What is wrong with the traces, in a line; empty if short windows fit as given.

    Also empty for several recordings of one motion, which show each other's mistakes.
    """
    if any(trace.recordings for trace in prepared.traces):
        return ""
    pieces = moving_pieces(prepared)
    links = prepared.traces[0].links
    found = fit_short_windows(prepared, pieces)
    given = np.median(found.chi2)
    if not given > WRONG_CHI_SQUARE:
        return ""
    name = ", ".join(trace.name for trace in prepared.traces)
    size = f"short windows miss the angles by {np.sqrt(given):.0f} times their noise as given"
    frequent = [*corrections(links), *_resting_shifts(prepared)]
    rare = list(late_columns(links, TRIED_DELAYS))
    for group in (frequent, rare):
        tried = []
        for correction in group:
            traces = [_corrected(trace, correction) for trace in prepared.traces]
            tried.append(np.median(fit_short_windows(prepared, pieces, traces=traces).chi2))
        left = min(tried)
        best = group[np.argmin(tried)]
        if left < min(CHI_SQUARE_LEFT * given, LARGEST_CHI_SQUARE):
            return (
                f"{name}: {best.mistake}, as it seems: {size}, {np.sqrt(left):.2g} times without this mistake; "
                f"to correct it: {best.fix}"
            )
    if not found.part > OTHER_RIG_MISS:
        return ""
    cause = likely_cause(prepared, pieces)
    return f"{name}: {size}; likeliest cause: {cause.words}; {cause.remedy}"


def _corrected(trace: Trace, correction: Correction) -> Trace:
    """A trace in the model's convention, corrected in the convention of its file."""
    at = Convention(trace.convention.zero or "horizontal", trace.convention.sign or 1, "rad")
    raw = (at.sign or 1) * replace(at, sign=1).in_model(trace.theta)
    return replace(trace, theta=at.in_model(correction.apply(raw)), se=None)


#: Shifts that are tried, in parts of the difference from rest: the mean of a few swings is not the angle at rest.
SHIFT_PARTS = (0.7, 1.0, 1.3)


def _resting_shifts(prepared: Prepared) -> Iterator[Correction]:
    """Shifts of one column, or of all, that bring the mean directions of a free line to those at rest."""
    model = prepared.simulator.model
    trace = prepared.traces[0]
    if model.both_ends_fixed:
        return  # open frames were handled before
    mean = np.angle(np.nanmean(np.exp(1j * trace.theta), axis=0))
    off = wrap(resting_angles(model) - mean) * trace.convention.turn
    for part in SHIFT_PARTS:
        for j, by in enumerate(off):
            yield shifted_zero(j, part * by)
        yield shifted_zero(None, part * np.mean(off))
