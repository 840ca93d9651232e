"""Joint Gauss-Newton over window starts z_k and shared parameters p, with starts eliminated by a Schur complement.

    minimise  1/2 sum_k |W_k r_k(z_k, p)|^2 + prior

by damped steps of the equations in `normal_equations`.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.linalg import LinAlgError

from dropper_jax.base.errors import Progress, silent
from fitting.estimate.normal_equations import Evaluation, Joined, Normal, Step, eliminate, normal_blocks
from fitting.estimate.residuals import Problem, Residuals, Solution, Visited
from fitting.estimate.windows import Starts, pick, with_rows

#: Converged if the next step would move the parameters by less than this fraction of their standard errors (squared)
STEP_TOLERANCE = 1e-4
#: and would lower chi-square by less than this.
DECREASE_TOLERANCE = 1e-2
#: Maximum damping: larger values make steps too short to be useful.
LARGEST_DAMPING = 1e8


#: Limit of a remaining step that does not lower the cost: switching of dry friction makes the cost non-smooth. Measured
#: double pendulum: jumps of 1e-8 to 1e-4 of the cost, remaining steps of 0.015 to 0.083 standard errors; three links
#: with dry joints: 0.12. The limit is 0.3 standard errors.
SWITCHING_STEP = 0.3


def nearly_there(moved: float, decrease: float, samples: int) -> bool:
    """Whether a step that does not lower the cost indicates a non-smooth cost, not a step that is too long.

    Args:
        moved: length of the step, in standard errors, squared.
        decrease: predicted decrease of chi-square. Window starts that are far off predict more than the standard
            deviation of chi-square itself, about the root of the samples, even if the parameters are fixed.
    """
    return moved < (SWITCHING_STEP**2) and decrease < np.sqrt(samples)


class Separate:
    """Cost and steps of independent windows."""

    #: Damping of the first step, and the message if the descent does not converge.
    damping = 1e-3
    goal = "no convergence"
    #: Weight of the gaps between windows; None: they are not joined.
    weight: float | None = None
    #: Convergence limits at the minimum: the parameters' next step in standard errors, squared, and its decrease of
    #: chi-square.
    close = STEP_TOLERANCE

    def little(self) -> float:
        """Permitted remaining decrease of chi-square: well below its own standard deviation."""
        return DECREASE_TOLERANCE * float(np.sqrt(self.problem.samples))

    def __init__(self, problem: Residuals) -> None:
        self.problem = problem

    def cost(self, evaluation: Evaluation, values: np.ndarray) -> float:
        """The objective; infinite if the motion is not finite."""
        return self.problem.data_cost(evaluation) + self.problem.prior(values).cost

    def unit(self, evaluation: Evaluation, cost: float) -> float:
        """Variance of the noise in units of the assumed one, multiplied by the memory of the samples."""
        return 2 * cost / max(self.problem.samples, 1) * self.problem.memory

    def system(self, evaluation: Evaluation, values: np.ndarray) -> Normal | Joined:
        """Normal equations."""
        return self.problem.normal(evaluation)

    def solve(
        self, system: Normal | Joined, values: np.ndarray, damping: float, low: np.ndarray, high: np.ndarray
    ) -> Step | None:
        """The damped step with parameter changes between low and high (k,); None if the equations are singular."""
        try:
            return self.eliminate(system, damping, self.problem.prior(values), low, high)
        except LinAlgError:
            return None

    eliminate = staticmethod(eliminate)

    def undamped_step(
        self, evaluation: Evaluation, values: np.ndarray, reach: np.ndarray | float | None = None
    ) -> Step | None:
        """The step without damping; parameters move by at most `reach` (k,), by default inside their bounds."""
        if reach is None:
            limits = self.problem.step_bounds(values)
        else:
            limits = np.outer([-1, 1], reach + 0 * values)
        return self.solve(self.system(evaluation, values), values, 0.0, *limits)

    def log_volume(self, step: Step) -> float:
        """The terms of a gap weight's evidence that are not the cost; without joins all weights are one."""
        return 0.0

    def record(self, cost: float, values: np.ndarray) -> Visited:
        """A row of the history."""
        return Visited(cost, values.tolist(), 2 * cost / max(self.problem.samples, 1), self.weight)

    def remaining_gain(self, newton: Step, evaluation: Evaluation, cost: float) -> tuple[float, float]:
        """Effect of a full step: the move in standard errors, squared, and the decrease of chi-square."""
        unit = max(self.unit(evaluation, cost), 1e-12)
        return float(newton.dp @ newton.information @ newton.dp) / unit, 2 * newton.predicted / unit

    def solution(
        self, values: np.ndarray, evaluation: Evaluation, cost: float, step: Step | Solution, **outcome: Any
    ) -> Solution:
        """The solution at a point, with the normal equations of a step from it."""
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
            **outcome,
        )


