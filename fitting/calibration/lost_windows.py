"""Windows that a free start cannot reduce to the noise: detected, restarted, split and finally left out.

A chaotic motion has wrong branches: a link that turns over in the other direction leaves its window far from the
samples, and one such window biases all estimates. A window is lost if

    chi2_k/(N_k - m) > FAR max(1, median)     and beyond chance, with its own start fitted and the parameters fixed

(m numbers of a start; chi2_k bounds each sample's contribution, so that outliers do not decide). It is restarted from
the end of the previous window and from the samples at several reaches. If nothing helps it is split, down to the
minimum number of frames that determine a start. Windows that stay lost are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from dropper_jax.base.errors import Progress, part_of, silent
from fitting.calibration.lost_frames import lost_frames, starts_from_previous_windows
from fitting.calibration.prepared import Prepared
from fitting.estimate.first_starts import first_starts
from fitting.estimate.least_squares import fit_starts, fit_windows, window_costs
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise import Noise
from fitting.estimate.residuals import Problem, Solution
from fitting.estimate.uncertainty import start_covariances
from fitting.estimate.windows import Piece, Span, Starts, Windows, fewest_frames, pick, with_rows

#: Ratio of a window's mean square residual to that of most windows above which it is lost.
LOST_RATIO = 4.0
#: Probability of such a ratio by noise alone below which it is lost.
LOST_PROBABILITY = 1e-7
#: RMS error [rad] below which no window is lost: rounding and the friction of a bearing deviate less.
LEAST_LOST_ERROR = 2e-3
#: The same if the model itself misses most windows: a wrong branch of a link deviates much more.
BRANCH_ERROR = 0.05
#: Ratio of a gap's mean square to its expectation above which windows are not joined.
BROKEN_GAP_DISTANCE = 25.0
#: Ratio of its size to the median gap above which they are not.
BROKEN_GAP_RATIO = 5.0
#: Maximum fraction of such gaps.
MOST_BREAKS = 0.03
#: Minimum number of gaps that define what is usual.
FEWEST_GAPS = 6
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
    known = (windows.weight > 0).sum(axis=(1, 2))
    freedom = np.maximum(known - np.where(windows.released, 0, solution.problem.freedoms), 1)
    square = solution.evaluation.residual.reshape(windows.count, -1) ** 2
    unit = _usual(square.sum(axis=1) / freedom, known)
    size = np.minimum(square, LARGEST_SQUARE * unit).sum(axis=1) / freedom
    size = np.where(np.isfinite(size), size, np.inf)
    typical = _usual(size, known)
    limit = typical * np.maximum(LOST_RATIO, chdtri(freedom, LOST_PROBABILITY) / freedom)
    rms = np.sqrt(np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(known, 1))
    noise = solution.problem.noise
    assumed = 1.0
    if noise is not None:
        assumed = float(np.mean(noise.factor**2))
    smallest = BRANCH_ERROR
    if typical * assumed < LOST_RATIO / 2:  # the model explains most windows
        smallest = LEAST_LOST_ERROR
    small = rms < smallest  # not of NaN
    return (known > 0) & (size > limit) & ~small


def _usual(size: np.ndarray, known: np.ndarray) -> float:
    """The median over the windows with samples, at least 1."""
    if not known.any():
        return 1.0
    return max(1.0, float(np.median(size[known > 0])))


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
    return (found.run, float(prepared.traces[found.run].t[found.frame]))


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
    starts, evaluation = fit_starts(few, solution.values, starts, START_ITERATIONS)
    better = window_costs(problem, evaluation.residual) < window_costs(problem, solution.evaluation.residual[which])
    if not better.any():
        return solution
    replaced = np.flatnonzero(which)[better]
    every = with_rows(solution.starts, replaced, pick(starts, better))
    whole = with_rows(solution.evaluation, replaced, pick(evaluation, better))
    return replace(solution, starts=every, evaluation=whole, weights=problem.weights(whole))


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
    found = replace(solution, problem=problem, starts=starts, evaluation=evaluation, status="not_converged")
    found.weights = problem.weights(evaluation)
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


def break_far_gaps(prepared: Prepared, solution: Solution) -> Prepared:
    """The preparation without joins over isolated gaps far above the others, such as a kick or lost frames."""
    windows = solution.windows
    if windows.follows.sum() < FEWEST_GAPS or solution.status != "ok":
        return prepared
    found = solution.problem.gaps(solution.evaluation, solution.values)
    covariance, _ = start_covariances(solution)
    spread = found.before @ covariance[found.left] @ np.swapaxes(found.before, 1, 2)
    spread += found.after @ covariance[found.left + 1] @ np.swapaxes(found.after, 1, 2)
    distance = np.mean(found.value * np.linalg.solve(spread, found.value[..., None])[..., 0], axis=1)
    size = np.linalg.norm(found.value, axis=1)
    far = (distance > BROKEN_GAP_DISTANCE * max(1.0, np.median(distance))) & (size > BROKEN_GAP_RATIO * np.median(size))
    if not 0 < far.sum() <= max(1, MOST_BREAKS * len(far)):
        return prepared
    right = found.left[far] + 1
    follows = prepared.windows.follows.copy()
    follows[right] = False
    breaks = zip(windows.run[right].tolist(), windows.begin[right].tolist(), strict=True)
    return replace(prepared, windows=replace(prepared.windows, follows=follows), breaks=(*prepared.breaks, *breaks))


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


#: Maximum iterations of a first fit before links are weighted by their misfit and windows are inspected one by one.
EARLY_ITERATIONS = 5
FIRST_ITERATIONS = 15


def with_sound_windows(
    prepared: Prepared,
    loss: Loss = LEAST_SQUARES,
    iterations: int = 40,
    progress: Progress = silent,
    keep_jumps: bool = False,
) -> Prepared:
    """The preparation with windows that a fit can follow, started from the end of their fit.

    Lost windows are restarted, split or left out, see `lost_windows`.

    Args:
        keep_jumps: leave windows with missing frames unchanged, so that `freeing` can report them.
    """
    say = part_of(progress, 0.05, 0.35)

    def fit_again(problem: Problem, before: Solution) -> Solution:
        found = fit_windows(
            problem, before.values, before.starts, iterations=min(FIRST_ITERATIONS, iterations), progress=say
        )
        return replace(found, iterations=before.iterations + found.iterations)

    problem = prepared.problem(initial_loss(loss))
    solution = fit_windows(
        problem, prepared.values, prepared.starts, iterations=min(EARLY_ITERATIONS, iterations), progress=say
    )
    if solution.status != "ok" and iterations > EARLY_ITERATIONS:
        prepared = replace(prepared, first_noise=uneven_noise(prepared, solution))
        solution = fit_again(prepared.problem(initial_loss(loss)), solution)
    prepared, solution = recover_windows(prepared, solution, fit_again, keep_jumps)
    if not keep_jumps:
        prepared = break_far_gaps(prepared, solution)
    return replace(prepared.starting_at(solution), iterations=solution.iterations)


#: Ratio of two links' misfits, in units of their noise, above which links are weighted by their misfit.
UNEVEN_RATIO = 3.0


def uneven_noise(prepared: Prepared, solution: Solution) -> Noise | None:
    """The noise scaled to each link's residuals, if the ratios of residuals to claimed noise differ between links.

    The claimed noise of an encoder is 1 % of the model error caused by its bearing. With the claimed noise alone, one
    link would have many times the weight of another.
    """
    windows = prepared.windows
    floor = np.ones((len(prepared.traces), windows.theta.shape[2]))
    noise = Noise.of_misfit(solution.errors * windows.weight, windows.weight > 0, windows.run, floor)
    if (noise.factor.max(axis=1) > UNEVEN_RATIO * noise.factor.min(axis=1)).any():
        return noise
    return None
