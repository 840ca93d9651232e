"""The first fit of separate windows: windows that a fit can follow, and joins that it can tighten."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, part_of, silent
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise import Noise
from fitting.estimate.normal_equations import Gaps
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import start_covariances
from fitting.estimate.window_problem import Problem
from fitting.windows.lost_frames import windows_far_off
from fitting.windows.prepared import Prepared
from fitting.windows.recover_windows import recover_windows

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

    Lost windows are restarted, split or left out, see `recover_windows`.

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
    usual = ~windows_far_off(solution)  # one outlier would count as the noise of its link
    windows = prepared.windows.pick(usual)
    claimed = np.ones((len(prepared.traces), windows.theta.shape[2]))
    noise = Noise.of_misfit(solution.errors[usual], windows, claimed)
    if (noise.factor.max(axis=1) > UNEVEN_RATIO * noise.factor.min(axis=1)).any():
        return noise
    return None


#: A gap is far if its mean square is above this multiple of its expectation (five standard deviations) and of the
#: median one, which is large where the model misses the whole trace;
FAR_GAP_SQUARE = 25.0
#: and if its size is above this multiple of the median one: of nearly closed gaps, the errors alone are too small.
FAR_GAP_RATIO = 5.0
#: Maximum fraction of far gaps: more of them are a misfit of the model and not kicks.
MOST_FAR_GAPS = 0.03
#: Minimum number of gaps whose median shows what is usual.
FEWEST_GAPS = 6


def break_far_gaps(prepared: Prepared, solution: Solution) -> Prepared:
    """The preparation without joins over isolated gaps far above the others, such as a kick or lost frames."""
    windows = solution.windows
    if windows.follows.sum() < FEWEST_GAPS or solution.status != "ok":
        return prepared
    gaps = solution.problem.gaps(solution.evaluation, solution.values)
    far = _far_gaps(gaps, start_covariances(solution)[0])
    if not 0 < far.sum() <= max(1, MOST_FAR_GAPS * len(far)):
        return prepared
    right = gaps.left[far] + 1
    follows = prepared.windows.follows.copy()
    follows[right] = False
    breaks = zip(windows.run[right].tolist(), windows.begin[right].tolist(), strict=True)
    return replace(prepared, windows=replace(prepared.windows, follows=follows), breaks=(*prepared.breaks, *breaks))


def _far_gaps(gaps: Gaps, covariance: np.ndarray) -> np.ndarray:
    """Which gaps (g,) the errors of the starts on both sides, of covariance (K, m2, m2), do not explain."""
    expected = gaps.before @ covariance[gaps.left] @ gaps.before.mT
    expected += gaps.after @ covariance[gaps.left + 1] @ gaps.after.mT
    square = np.mean(gaps.value * np.linalg.solve(expected, gaps.value[..., None])[..., 0], axis=1)
    size = np.linalg.norm(gaps.value, axis=1)
    far = square > FAR_GAP_SQUARE * max(1.0, np.median(square))
    return far & (size > FAR_GAP_RATIO * np.median(size))
