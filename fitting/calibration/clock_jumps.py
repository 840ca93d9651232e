"""Jumps of a film's clock at missing frames, which are freed as long as the likelihood improves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.calibration.candidate import LEAST_GAIN, Candidate
from fitting.calibration.freeing import Freeing, likelihood
from fitting.calibration.possible_faults import RESERVED_JUMPS, with_freed
from fitting.estimate.factors import invert_spd
from fitting.estimate.solution import Solution
from fitting.estimate.windows import pick
from fitting.parameters.targets import LOST
from fitting.windows.lost_frames import Lost, lost_frames, starts_from_previous_windows, windows_far_off
from fitting.windows.prepared import Prepared

#: Gain in log likelihood that a jump has by chance: the log of the number of jumps that are searched.
JUMP_SEARCH_GAIN = 9.0
#: Minimum size of a jump [frames]; smaller ones are a misfit of another kind.
LEAST_LOST_FRAMES = 0.7


def free_jumps(freeing: Freeing) -> None:
    """Jumps of the clock at missing frames, as long as they gain."""
    while sum(p.is_lost for p in freeing.prepared.parameters) < RESERVED_JUMPS:
        clean = _fit_without_far_off(freeing)
        lost = lost_frames(freeing.prepared, clean)
        if lost is None or not _free_jump(freeing, lost, clean):
            return


def _free_jump(freeing: Freeing, lost: Lost, clean: Solution) -> bool:
    """Whether a jump gains, which is then free.

    Args:
        clean: the fit without windows that contain a jump.
    """
    trace = freeing.prepared.traces[lost.run]
    time = trace.t[lost.frame]
    begin = _joined_at(freeing, lost.run, time, clean)
    name = f"{LOST}.{lost.run}.{lost.frame}"
    prepared = with_freed(begin, [name], freeing.simulator, lost.frames * trace.interval)
    solution = freeing.fit(prepared, "windows", freeing.loss)
    gain = likelihood(solution) - likelihood(freeing.solution)
    seconds = float(solution.values[-1])
    frames = seconds / trace.interval
    if solution.status != "ok" or gain < LEAST_GAIN + JUMP_SEARCH_GAIN or abs(frames) < LEAST_LOST_FRAMES:
        return False
    words = f"{frames:.1f} lost frames before frame {lost.frame} of {trace.name} ({time:.3f} s)"
    error = float(np.sqrt(invert_spd(solution.information)[-1, -1]))
    freeing.accept(prepared, solution, Candidate(words, (name,), {name: seconds}, {name: error}, gain))
    return True


def _fit_without_far_off(freeing: Freeing) -> Solution:
    """A fit without the windows that contain a jump: their misfit would be taken for damping and for noise."""
    off = windows_far_off(freeing.solution)
    if not off.any():
        return freeing.solution
    prepared = replace(freeing.prepared, windows=freeing.prepared.windows.without_samples(off))
    # a jump that only shows in these windows
    slopes = freeing.solution.evaluation.jacobian[~off][..., freeing.solution.problem.freedoms :]
    unseen = ~np.any(slopes, axis=(0, 1, 2))
    if not unseen.any():
        unseen = None
    solution = freeing.fit(prepared, "windows", freeing.loss, frozen=unseen)
    if solution.status == "ok":
        return solution
    return freeing.solution


def _joined_at(freeing: Freeing, run: int, time: float, clean: Solution) -> Prepared:
    """The preparation, started from `clean`; the window with a jump at `time` [s] starts where the previous one
    ends.

    A jump between separate windows costs nothing: these two are merged first.
    """
    interval = freeing.prepared.traces[run].interval
    windows = freeing.prepared.windows
    k = np.flatnonzero((windows.run == run) & (windows.begin <= time + 1e-6 * interval))[-1]
    others = np.arange(windows.count) != k
    clean = replace(clean, starts=starts_from_previous_windows(clean, ~others))
    if windows.follows[k] and abs(windows.begin[k] - time) < 0.5 * interval:
        pieces = windows.pieces()
        merged = pieces[k - 1]._replace(steps=pieces[k - 1].steps + pieces[k].steps)
        clean = replace(clean, starts=pick(clean.starts, others))
        freeing.prepared = freeing.prepared.with_pieces([*pieces[: k - 1], merged, *pieces[k + 1 :]]).starting_at(clean)
        freeing.solution = freeing.fit(freeing.prepared, "windows", freeing.loss)
    return freeing.prepared.starting_at(clean)
