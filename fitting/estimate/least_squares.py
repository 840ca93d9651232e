"""Joint Gauss-Newton over window starts z_k and shared parameters p, with starts eliminated by a Schur complement.

    minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + prior

by damped steps of the equations in `normal_equations`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import LinAlgError

from dropper_jax.base.errors import Progress, silent
from fitting.estimate.normal_equations import Evaluation, Normal, Step, eliminate, join, normal_blocks
from fitting.estimate.residuals import Problem, Residuals, Solution, Visited
from fitting.estimate.windows import Starts, pick, with_rows

#: A fit has converged if the next step would move the parameters by less than this [standard errors, squared],
#: and would lower chi-square by less than this times the root of the number of samples.
STEP_TOLERANCE = 1e-4
DECREASE_TOLERANCE = 1e-2
#: Maximum damping: larger values make steps too short to be useful.
LARGEST_DAMPING = 1e8


#: Limit of a remaining step that does not lower the cost: switching of dry friction makes the cost non-smooth. Measured
#: double pendulum: jumps of 1e-8 to 1e-4 of the cost, remaining steps of 0.015 to 0.083 standard errors; three links
#: with dry joints: 0.12. The limit is 0.3 standard errors. Window starts that are far off predict more than the
#: standard deviation of chi-square itself, about the root of the samples, even if the parameters are fixed.
SWITCHING_STEP = 0.3


#: Damping of the first step, of separate and of joined windows.
FIRST_DAMPING = 1e-3
JOINED_DAMPING = 1e-4
#: The same tolerances at intermediate gap weights: parameters within 0.2 standard errors, evidence within 0.25.
#: Only the chosen weight is solved to the end.
INTERMEDIATE_STEP = 0.2**2
INTERMEDIATE_DECREASE = 0.5


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
        self.close = INTERMEDIATE_STEP if intermediate else STEP_TOLERANCE
        self.damping = FIRST_DAMPING
        self.goal = "no convergence"
        if weight is not None:
            self.damping = JOINED_DAMPING
            self.goal = f"no convergence at gap weight {weight:g}"

    def little(self) -> float:
        """Permitted remaining decrease of chi-square: well below its own standard deviation."""
        if self.intermediate:
            return INTERMEDIATE_DECREASE
        return DECREASE_TOLERANCE * float(np.sqrt(self.problem.samples))

    def cost(self, evaluation: Evaluation, values: np.ndarray) -> float:
        """The objective; infinite if the motion is not finite."""
        total = self.problem.data_cost(evaluation) + self.problem.prior(values).cost
        if not np.isfinite(total):
            return np.inf
        if self.weight is None:
            return total
        value = self.problem.gaps(evaluation, values).value
        return total + 0.5 * float(np.sum((value / self.weight) ** 2))

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
        count = int(self.problem.windows.follows.sum()) * self.problem.freedoms
        return count * float(np.log(self.weight)) + 0.5 * step.log_determinant

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


def fit_starts(problem: Problem, values: np.ndarray, starts: Starts, iterations: int) -> tuple[Starts, Evaluation]:
    """Fit the start of every window alone, with fixed parameters (k,).

    The Levenberg-Marquardt method with a separate damping for each window, so that one on a wrong branch does not slow
    the others.

    Returns:
        The starts and their evaluation.
    """
    evaluation = problem.evaluate(values, starts)
    starts = evaluation.starts
    damping = np.full(len(starts.theta), FIRST_DAMPING)
    cost = window_costs(problem, evaluation.residual)
    for _ in range(iterations - 1):
        normal = normal_blocks(evaluation, problem.weights(evaluation), problem.freedoms)
        A = normal.damped(damping[:, None])
        usable = np.all(np.isfinite(A), axis=(1, 2)) & np.isfinite(cost)
        A = np.where(usable[:, None, None], A, np.eye(A.shape[1]))
        slope = np.where(usable[:, None], normal.gz, 0.0)
        dz = -np.linalg.solve(A, slope[..., None])[..., 0]
        if not (-np.einsum("ki,ki->k", dz, slope) > DECREASE_TOLERANCE).any():
            break
        trial = problem.evaluate(values, problem.move_starts(starts, values, dz))
        lower = window_costs(problem, trial.residual) < cost
        evaluation = with_rows(evaluation, lower, pick(trial, lower))
        starts = evaluation.starts
        cost = window_costs(problem, evaluation.residual)
        damping = np.clip(np.where(lower, 0.1 * damping, np.maximum(10 * damping, 1e-3)), 1e-9, LARGEST_DAMPING)
    return starts, evaluation


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
        problem = self.objective.problem
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
                if gain <= 0.1:
                    self.damping *= 3.0
                elif gain > 0.5:
                    self.damping = max(0.1 * self.damping, 1e-9)
                return Point(values, evaluation, cost, objective.system(evaluation, values))
            if near:  # a smooth cost would have decreased
                break
            self.damping = max(10 * self.damping, 1e-3)
        if near or self.damping >= LARGEST_DAMPING:
            self.why = ""
        if not near:
            self.why = failure or self.why
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
        moved = np.inf
        decrease = np.inf
        if newton is not None:
            unit = max(objective.unit(point.evaluation, point.cost), 1e-12)
            moved = float(newton.dp @ newton.information @ newton.dp) / unit
            decrease = 2 * newton.predicted / unit
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
