"""One fit by one of the estimators, with noise estimated from its own residuals, and without windows that are lost.

Windows that a free start cannot reduce to the noise: detected, restarted, split and finally left out.

A chaotic motion has wrong branches: a link that turns over in the other direction leaves its window far from the
samples, and one such window biases all estimates. A window is lost if

    chi2_k/(N_k - m) > FAR max(1, median)     and beyond chance, with its own start fitted and the parameters fixed

(m numbers of a start; chi2_k bounds each sample's contribution, so that outliers do not decide). It is restarted from
the end of the previous window and from the samples at several reaches. If nothing helps it is split, down to the
minimum number of frames that determine a start. Windows that stay lost are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from dropper_jax.base.errors import Progress, silent
from fitting.calibration.kicks import lost_frames, starts_from_previous_windows
from fitting.calibration.prepared import Prepared
from fitting.estimate.gaps import gaps
from fitting.estimate.gauss_newton import continue_windows, fit_starts, fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise import Noise
from fitting.estimate.problem import Problem, Solution
from fitting.estimate.residual_noise import pose_again, with_residual_noise
from fitting.estimate.sandwich import start_covariances
from fitting.estimate.shooting import continue_shooting, fit_shooting, solve_to_end
from fitting.estimate.uncertainty import finer_step, refine
from fitting.estimate.windows import Piece, Starts, Windows, fewest_frames, first_starts

#: Ratio of a window's mean square residual to that of most windows above which it is lost, and the probability of such
#: a ratio by noise alone.
FAR, CHANCE = 4.0, 1e-7
#: RMS error [rad] below which no window is lost, and the same if the model itself misses most windows: a wrong branch
#: of a link deviates much more, rounding and the friction of a bearing less.
SMALLEST, BRANCH = 2e-3, 0.05
#: Ratio of a gap's mean square to its expectation, and of its size to the median gap, above which windows are not
#: joined; maximum fraction of such gaps, and minimum number of gaps that define what is usual.
FAR_GAP, LARGE_GAP, MOST_BREAKS, FEWEST_GAPS = 25.0, 5.0, 0.03, 6
#: Rounds of restarts and fits, and evaluations for the starts alone.
ROUNDS, ITERATIONS = 4, 12


def lost_windows(solution: Solution) -> np.ndarray:
    """Windows (K,) bool that miss their samples by far more than the noise and than the other windows."""
    windows, m2 = solution.windows, solution.problem.freedoms
    known = (windows.weight > 0).sum(axis=(1, 2))
    freedom = np.maximum(known - np.where(windows.released, 0, m2), 1)
    square = solution.evaluation.residual.reshape(windows.count, -1) ** 2
    usual = lambda size: max(1.0, float(np.median(size[known > 0]))) if known.any() else 1.0  # noqa: E731
    unit = usual(square.sum(axis=1) / freedom)
    # maximum contribution of a sample, as a multiple of the mean square of most windows: one outlier cannot make a
    # window lost. 10 % of the samples must deviate by more than five standard deviations, as on a wrong branch
    size = np.minimum(square, 30.0 * unit).sum(axis=1) / freedom
    size = np.where(np.isfinite(size), size, np.inf)
    typical = usual(size)
    limit = typical * np.maximum(FAR, chdtri(freedom, CHANCE) / freedom)
    rms = np.sqrt(np.sum(solution.errors**2, axis=(1, 2)) / np.maximum(known, 1))
    noise = solution.problem.noise
    assumed = 1.0 if noise is None else float(np.mean(noise.factor**2))
    explained = typical * assumed < FAR / 2
    return (known > 0) & (size > limit) & ~(rms < (SMALLEST if explained else BRANCH))


def costs(problem: Problem, residual: np.ndarray) -> np.ndarray:
    """Loss of each window (K,)."""
    return np.array([problem.loss.cost(one) if np.isfinite(one).all() else np.inf for one in residual])


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
    for last in (False,) * ROUNDS + (True,):
        solution = refit_starts(solution) if solution.status != "ok" else solution
        lost = lost_windows(solution) & ~_windows_at(solution.windows, jump)
        if not lost.any():
            break
        if last:
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
    windows = solution.windows
    seen = replace(windows, weight=np.where(lost[:, None, None], 0.0, windows.weight))
    found = lost_frames(prepared, replace(solution, problem=replace(solution.problem, windows=seen)))
    return None if found is None else (found.run, float(prepared.traces[found.run].t[found.frame]))


def _windows_at(windows: Windows, jump: tuple[int, float] | None) -> np.ndarray:
    """The windows (K,) bool that contain a given time of a run, and those that start or end there."""
    if jump is None:
        return np.zeros(windows.count, bool)
    run, time = jump
    return (windows.run == run) & (windows.begin - windows.dt <= time) & (time <= windows.ends + windows.dt)


def refit_starts(solution: Solution, which: np.ndarray | None = None) -> Solution:
    """The solution with the start of each window, or of some (K,) bool, fitted alone with fixed parameters."""
    which = np.ones(solution.windows.count, bool) if which is None else which
    starts = Starts(*(part[which] for part in solution.starts))
    return _with_starts(solution, which, starts)


def restart(prepared: Prepared, solution: Solution, lost: np.ndarray) -> Solution:
    """The solution with better starts of lost windows (K,) bool, if any are found."""
    windows, traces = solution.windows.pick(lost), prepared.traces
    model = solution.problem.simulator.model_at(solution.values)
    tried = [Starts(*(part[lost] for part in starts_from_previous_windows(solution, lost)))]
    # noise assumed for the starts of lost windows relative to the true one: polynomials of short reach, of the reach
    # that the noise allows, and of long reach
    for share in (0.2, 1.0, 5.0):
        tried.append(first_starts(model, traces, windows, [share * s for s in prepared.sigma]))
    for starts in tried:
        solution = _with_starts(solution, lost, starts)
    return solution


def _with_starts(solution: Solution, which: np.ndarray, starts: Starts) -> Solution:
    """The solution with other starts of some windows, fitted alone first, if these are better."""
    problem, windows = solution.problem, solution.windows
    few = replace(problem, windows=windows.pick(which))
    starts, evaluation = fit_starts(few, solution.values, starts, ITERATIONS)
    index = np.flatnonzero(which)
    better = costs(problem, evaluation.residual) < costs(problem, solution.evaluation.residual[index])
    if not better.any():
        return solution
    old = Starts(*(part.copy() for part in solution.starts))
    for part, new in zip(old, starts, strict=True):
        part[index[better]] = new[better]
    whole = type(evaluation)(*(part.copy() for part in solution.evaluation))
    for part, new in zip(whole, evaluation, strict=True):
        part[index[better]] = new[better]
    return replace(solution, starts=old, evaluation=whole, weights=problem.weights(whole))


def _split(prepared: Prepared, solution: Solution, lost: np.ndarray) -> tuple[Prepared, Solution]:
    """The solution with lost windows cut in two if enough frames remain; the halves start from the samples."""
    windows = solution.windows
    pieces: list[Piece] = []
    old: list[int] = []
    for k in range(windows.count):
        halves = _halves(prepared, windows, k) if lost[k] and not windows.released[k] else [windows.piece(k)]
        pieces += halves
        old += [k if len(halves) == 1 else -1] * len(halves)
    if len(pieces) == windows.count:
        return prepared, solution
    prepared = prepared.with_pieces(pieces)
    # windows without enough samples are dropped; the others are matched by their start time
    kept_at = {(int(r), round(float(b), 9)): i for i, (r, b) in enumerate(zip(windows.run, windows.begin, strict=True))}
    new = prepared.windows
    origin = np.array([kept_at.get((int(r), round(float(b), 9)), -1) for r, b in zip(new.run, new.begin, strict=True)])
    same = (origin >= 0) & (new.step_counts == np.where(origin >= 0, windows.step_counts[origin], 0))
    starts = Starts(*(part.copy() for part in prepared.starts))
    for part, was in zip(starts, solution.starts, strict=True):
        part[same] = was[origin[same]]
    problem = replace(solution.problem, windows=replace(prepared.first_windows, substeps=windows.substeps))
    evaluation = problem.evaluate(solution.values, starts)
    found = replace(solution, problem=problem, starts=starts, evaluation=evaluation, status="not_converged")
    found = replace(found, weights=problem.weights(evaluation))
    return prepared, restart(prepared, found, ~same) if (~same).any() else found


def _halves(prepared: Prepared, windows: Windows, k: int) -> list[Piece]:
    """Window k in two pieces, cut at a whole frame; uncut if one of them would have too few frames."""
    piece = windows.piece(k)
    frame = max(1, round(prepared.traces[piece.run].interval / windows.dt))
    frames = piece.steps // frame
    if frames < 2 * fewest_frames(prepared.traces[piece.run].links, prepared.simulator.freedoms):
        return [piece]
    first = (frames // 2) * frame
    return [
        piece._replace(steps=first),
        Piece(piece.run, piece.begin + first * windows.dt, piece.steps - first, True),
    ]


def break_far_gaps(prepared: Prepared, solution: Solution) -> Prepared:
    """The preparation without joins over isolated gaps far above the others, such as a kick or lost frames."""
    windows = solution.windows
    if windows.follows.sum() < FEWEST_GAPS or solution.status != "ok":
        return prepared
    found = gaps(solution.problem.simulator, windows, solution.evaluation, solution.values)
    covariance, _ = start_covariances(solution)
    spread = found.before @ covariance[found.left] @ np.swapaxes(found.before, 1, 2)
    spread += found.after @ covariance[found.left + 1] @ np.swapaxes(found.after, 1, 2)
    distance = np.einsum("gi,gi->g", found.value, np.linalg.solve(spread, found.value[..., None])[..., 0])
    distance, size = distance / found.value.shape[1], np.linalg.norm(found.value, axis=1)
    far = (distance > FAR_GAP * max(1.0, np.median(distance))) & (size > LARGE_GAP * np.median(size))
    if not 0 < far.sum() <= max(1, MOST_BREAKS * len(far)):
        return prepared
    follows = prepared.windows.follows.copy()
    right = found.left[far] + 1
    follows[right] = False
    breaks = tuple((int(windows.run[k]), float(windows.begin[k])) for k in right)
    return replace(prepared, windows=replace(prepared.windows, follows=follows), breaks=(*prepared.breaks, *breaks))


def _leave_out(prepared: Prepared, solution: Solution, lost: np.ndarray) -> tuple[Prepared, Solution]:
    """The preparation without the lost windows, whose times and samples are recorded."""
    windows = solution.windows
    removed = tuple(
        (int(windows.run[k]), float(windows.begin[k]), float(windows.ends[k])) for k in np.flatnonzero(lost)
    )
    prepared = replace(prepared, windows=prepared.windows.exclude(lost), left_out=(*prepared.left_out, *removed))
    problem = replace(solution.problem, windows=windows.exclude(lost))
    pick = lambda parts: type(parts)(*(part[~lost] for part in parts))  # noqa: E731
    found = replace(solution, problem=problem, starts=pick(solution.starts), evaluation=pick(solution.evaluation))
    return prepared, replace(found, weights=solution.weights[~lost], status="not_converged")


#: Maximum iterations of a first fit before links are weighted by their misfit and windows are inspected one by one.
EARLY, FIRST = 5, 15


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
    say = lambda fraction, text: progress(0.05 + 0.3 * fraction, text)  # noqa: E731

    def fit_again(problem: Problem, before: Solution) -> Solution:
        found = fit_windows(problem, before.values, before.starts, iterations=min(FIRST, iterations), progress=say)
        return replace(found, iterations=before.iterations + found.iterations)

    problem = prepared.problem(initial_loss(loss))
    solution = fit_windows(problem, prepared.values, prepared.starts, iterations=min(EARLY, iterations), progress=say)
    if solution.status != "ok" and iterations > EARLY:
        prepared = replace(prepared, first_noise=uneven_noise(prepared, solution))
        solution = fit_again(prepared.problem(initial_loss(loss)), solution)
    prepared, solution = recover_windows(prepared, solution, fit_again, keep_jumps)
    if not keep_jumps:
        prepared = break_far_gaps(prepared, solution)
    return replace(prepared, begin=solution.values, starts=solution.starts, iterations=solution.iterations)


def uneven_noise(prepared: Prepared, solution: Solution) -> Noise | None:
    """The noise scaled to each link's residuals, if the ratios of residuals to claimed noise differ between links.

    The claimed noise of an encoder is 1 % of the model error caused by its bearing. With the claimed noise alone, one
    link would have many times the weight of another.
    """
    weight = prepared.windows.weight
    square, known = (solution.errors * weight) ** 2, weight > 0
    noise = Noise.as_claimed(len(prepared.traces), weight.shape[2])
    for run in np.unique(prepared.windows.run):
        mine = prepared.windows.run == run
        mean = square[mine].sum(axis=(0, 1)) / np.maximum(known[mine].sum(axis=(0, 1)), 1)
        noise.factor[run] = np.sqrt(np.maximum(mean, 1.0))
    # ratio of two links' misfits, in units of their noise, above which links are weighted by misfit
    return noise if (noise.factor.max(axis=1) > 3.0 * noise.factor.min(axis=1)).any() else None


def estimate(
    prepared: Prepared,
    method: str = "shooting",
    loss: Loss = LEAST_SQUARES,
    continuity: str = "estimate",
    iterations: int = 40,
    progress: Progress = silent,
    settings: Mapping[str, Any] | None = None,
    frozen: np.ndarray | None = None,
) -> Solution:
    """Run an estimator; arguments as in `fit`."""
    if method == "gradient":  # only the steps differ: windows, noise, gap weight and time step are the default ones
        from fitting.estimate.gradient import descent_of  # noqa: PLC0415 - optax is slow to import

        descent, progress = descent_of(settings or {}, progress)
        problem = prepared.problem(initial_loss(loss), frozen)
        values, starts, history = descent.first_stages(problem, prepared.values, prepared.starts)
        started = replace(prepared, descent=descent, begin=values, starts=starts)
        found = estimate(started, "shooting", loss, continuity, iterations, progress, frozen=frozen)
        posed_again = replace(found.problem, descent=None)
        return replace(found, problem=posed_again, history=[*history, *found.history])
    share = 0.5 if method == "shooting" else 0.9
    solution = fit_windows(
        prepared.problem(initial_loss(loss), frozen),
        prepared.values,
        prepared.starts,
        iterations=iterations,
        progress=lambda fraction, text: progress(0.05 + share * fraction, text),
    )
    if solution.status != "ok":
        return solution
    own_noise = partial(with_residual_noise, claimed=prepared.windows, traces=prepared.traces, floor=prepared.floor)
    refined = partial(refine, progress=lambda _, text: progress(0.95, text))
    solution = own_noise(solution, again=continue_windows)
    if solution.problem.loss != loss:
        there = replace(solution.problem, loss=loss)
        solution = own_noise(continue_windows(pose_again(solution, there, solution.evaluation)), again=continue_windows)
    if method == "windows":
        return refined(solution)
    joined = fit_shooting(
        solution,
        continuity=continuity,
        finer=finer_step,
        progress=lambda fraction, text: progress(0.55 + 0.4 * fraction, text),
    )
    if joined.status != "ok":
        return joined
    return solve_to_end(refined(own_noise(joined, again=continue_shooting)))
