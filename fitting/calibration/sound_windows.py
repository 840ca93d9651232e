"""The first fit of separate windows: windows that a fit can follow, and joins that it can tighten."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dropper_jax.base.errors import Progress, part_of, silent
from fitting.calibration.lost_windows import recover_windows
from fitting.calibration.prepared import Prepared
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise import Noise
from fitting.estimate.residuals import Problem, Solution
from fitting.estimate.uncertainty import start_covariances

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
    noise = Noise.of_misfit(solution.errors, windows, np.ones((len(prepared.traces), windows.theta.shape[2])))
    if (noise.factor.max(axis=1) > UNEVEN_RATIO * noise.factor.min(axis=1)).any():
        return noise
    return None


#: Ratio of a gap's mean square to its expectation above which windows are not joined.
BROKEN_GAP_DISTANCE = 25.0
#: Ratio of its size to the median gap above which they are not.
BROKEN_GAP_RATIO = 5.0
#: Maximum fraction of such gaps.
MOST_BREAKS = 0.03
#: Minimum number of gaps that define what is usual.
FEWEST_GAPS = 6


def break_far_gaps(prepared: Prepared, solution: Solution) -> Prepared:
    """The preparation without joins over isolated gaps far above the others, such as a kick or lost frames."""
    windows = solution.windows
    if windows.follows.sum() < FEWEST_GAPS or solution.status != "ok":
        return prepared
    found = solution.problem.gaps(solution.evaluation, solution.values)
    covariance, _ = start_covariances(solution)
    spread = found.before @ covariance[found.left] @ found.before.mT
    spread += found.after @ covariance[found.left + 1] @ found.after.mT
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
