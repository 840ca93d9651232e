"""Windows that a free start cannot reduce to the noise: detected, restarted, split and finally left out.

A chaotic motion has wrong branches: a link that turns over in the other direction leaves its window far from the
samples, and one such window biases all estimates. A window is lost if

    chi2_k/(N_k - m) > LOST_RATIO max(1, median)    and beyond chance, with its own start fitted, the parameters fixed

(m numbers of a start; chi2_k bounds each sample's contribution, so that outliers do not decide). It is restarted from
the end of the previous window and from the samples at several reaches. If nothing helps it is split, down to the
minimum number of frames that determine a start. Windows that stay lost are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_starts, window_costs
from fitting.estimate.solution import Solution
from fitting.estimate.window_problem import Problem
from fitting.estimate.windows import Piece, Span, Starts, Windows, fewest_frames, pick, with_rows
from fitting.windows.lost_frames import lost_frames, starts_from_previous_windows
from fitting.windows.prepared import Prepared

#: Ratio of a window's mean square residual to that of most windows above which it is lost.
LOST_RATIO = 4.0
#: Probability of such a ratio by noise alone below which it is lost.
LOST_PROBABILITY = 1e-7
#: RMS error [rad] below which no window is lost: rounding and the friction of a bearing deviate less.
LEAST_LOST_ERROR = 2e-3
#: The same if the model itself misses most windows: a wrong branch of a link deviates much more.
BRANCH_ERROR = 0.05
#: Rounds of restarts and fits.
RECOVERY_ROUNDS = 4
#: Evaluations for the starts alone.
START_ITERATIONS = 12
#: Maximum contribution of a sample, as a multiple of the mean square of most windows: one outlier cannot make a window
#: lost. 10 % of the samples must deviate by more than five standard deviations, as on a wrong branch.
LARGEST_SQUARE = 30.0


def lost_windows(solution: Solution) -> np.ndarray:
    """Windows (K,) bool that miss their samples by far more than the noise and than the other windows."""
    windows = solution.windows
    known = windows.known.sum(axis=(1, 2))
    freedom = np.maximum(known - np.where(windows.released, 0, solution.problem.freedoms), 1)
    square = solution.evaluation.residual.reshape(windows.count, -1) ** 2
    unit = _typical_size(square.sum(axis=1) / freedom, known)
    size = np.minimum(square, LARGEST_SQUARE * unit).sum(axis=1) / freedom
    size = np.where(np.isfinite(size), size, np.inf)
    typical = _typical_size(size, known)
    limit = typical * np.maximum(LOST_RATIO, chdtri(freedom, LOST_PROBABILITY) / freedom)
    rms = np.sqrt(np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(known, 1))
    noise = solution.problem.noise
    assumed = 1.0
    if noise is not None:
        assumed = np.mean(noise.factor**2)
    smallest = BRANCH_ERROR
    if typical * assumed < LOST_RATIO / 2:  # the model explains most windows
        smallest = LEAST_LOST_ERROR
    small = rms < smallest  # not of NaN
    return (known > 0) & (size > limit) & ~small


def _typical_size(size: np.ndarray, known: np.ndarray) -> float:
    """The median over the windows with samples, at least 1."""
    if not known.any():
        return 1.0
    return max(1.0, np.median(size[known > 0]))


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
    found = fit_starts(few, solution.values, starts, START_ITERATIONS)
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
    prepared = prepared.with_pieces(pieces)
    # windows without enough samples are dropped; the others are matched by their run, start and steps
    whole = {piece[:3]: k for k, piece in enumerate(windows.pieces())}
    origin = np.array([whole.get(piece[:3], -1) for piece in prepared.windows.pieces()])
    same = origin >= 0
    starts = with_rows(prepared.starts, same, pick(solution.starts, origin[same]))
    problem = replace(solution.problem, windows=replace(prepared.first_windows, substeps=windows.substeps))
    evaluation = problem.evaluate(solution.values, starts)
    found = replace(
        solution,
        problem=problem,
        starts=starts,
        evaluation=evaluation,
        weights=problem.weights(evaluation),
        status="not_converged",
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
