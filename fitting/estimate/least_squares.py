"""Joint Gauss-Newton over window starts z_k and shared parameters p, with starts eliminated by a Schur complement.

    minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + prior

by damped steps of the equations in `normal_equations`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from dropper_jax.base.progress import Progress, silent
from fitting.estimate.normal_equations import Evaluation, Normal, Step, normal_blocks
from fitting.estimate.objective import DECREASE_TOLERANCE, FIRST_DAMPING, Objective, objective_at
from fitting.estimate.residuals import Residuals
from fitting.estimate.solution import Solution
from fitting.estimate.window_problem import Problem
from fitting.estimate.windows import Starts, pick, with_rows

#: Range of the damping: larger values make steps too short to be useful.
LEAST_DAMPING = 1e-9
LARGEST_DAMPING = 1e8
#: Ratios of the cost's decrease to the predicted one: up to the first the damping grows, above the second it falls.
POOR_GAIN = 0.1
GOOD_GAIN = 0.5
#: Limit of a remaining step that does not lower the cost: switching of dry friction makes the cost non-smooth. Measured
#: double pendulum: jumps of 1e-8 to 1e-4 of the cost, remaining steps of 0.015 to 0.083 standard errors; three links
#: with dry joints: 0.12. The limit is 0.3 standard errors. Window starts that are far off predict more than the
#: standard deviation of chi-square itself, about the root of the samples, even if the parameters are fixed.
SWITCHING_STEP = 0.3


def first_solution(problem: Residuals, values: np.ndarray, evaluation: Evaluation) -> Solution:
    """The point where a fit starts, not solved: its normal equations are zero."""
    objective = Objective(problem)
    k = len(values)
    m2 = problem.freedoms
    cost = objective.cost(evaluation, values)
    nothing = Step(
        dp=np.zeros(k),
        dz=np.zeros((0, m2)),
        predicted=0.0,
        information=np.zeros((k, k)),
        gradient=np.zeros(k),
        eliminated=np.zeros((0, m2, k)),
    )
    found = objective.solution(values, evaluation, cost, nothing)
    return replace(found, history=[objective.record(cost, values)])


def fit_windows(
    problem: Residuals, values: np.ndarray, starts: Starts, *, iterations: int = 40, progress: Progress = silent
) -> Solution:
    """Fit all window starts and the parameters together.

    Args:
        values: start of the parameters (k,).
        starts: start of the windows.
        iterations: maximum evaluations.

    Returns:
        The best point found; `status` shows whether it converged.
    """
    values = np.asarray(values, float)
    begin = first_solution(problem, values, problem.evaluate(values, starts))
    return descend(Objective(problem), begin, iterations, count=1, progress=progress)


def window_costs(problem: Residuals, residual: np.ndarray) -> np.ndarray:
    """Loss of each window (K,); infinite where its motion is not finite."""
    costs = np.full(len(residual), np.inf)
    for k, one in enumerate(residual):
        if np.isfinite(one).all():
            costs[k] = problem.loss.cost(one)
    return costs


#: Maximum evaluations for the starts alone.
START_ITERATIONS = 12


def fit_starts(problem: Problem, values: np.ndarray, starts: Starts) -> Evaluation:
    """Fit the start of every window alone, with fixed parameters (k,).

    The Levenberg-Marquardt method with a separate damping for each window, so that one on a wrong branch does not slow
    the others.

    Returns:
        The evaluation at the starts that were found, which it has.
    """
    evaluation = problem.evaluate(values, starts)
    damping = np.full(len(evaluation.start), FIRST_DAMPING)
    cost = window_costs(problem, evaluation.residual)
    for _ in range(START_ITERATIONS - 1):
        normal = normal_blocks(evaluation, problem.weights(evaluation), problem.freedoms)
        A = normal.damped(damping[:, None])
        usable = np.all(np.isfinite(A), axis=(1, 2)) & np.isfinite(cost)
        A = np.where(usable[:, None, None], A, np.eye(A.shape[1]))
        slope = np.where(usable[:, None], normal.gz, 0.0)
        dz = -np.linalg.solve(A, slope[..., None])[..., 0]
        if not (-np.einsum("ki,ki->k", dz, slope) > DECREASE_TOLERANCE).any():
            break
        trial = problem.evaluate(values, problem.move_starts(evaluation.starts, values, dz))
        lower = window_costs(problem, trial.residual) < cost
        evaluation = with_rows(evaluation, lower, pick(trial, lower))
        cost = window_costs(problem, evaluation.residual)
        damping = np.where(lower, 0.1 * damping, np.maximum(10 * damping, FIRST_DAMPING))
        damping = np.clip(damping, LEAST_DAMPING, LARGEST_DAMPING)
    return evaluation


#: Maximum evaluations when a solution continues with other noise or finer steps.
CONTINUED_ITERATIONS = 12


def continue_fit(point: Solution, iterations: int = CONTINUED_ITERATIONS, progress: Progress = silent) -> Solution:
    """Continue from a solution, whose windows are separate or joined, with its own problem, whose noise or steps may
    have changed."""
    found = descend(objective_at(point.problem, point.gap_weight), point, iterations, progress=progress)
    return replace(found, evidence=point.evidence)


class Point(NamedTuple):
    """Parameters (k,), the evaluation there, the cost, and its normal equations if it is finite."""

    values: np.ndarray
    evaluation: Evaluation
    cost: float
    system: Normal | None


class Mover(Protocol):
    """How a descent moves from a point to the next one.

    Attributes:
        count: number of evaluations.
        why: reason for the end; empty if no step lowers the cost.
    """

    count: int
    why: str

    def report(self, point: Point, progress: Progress) -> None:
        """Report the progress of the descent."""

    def is_minimum(self, moved: float, decrease: float) -> bool:
        """Whether a point is the minimum, by the rest of a full step: its move of the parameters in standard errors,
        squared, and its decrease of chi-square."""

    def move(self, point: Point, system: Normal, newton: Step | None, near: bool) -> Point | None:
        """The next point, by its normal equations and the full step from this one, or None."""


class DampedSteps:
    """Levenberg-Marquardt steps: every one lowers the cost."""

    def __init__(self, objective: Objective, iterations: int, count: int) -> None:
        self.objective = objective
        self.iterations = iterations
        self.count = count
        self.damping = objective.damping
        self.why = f"{objective.goal} in {iterations} iterations"

    def report(self, point: Point, progress: Progress) -> None:
        unit = self.objective.unit(point.evaluation, point.cost)
        progress(min(self.count / self.iterations, 0.99), f"iteration {self.count}, chi2 per sample {unit:.4g}")

    def is_minimum(self, moved: float, decrease: float) -> bool:
        return moved < self.objective.close and decrease < self.objective.little()

    def move(self, point: Point, system: Normal, newton: Step | None, near: bool) -> Point | None:
        objective = self.objective
        problem = objective.problem
        failure = ""
        limits = problem.step_bounds(point.values)
        while self.count < self.iterations and self.damping < LARGEST_DAMPING:
            step = objective.solve(system, point.values, self.damping, *limits)
            if step is None:
                self.damping *= 10
                continue
            values = problem.after_step(point.values, step.dp)
            starts = problem.move_starts(point.evaluation.starts, point.values, step.dz)
            evaluation = problem.evaluate(values, starts)
            cost = objective.cost(evaluation, values)
            self.count += 1
            failure = problem.failure(evaluation) or failure
            if cost < point.cost:
                gain = (point.cost - cost) / max(step.predicted, 1e-300)
                if gain <= POOR_GAIN:
                    self.damping *= 3.0
                elif gain > GOOD_GAIN:
                    self.damping = max(0.1 * self.damping, LEAST_DAMPING)
                return Point(values, evaluation, cost, objective.system(evaluation, values))
            if near:  # a smooth cost would have decreased
                break
            self.damping = max(10 * self.damping, FIRST_DAMPING)
        if near:
            self.why = ""
        elif failure:
            self.why = failure
        elif self.damping >= LARGEST_DAMPING:
            self.why = ""
        return None


def descend(
    objective: Objective, begin: Solution, iterations: int, *, count: int = 0, progress: Progress = silent
) -> Solution:
    """The lowest point from one that is already evaluated, by the Levenberg-Marquardt method or the problem's own
    descent.

    Args:
        begin: the point; its information is returned if the end has none.
        count: number of earlier evaluations, part of `iterations`.
    """
    problem = objective.problem
    mover: Mover = DampedSteps(objective, iterations, count)
    if problem.descent is not None and not problem.held_mask.all():
        mover = problem.descent.mover(objective, count)
    history = list(begin.history)
    known: Step | Solution = begin
    best = Point(begin.values, begin.evaluation, objective.cost(begin.evaluation, begin.values), None)
    status = "not_converged"
    message = "the simulation of the start values is not finite"
    point = best
    if np.isfinite(best.cost):
        point = best._replace(system=objective.system(best.evaluation, best.values))
    while point.system is not None:
        mover.report(point, progress)
        newton = objective.solve(point.system, point.values, 0.0, *problem.step_bounds(point.values))
        moved, decrease = _remaining(objective, point, newton)
        if newton is not None and mover.is_minimum(moved, decrease):
            best = point
            known = newton
            status = "ok"
            message = ""
            break
        # a step that does not lower the cost is then not too long, but the cost is non-smooth
        near = moved < SWITCHING_STEP**2 and decrease < np.sqrt(problem.samples)
        if point.cost <= best.cost:
            best = point
            known = newton or known
        following = mover.move(point, point.system, newton, near)
        if following is None:
            if near and not mover.why:
                status = "ok"
            far = f"no step lowers the cost; the minimum of its model is {np.sqrt(moved):.2g} standard errors away"
            message = mover.why or far
            break
        point = following
        history.append(objective.record(point.cost, point.values))
    found = objective.solution(best.values, best.evaluation, best.cost, known)
    return replace(found, status=status, message=message, iterations=mover.count, history=history)


def _remaining(objective: Objective, point: Point, newton: Step | None) -> tuple[float, float]:
    """The rest of a full step from a point: its move of the parameters in standard errors, squared, and its decrease of
    chi-square; infinite without a step."""
    if newton is None:
        return np.inf, np.inf
    unit = max(objective.unit(point.evaluation, point.cost), 1e-12)
    return newton.dp @ newton.information @ newton.dp / unit, 2 * newton.predicted / unit
