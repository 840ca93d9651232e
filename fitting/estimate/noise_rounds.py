"""Rounds of fit and noise estimate, up to their common fixed point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fitting.estimate.noise import Noise
from fitting.estimate.residual_noise import ResidualNoiseModel, memory_of
from fitting.estimate.solution import Solution
from fitting.estimate.windows import Windows
from fitting.traces.trace import Trace

#: Maximum number of rounds of fit and noise.
NOISE_ROUNDS = 3
#: Change of the noise below which another fit would change nothing: an error of 5 % of the weights costs less than 0.01
#: standard errors.
NOISE_TOLERANCE = 0.05


def fit_with_noise(
    solution: Solution,
    refit: Callable[[Solution], Solution],
    claimed_samples: Callable[[Solution], Windows],
    floor: np.ndarray,
    traces: Sequence[Trace] = (),
    tolerance: float = NOISE_TOLERANCE,
) -> Solution:
    """Alternate noise estimate and fit, up to their common fixed point; the noise alone of a fit that failed.

    Args:
        solution: the end of a fit.
        refit: continues from a solution whose noise has changed.
        claimed_samples: the samples of a solution with the claimed noise.
        floor, traces: as for `ResidualNoiseModel`.
        tolerance: change of the noise below which another fit would change nothing.
    """
    for _ in range(NOISE_ROUNDS):
        before = solution.problem.noise or Noise.as_claimed(*floor.shape)
        solution = ResidualNoiseModel(solution, claimed_samples(solution), traces, floor).estimate(before)
        if traces:  # sensors of different kinds have no common memory
            solution = replace(solution, problem=replace(solution.problem, memory=memory_of(solution)))
        if solution.problem.noise.max_relative_difference(before) < tolerance or solution.status != "ok":
            break
        further = refit(solution)
        if further.status != "ok":
            break
        solution = replace(further, iterations=further.iterations + solution.iterations)
    return solution
