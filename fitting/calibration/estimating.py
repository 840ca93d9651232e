"""One fit by one of the estimators, with the noise estimated from its own residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dropper_jax.base.progress import Progress, silent
from fitting.calibration.lost_windows import break_far_gaps, recover_windows
from fitting.calibration.prepared import Prepared
from fitting.estimate.gauss_newton import continue_windows, fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise import Noise
from fitting.estimate.problem import Problem, Solution
from fitting.estimate.refinement import finer_step, refine
from fitting.estimate.residual_noise import pose_again, with_residual_noise
from fitting.estimate.shooting import continue_shooting, fit_shooting, solve_to_end

#: Maximum iterations of a first fit before links are weighted by their misfit and windows are inspected one by one.
EARLY, FIRST = 5, 15
#: Ratio of two links' misfits, in units of their noise, above which links are weighted by misfit.
UNEVEN = 3.0


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
    return noise if (noise.factor.max(axis=1) > UNEVEN * noise.factor.min(axis=1)).any() else None


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
