"""Objective of a fit: the cost of windows that are separate or joined by gaps, its normal equations and full step.

minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + 1/2 sum |gaps/w|^2 + prior
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError

from fitting.estimate.normal_equations import Evaluation, Normal, Step, eliminate, join
from fitting.estimate.residuals import Residuals
from fitting.estimate.solution import Solution, Visited

#: A fit has converged if the next step would move the parameters by less than this [standard errors, squared],
#: and would lower chi-square by less than this times the root of the number of samples.
STEP_TOLERANCE = 1e-4
DECREASE_TOLERANCE = 1e-2
#: The same tolerances at intermediate gap weights: parameters within 0.2 standard errors, evidence within 0.25.
#: Only the chosen weight is solved to the end.
INTERMEDIATE_STEP = 0.2**2
INTERMEDIATE_DECREASE = 0.5
#: Damping of the first step, of separate and of joined windows.
FIRST_DAMPING = 1e-3
JOINED_DAMPING = 1e-4


class Objective:
    """Cost and steps of windows that are separate, or joined by gaps of one weight.

    Args:
        weight: of the gaps; None: the windows are separate.
        intermediate: whether the descent only has to be accurate enough for the choice of the weight.

    Attributes:
        damping: of the first step.
        goal: message if the descent does not converge.
        close: convergence limit of the parameters' next step in standard errors, squared.
    """

    def __init__(self, problem: Residuals, weight: float | None = None, intermediate: bool = False) -> None:
        self.problem = problem
        self.weight = weight
        self.intermediate = intermediate
        self.close = STEP_TOLERANCE
        if intermediate:
            self.close = INTERMEDIATE_STEP
        self.damping = FIRST_DAMPING
        self.goal = "no convergence"
        if weight is not None:
            self.damping = JOINED_DAMPING
            self.goal = f"no convergence at gap weight {weight:g}"

    def little(self) -> float:
        """Permitted remaining decrease of chi-square: well below its own standard deviation."""
        if self.intermediate:
            return INTERMEDIATE_DECREASE
        return DECREASE_TOLERANCE * np.sqrt(self.problem.samples)

    def cost(self, evaluation: Evaluation, values: np.ndarray) -> float:
        """The objective; infinite if the motion is not finite."""
        total = self.problem.data_cost(evaluation) + self.problem.prior(values).cost
        if not np.isfinite(total):
            return np.inf
        if self.weight is None:
            return total
        value = self.problem.gaps(evaluation, values).value
        return total + 0.5 * np.sum((value / self.weight) ** 2)

    def unit(self, evaluation: Evaluation, cost: float) -> float:
        """Variance of the noise in units of the assumed one, multiplied by the memory of the samples."""
        if self.weight is not None:
            cost = self.problem.data_cost(evaluation)
        return 2 * cost / max(self.problem.samples, 1) * self.problem.memory

    def system(self, evaluation: Evaluation, values: np.ndarray) -> Normal:
        """Normal equations."""
        normal = self.problem.normal(evaluation)
        if self.weight is None:
            return normal
        return join(normal, self.problem.gaps(evaluation, values), self.weight)

    def solve(
        self, system: Normal, values: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray
    ) -> Step | None:
        """The damped step with parameter changes between low and high (k,); None if the equations are singular."""
        try:
            return eliminate(system, damping, self.problem.prior(values), low, high)
        except LinAlgError:
            return None

    def undamped_step(
        self, evaluation: Evaluation, values: np.ndarray, reach: np.ndarray | float | None = None
    ) -> Step | None:
        """The step without damping; parameters move by at most `reach` (k,), by default inside their bounds."""
        if reach is None:
            limits = self.problem.step_bounds(values)
        else:
            limits = np.outer([-1, 1], reach + 0 * values)
        return self.solve(self.system(evaluation, values), values, 0.0, *limits)

    def evidence(self, point: Solution) -> float:
        """Laplace's log evidence of the gap weight w, up to constants: -cost - (gaps) log w - log det H / 2.

        The cost is the minimum of its linear model at the point.
        """
        step = self.undamped_step(point.evaluation, point.values)
        if step is None:
            return -np.inf
        return step.predicted - self.cost(point.evaluation, point.values) - self.log_volume(step)

    def log_volume(self, step: Step) -> float:
        """The terms of the evidence that are not the cost; without joins all weights are one."""
        if self.weight is None:
            return 0.0
        count = self.problem.windows.follows.sum() * self.problem.freedoms
        return count * np.log(self.weight) + 0.5 * step.log_determinant

    def record(self, cost: float, values: np.ndarray) -> Visited:
        """A row of the history."""
        return Visited(cost, values.tolist(), 2 * cost / max(self.problem.samples, 1), self.weight)

    def solution(self, values: np.ndarray, evaluation: Evaluation, cost: float, step: Step | Solution) -> Solution:
        """The solution at a point, not converged, with the normal equations of a step from it."""
        return Solution(
            problem=self.problem,
            values=values,
            starts=evaluation.starts,
            evaluation=evaluation,
            weights=self.problem.weights(evaluation),
            cost=cost,
            information=step.information,
            gradient=step.gradient,
            eliminated=step.eliminated,
            gap_weight=self.weight,
        )


def objective_at(problem: Residuals, gap_weight: float | None) -> Objective:
    """Cost and steps of a problem whose windows are separate (None) or joined with this gap weight."""
    if gap_weight is None or not problem.windows.follows.any():
        return Objective(problem)
    return Objective(problem, gap_weight)
