"""Method of a fit: which estimator finds the minimum, and one fit by it with the noise of its own residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.progress import Progress, part_of, silent
from fitting.estimate.least_squares import continue_fit, fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, initial_loss
from fitting.estimate.noise_rounds import fit_with_noise
from fitting.estimate.residual_noise import transfer_solution
from fitting.estimate.shooting import fit_shooting, solve_to_end
from fitting.estimate.solution import Solution
from fitting.estimate.step_size import refine, with_finer_step
from fitting.windows.prepared import Prepared

if TYPE_CHECKING:
    from fitting.estimate.descent import GradientDescent


METHODS = ("windows", "shooting", "gradient")


@dataclass(frozen=True)
class Method:
    """How a fit finds the minimum of its loss.

    Attributes:
        name: `windows` (separate), `shooting` (joined; both by Gauss-Newton steps), or `gradient`: the minimum of
            `shooting` by gradient descent.
        iterations: maximum Gauss-Newton iterations over separate windows.
        descent: of `gradient`; None is its default.
    """

    name: str = "shooting"
    iterations: int = 40
    descent: GradientDescent | None = None

    def __post_init__(self) -> None:
        if self.name not in METHODS:
            raise SceneError(f"method: {self.name!r} is unknown; {nearest(self.name, METHODS)}")
        if self.iterations < 1:
            raise SceneError(f"iterations: {self.iterations} is too small; allowed: at least 1")


def as_method(given: Method | GradientDescent | str) -> Method:
    """The method that a caller means.

    Raises:
        SceneError: an unknown name.
    """
    if isinstance(given, Method):
        return given
    if isinstance(given, str):
        return Method(given)
    return Method("gradient", descent=given)


def with_residual_noise(prepared: Prepared, solution: Solution) -> Solution:
    """A fit repeated until its noise is that of its own residuals."""
    return fit_with_noise(solution, continue_fit, prepared.claimed_windows, prepared.floor, prepared.traces)


def estimate(
    prepared: Prepared,
    method: Method | GradientDescent | str = "shooting",
    loss: Loss = LEAST_SQUARES,
    progress: Progress = silent,
    frozen: np.ndarray | None = None,
) -> Solution:
    """Run an estimator; arguments as in `fit`, with `frozen` parameters (k,) bool at their start values."""
    method = as_method(method)
    if method.name == "gradient":
        from fitting.estimate.descent import GradientDescent  # noqa: PLC0415 - optax is slow to import

        # only the steps differ: windows, noise, gap weight and time step are the default ones
        by_gradient = replace(prepared, descent=method.descent or GradientDescent())
        solution = estimate(by_gradient, replace(method, name="shooting"), loss, progress, frozen)
        return replace(solution, problem=replace(solution.problem, descent=None))
    share = 0.5 if method.name == "shooting" else 0.9
    solution = fit_windows(
        prepared.problem(initial_loss(loss), frozen),
        prepared.values,
        prepared.starts,
        iterations=method.iterations,
        progress=part_of(progress, 0.05, 0.05 + share),
    )
    if solution.status != "ok":
        return solution
    last = part_of(progress, 0.95, 0.95)
    refined = partial(refine, progress=last)
    solution = with_residual_noise(prepared, solution)
    if solution.problem.loss != loss:
        there = replace(solution.problem, loss=loss)
        solution = with_residual_noise(prepared, continue_fit(transfer_solution(solution, there, solution.evaluation)))
    if method.name == "windows":
        return refined(solution)
    joined = fit_shooting(solution, finer=with_finer_step, progress=part_of(progress, 0.55, 0.95))
    if joined.status != "ok":
        return joined
    return solve_to_end(refined(with_residual_noise(prepared, joined)), last)
