"""Lost windows recovered (`lost_windows`): restarted, freed of isolated outliers, split and finally left out.

A lost window is restarted from the end of the previous one and from the samples at several reaches. If nothing helps,
its isolated outliers are marked as missing (`outliers`), or it is split, down to the minimum number of frames that
determine a start. Windows that stay lost are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_starts, window_costs
from fitting.estimate.solution import Solution
from fitting.estimate.window_problem import Problem
from fitting.estimate.windows import Piece, Span, Starts, Windows, fewest_frames, pick, with_rows
from fitting.windows.lost_frames import lost_frames, starts_from_previous_windows
from fitting.windows.lost_windows import lost_windows
from fitting.windows.outliers import isolated_outliers, mark_as_missing
from fitting.windows.prepared import Prepared

#: Rounds of restarts and fits.
RECOVERY_ROUNDS = 4


def recover_windows(
    prepared: Prepared,
    solution: Solution,
    fit_again: Callable[[Problem, Solution], Solution],
    keep_jumps: bool = False,
) -> tuple[Prepared, Solution]:
    """A fit of separate windows whose lost windows were restarted, split or left out.

    Args:
        solution: of the separate windows, converged or not.
        fit_again: fits a problem with changed windows, started from a solution with these windows.
        keep_jumps: leave windows with missing frames unchanged: a split would hide the missing frames in a gap.

    Returns:
        The preparation with the fitted windows and with `left_out` set, and their solution.
    """
    jump: tuple[int, float] | None = None
    for number in range(RECOVERY_ROUNDS + 1):
        if solution.status != "ok":
            solution = _with_starts(solution, np.ones(solution.windows.count, bool), solution.starts)
        lost = lost_windows(solution) & ~_windows_at(solution.windows, jump)
        if not lost.any():
            break
        if number == RECOVERY_ROUNDS:
            prepared, solution = _leave_out(prepared, solution, lost)
        else:
            solution = restart(prepared, solution, lost)
            lost &= lost_windows(solution)
            outlying = isolated_outliers(solution, lost)
            if outlying.any():
                marked = mark_as_missing(prepared, solution.windows, outlying)
                changed = np.any(outlying, axis=(1, 2))
                prepared, solution = _cut_again(marked, solution, solution.windows.pieces(), changed)
                lost = lost_windows(solution) & ~_windows_at(solution.windows, jump)
            if keep_jumps and jump is None and lost.any():
                jump = _jump(prepared, solution, lost)
                lost &= ~_windows_at(solution.windows, jump)
            prepared, solution = _split(prepared, solution, lost)
        solution = fit_again(solution.problem, solution)
    return prepared, solution


def _jump(prepared: Prepared, solution: Solution, lost: np.ndarray) -> tuple[int, float] | None:
    """Run and time [s] at which frames are missing, if any; lost windows (K,) bool start at the end of the previous."""
    problem = replace(solution.problem, windows=solution.windows.without_samples(lost))
    found = lost_frames(prepared, replace(solution, problem=problem))
    if found is None:
        return None
    return (found.run, prepared.traces[found.run].t[found.frame])


def _windows_at(windows: Windows, jump: tuple[int, float] | None) -> np.ndarray:
    """The windows (K,) bool that contain a given time of a run, and those that start or end there."""
    if jump is None:
        return np.zeros(windows.count, bool)
    run, time = jump
    return (windows.run == run) & (windows.begin - windows.dt <= time) & (time <= windows.ends + windows.dt)


#: Noise that is assumed for the starts of lost windows, relative to the estimated one: polynomials of short reach, of
#: the reach that the noise allows, and of long reach.
START_NOISE_RATIOS = (0.2, 1.0, 5.0)


def restart(prepared: Prepared, solution: Solution, lost: np.ndarray) -> Solution:
    """The solution with better starts of lost windows (K,) bool, if any are found."""
    windows = solution.windows.pick(lost)
    model = solution.problem.simulator.model_at(solution.values)
    ahead = pick(starts_from_previous_windows(solution, lost), lost)
    solution = _with_starts(solution, lost, ahead)
    for ratio in START_NOISE_RATIOS:
        sigma = [ratio * s for s in prepared.sigma]
        solution = _with_starts(solution, lost, first_starts(model, prepared.traces, windows, sigma))
    return solution


def _with_starts(solution: Solution, which: np.ndarray, starts: Starts) -> Solution:
    """The solution with other starts of some windows, fitted alone first, if these are better."""
    problem = solution.problem
    few = replace(problem, windows=solution.windows.pick(which))
    found = fit_starts(few, solution.values, starts)
    better = window_costs(problem, found.residual) < window_costs(problem, solution.evaluation.residual[which])
    if not better.any():
        return solution
    replaced = np.flatnonzero(which)[better]
    every = with_rows(solution.starts, replaced, pick(found.starts, better))
    evaluation = with_rows(solution.evaluation, replaced, pick(found, better))
    return replace(solution, starts=every, evaluation=evaluation, weights=problem.weights(evaluation))


def _split(prepared: Prepared, solution: Solution, lost: np.ndarray) -> tuple[Prepared, Solution]:
    """The solution with lost windows cut in two if enough frames remain; the halves start from the samples."""
    windows = solution.windows
    pieces: list[Piece] = []
    for k, piece in enumerate(windows.pieces()):
        if lost[k] and not windows.released[k]:
            pieces += _halves(prepared, piece, windows.dt)
        else:
            pieces.append(piece)
    if len(pieces) == windows.count:
        return prepared, solution
    return _cut_again(prepared, solution, pieces, np.zeros_like(lost))


def _cut_again(
    prepared: Prepared, solution: Solution, pieces: Sequence[Piece], changed: np.ndarray
) -> tuple[Prepared, Solution]:
    """The solution with windows of these pieces; those that are changed (K,) bool, or new, start from the samples."""
    prepared = prepared.with_pieces(pieces)
    # windows without enough samples are dropped; the others are matched by their run, start and steps
    unchanged = {piece[:3]: k for k, piece in enumerate(solution.windows.pieces()) if not changed[k]}
    origin = np.array([unchanged.get(piece[:3], -1) for piece in prepared.windows.pieces()])
    same = origin >= 0
    starts = with_rows(prepared.starts, same, pick(solution.starts, origin[same]))
    windows = replace(prepared.first_windows, substeps=solution.windows.substeps)
    problem = replace(solution.problem, windows=windows)
    evaluation = problem.evaluate(solution.values, starts)
    weights = problem.weights(evaluation)
    found = replace(
        solution, problem=problem, starts=starts, evaluation=evaluation, weights=weights, status="not_converged"
    )
    if not same.all():
        found = restart(prepared, found, ~same)
    return prepared, found


def _halves(prepared: Prepared, piece: Piece, dt: float) -> list[Piece]:
    """A window in two pieces, cut at a whole frame; uncut if one of them would have too few frames."""
    frame = max(1, round(prepared.traces[piece.run].interval / dt))
    frames = piece.steps // frame
    if frames < 2 * fewest_frames(prepared.traces[piece.run].links, prepared.simulator.freedoms):
        return [piece]
    first = (frames // 2) * frame
    second = Piece(piece.run, piece.begin + first * dt, piece.steps - first, True)
    return [piece._replace(steps=first), second]


def _leave_out(prepared: Prepared, solution: Solution, lost: np.ndarray) -> tuple[Prepared, Solution]:
    """The preparation without the lost windows, whose times and samples are recorded."""
    windows = solution.windows
    removed = map(Span, windows.run[lost].tolist(), windows.begin[lost].tolist(), windows.ends[lost].tolist())
    prepared = replace(prepared, windows=prepared.windows.exclude(lost), left_out=(*prepared.left_out, *removed))
    problem = replace(solution.problem, windows=windows.exclude(lost))
    found = replace(
        solution,
        problem=problem,
        starts=pick(solution.starts, ~lost),
        evaluation=pick(solution.evaluation, ~lost),
        weights=solution.weights[~lost],
        status="not_converged",
    )
    return prepared, found