def first_solution(problem: Residuals, values: np.ndarray, evaluation: Evaluation) -> Solution:
    """The point where a fit starts, not solved: its normal equations are zero."""
    objective = Separate(problem)
    k = len(values)
    m2 = problem.freedoms
    cost = objective.cost(evaluation, values)
    nothing = Step(np.zeros(k), np.zeros((0, m2)), 0.0, np.zeros((k, k)), np.zeros(k), np.zeros((0, m2, k)))
    return objective.solution(values, evaluation, cost, nothing, history=[objective.record(cost, values)])


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
    return descend(Separate(problem), begin, iterations, count=1, progress=progress)


def window_costs(problem: Residuals, residual: np.ndarray) -> np.ndarray:
    """Loss of each window (K,)."""
    return np.array([problem.loss.cost(one) if np.isfinite(one).all() else np.inf for one in residual])


def fit_starts(problem: Problem, values: np.ndarray, starts: Starts, iterations: int) -> tuple[Starts, Evaluation]:
    """Fit the start of every window alone, with fixed parameters (k,).

    The Levenberg-Marquardt method with a separate damping for each window, so that one on a wrong branch does not slow
    the others.

    Returns:
        The starts and their evaluation.
    """
    evaluation = problem.evaluate(values, starts)
    starts = evaluation.starts
    damping = np.full(len(starts.theta), Separate.damping)
    cost = window_costs(problem, evaluation.residual)
    for _ in range(iterations - 1):
        normal = normal_blocks(evaluation, problem.weights(evaluation), problem.freedoms)
        diagonal = np.einsum("kii->ki", normal.A)
        floor = 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300
        A = normal.A + (damping[:, None] * diagonal + floor)[:, :, None] * np.eye(diagonal.shape[1])
        usable = np.isfinite(A).all(axis=(1, 2)) & np.isfinite(cost)
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


#: Maximum evaluations when a solution continues with other noise.
CONTINUED = 12


def continue_windows(point: Solution, iterations: int = CONTINUED, progress: Progress = silent) -> Solution:
    """Continue from a solution of separate windows with its own problem, whose noise may have changed."""
    return descend(Separate(point.problem), point, iterations, progress=progress)


def descend(
    objective: Separate, begin: Solution, iterations: int, *, count: int = 0, progress: Progress = silent
) -> Solution:
    """The Levenberg-Marquardt method, or the problem's own descent, from a point that is already evaluated.

    Args:
        begin: the point; its information is returned if the end has none.
        count: number of earlier evaluations, part of `iterations`.
    """
    problem = objective.problem
    gradient = problem.descent is not None and not problem.held_mask.all()
    if gradient:
        mover = problem.descent.mover(objective, count)
    else:
        mover = DampedSteps(objective, iterations, count)
    return minimise(objective, begin, mover, progress)


