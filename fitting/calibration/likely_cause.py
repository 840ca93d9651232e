"""The likeliest cause of a misfit that no change of the file removes, with the command that tries it.

Checked in this order, by short windows whose starts and damping are free:

1. Samples interpolated between others, as by clicking every few frames: their second differences vanish.
2. A number of the scene that is wrong: lengths, clock, gravity, masses, ends and markers, each free in turn.
3. A beginning that a hand or a drive moves: windows before some time miss the angles, all later ones do not.
4. Smoothed or hand-clicked samples: neighbours share their errors, so that differences show little of them. They are a
   small part of the motion.
5. Otherwise the line has other links than the scene, or forces that the scene lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fitting.calibration.possible_faults import candidate_simulator, possible_faults, with_freed
from fitting.estimate.release import RELEASE_TIME
from fitting.estimate.windows import Span
from fitting.parameters.names import free_option
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import NODE
from fitting.traces.noise import rounding
from fitting.traces.trace import Trace
from fitting.windows.prepared import Prepared
from fitting.windows.short_windows import fit_short_windows

#: Fraction of chi-square that a right cause may leave.
CHI_SQUARE_LEFT = 0.1
#: Chi-square per sample up to which a window is explained.
EXPLAINED_CHI_SQUARE = 9.0
#: Chi-square of a later candidate over that of an earlier one, which is more common, from which the later one counts.
LATER_SHARE = 0.5
#: Maximum relative change of a number outside the effects by a plausible cause.
PLAUSIBLE_CHANGE = 0.5
#: Fraction of samples on the line through their neighbours, above which they are interpolated.
INTERPOLATED_FRACTION = 0.4
#: Step of a sensor, as a fraction of the median change between samples, above which its readings show it.
LARGEST_STEP = 1e-3
#: Fraction of the motion by which short windows miss smoothed samples at most; wrong models miss more.
SMOOTHED_MISS = 0.04
#: Short windows in the order of time that find a driven beginning.
BEGINNING_WINDOWS = 12


class Cause(NamedTuple):
    """A cause in words, and what to try."""

    words: str
    remedy: str


def likely_cause(prepared: Prepared, pieces: Sequence[Span]) -> Cause:
    """The likeliest cause.

    Args:
        pieces: run, start and end [s] of short windows that move.
    """
    trace = prepared.traces[0]
    if interpolated_fraction(trace) > INTERPOLATED_FRACTION:
        return Cause(
            "angles interpolated between frames, as clicked by hand",
            "leave the cells of frames that were not measured empty",
        )
    given = fit_short_windows(prepared, pieces)
    return (
        _wrong_number(prepared, pieces, np.median(given.chi2))
        or driven_beginning(prepared, pieces[0].high - pieces[0].low)
        or _shared_errors(prepared, given.part)
        or Cause(
            "a line of other links than the scene's, or a force that the scene lacks",
            f"check `links` ({prepared.simulator.model.line.links} in the scene), masses and effects",
        )
    )


def _wrong_number(prepared: Prepared, pieces: Sequence[Span], given: float) -> Cause | None:
    """The number of the scene that explains most if it is free."""
    free = prepared.names
    simulator = candidate_simulator(prepared)
    best = max(CHI_SQUARE_LEFT * given, EXPLAINED_CHI_SQUARE)
    cause = None
    for name, paths, _ in possible_faults(prepared.simulator.model, prepared.simulator.release):
        marked_or_released = paths[0].startswith((NODE, RELEASE_TIME))
        if marked_or_released or any(one.startswith(tuple(paths)) for one in free):
            continue
        tried = with_freed(prepared, paths, simulator)
        found = fit_short_windows(tried, pieces, paths)
        left = np.median(found.chi2)
        if left < best and _plausible(tried.parameters, found.values):
            best = LATER_SHARE * left
            cause = Cause(f"wrong {name}", freeing_advice(prepared, paths))
    return cause


def _plausible(parameters: Sequence[Parameter], values: np.ndarray) -> bool:
    """Whether no number outside the effects is changed by more than `PLAUSIBLE_CHANGE`."""
    start = np.array([p.value for p in parameters])
    in_effects = np.array([p.name.startswith("effects.") for p in parameters])
    large = np.abs(values - start) > PLAUSIBLE_CHANGE * np.abs(start)
    return not np.any(large & (start != 0) & ~in_effects)


def freeing_advice(prepared: Prepared, paths: Sequence[str]) -> str:
    """The option that also frees these paths."""
    return f"free them: {free_option(prepared.names, paths)}"


def driven_beginning(prepared: Prepared, length: float) -> Cause | None:
    """A beginning whose windows miss the angles, while all later ones explain them.

    Args:
        length: of a short window [s].
    """
    windows = prepared.windows
    low = windows.begin.min()
    high = windows.ends.max()
    starts = np.linspace(low, high - length, BEGINNING_WINDOWS)
    mine = np.unique(windows.run)
    if len(mine) > 1 or length >= (high - low) / BEGINNING_WINDOWS:
        return None
    pieces = [Span(int(mine[0]), begin, begin + length) for begin in starts.tolist()]
    chi2 = fit_short_windows(prepared, pieces).chi2
    missed = np.flatnonzero(chi2 > EXPLAINED_CHI_SQUARE)
    if len(chi2) != BEGINNING_WINDOWS or not len(missed):
        return None
    first_explained = missed[-1] + 1
    if first_explained > BEGINNING_WINDOWS // 2 + 1 or len(missed) < 0.5 * first_explained:
        return None
    until = starts[min(first_explained, BEGINNING_WINDOWS - 1)]
    return Cause(
        f"a hand or a drive that moves the line until {until:.3g} s",
        f"leave them out: --held-out {low:.3g}:{until:.3g}",
    )


def _shared_errors(prepared: Prepared, part: float) -> Cause | None:
    """Errors of the angles above their noise, a small part of the motion."""
    if part > SMOOTHED_MISS:
        return None
    trace = prepared.traces[0]
    sigma = np.median(prepared.sigma[0])
    error = max(part * np.median(np.nanstd(trace.theta, axis=0)), sigma)
    return Cause(
        f"smoothed or hand-clicked angles, whose errors exceed the noise between neighbours, {sigma:.2g} rad",
        f"use angles that are not smoothed, or state their error: # model_error={error:.1g} in the file",
    )


def interpolated_fraction(trace: Trace) -> float:
    """Fraction of the samples that lie on the line through their neighbours in time; 0 if the sensor's steps show.

    Readings in steps often lie on such lines too.
    """
    moves = np.nanmedian(np.abs(np.diff(trace.theta, axis=0)), axis=0)
    if any(rounding(column) > LARGEST_STEP * move for column, move in zip(trace.theta.T, moves, strict=True)):
        return 0.0
    slope = np.diff(trace.theta, axis=0) / np.diff(trace.t)[:, None]
    bend = np.abs(np.diff(slope, axis=0))
    size = np.nanmedian(np.abs(slope), axis=0)
    known = np.isfinite(bend)
    return np.sum((bend < 1e-6 * size) & known) / max(known.sum(), 1)