class Point(NamedTuple):
    """Parameters (k,), the evaluation there, the cost, and its normal equations if it is finite."""

    values: np.ndarray
    evaluation: Evaluation
    cost: float
    system: Normal | Joined | None


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
        """Whether the remaining gain (`Separate.remaining_gain`) is small enough for the point to be the minimum."""

    def move(self, point: Point, newton: Step | None, near: bool) -> Point | None:
        """The next point, by the full step from this one, or None."""


class DampedSteps:
    """Levenberg-Marquardt steps: every one lowers the cost."""

    def __init__(self, objective: Separate, iterations: int, count: int) -> None:
        self.objective, self.iterations, self.count = objective, iterations, count
        self.damping, self.why = objective.damping, f"{objective.goal} in {iterations} iterations"

    def report(self, point: Point, progress: Progress) -> None:
        unit = self.objective.unit(point.evaluation, point.cost)
        progress(min(self.count / self.iterations, 0.99), f"iteration {self.count}, chi2 per sample {unit:.4g}")

    def is_minimum(self, moved: float, decrease: float) -> bool:
        return moved < self.objective.close and decrease < self.objective.little()

    def move(self, point: Point, newton: Step | None, near: bool) -> Point | None:
        objective = self.objective
        problem = self.objective.problem
        failure = ""
        limits = problem.step_bounds(point.values)
        while self.count < self.iterations and self.damping < LARGEST_DAMPING:
            step = objective.solve(point.system, point.values, self.damping, *limits)
            if step is None:
                self.damping *= 10
                continue
            values = problem.after_step(point.values, step.dp)
            starts = problem.move_starts(point.evaluation.starts, point.values, step.dz)
            evaluation = problem.evaluate(values, starts)
            cost = objective.cost(evaluation, values)
            self.count, failure = self.count + 1, problem.failure(evaluation) or failure
            if cost < point.cost:
                gain = (point.cost - cost) / max(step.predicted, 1e-300)
                self.damping = max(self.damping * (0.1 if gain > 0.5 else 1.0 if gain > 0.1 else 3.0), 1e-9)
                return Point(values, evaluation, cost, objective.system(evaluation, values))
            if near:  # a smooth cost would have decreased
                break
            self.damping = max(10 * self.damping, 1e-3)
        if near or self.damping >= LARGEST_DAMPING:
            self.why = ""
        self.why = self.why if near else failure or self.why
        return None


def minimise(objective: Separate, begin: Solution, mover: Mover, progress: Progress = silent) -> Solution:
    """The lowest point that a mover finds from one that is already evaluated; converged if the mover has arrived."""
    problem = objective.problem
    history = list(begin.history)
    known = begin
    best = Point(begin.values, begin.evaluation, objective.cost(begin.evaluation, begin.values), None)
    status = "not_converged"
    message = "the simulation of the start values is not finite"
    point = best
    if np.isfinite(best.cost):
        point = best._replace(system=objective.system(best.evaluation, best.values))
    while point.system is not None:
        mover.report(point, progress)
        newton = objective.solve(point.system, point.values, 0.0, *problem.step_bounds(point.values))
        if newton:
            moved, decrease = objective.remaining_gain(newton, point.evaluation, point.cost)
        else:
            moved = np.inf
            decrease = np.inf
        if newton is not None and mover.is_minimum(moved, decrease):
            best = point
            known = newton
            status = "ok"
            message = ""
            break
        near = nearly_there(moved, decrease, problem.samples)
        if point.cost <= best.cost:
            best = point
            known = newton or known
        following = mover.move(point, newton, near)
        if following is None:
            if near and not mover.why:
                status = "ok"
            far = f"no step lowers the cost; the minimum of its model is {np.sqrt(moved):.2g} standard errors away"
            message = mover.why or far
            break
        point = following
        history.append(objective.record(point.cost, point.values))
    outcome = {"status": status, "message": message, "iterations": mover.count, "history": history}
    return objective.solution(best.values, best.evaluation, best.cost, known, **outcome)
