"""Size and kind of the noise of a trace, estimated from the residuals of a fit: restricted maximum likelihood.

With r the residuals, X their derivatives by all starts and parameters, V the noise's covariance (Patterson and Thompson
1971):

    -2 log L = log|V| + log|X' V^-1 X| + min (r + X d)' V^-1 (r + X d)

Gaps between joined windows and priors count as measurements in X. For white noise its size in channel j has a fixed
point, the residual sum over the remaining degrees of freedom,

    sigma_j^2 = sum_j r^2/(N_j - tr_j),     tr_j = trace of X (X' V^-1 X)^-1 X' V^-1 over the channel's samples

Memory (AR(1)) or a delay common to a frame's links is used if it raises L enough and its innovations are white. Smooth
misfits, which differ from noise, leave innovations that are equally smooth. There the noise stays white, and standard
errors come from blocks of scores (`uncertainty`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from fitting.estimate.noise import WHITE, Noise, correlates, lag_one, log_volume, motion, whiten
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.problem import Problem, Solution
from fitting.estimate.sandwich import leverage, start_covariances
from fitting.estimate.shooting import level_of
from fitting.estimate.windows import Windows
from fitting.traces.trace import Trace

#: Maximum memory of the noise that is used.
MAX_CORRELATION = 0.995


class ResidualNoiseModel:
    """The residuals of a solution, in units of the claimed noise, and the noise models that they support.

    Args:
        solution: end of a fit, with any noise in its problem's windows.
        claimed: the same windows with the noise that the traces claim.
        floor: minimum standard deviation of each run's links (R, n) relative to the claimed one.
    """

    def __init__(self, solution: Solution, claimed: Windows, traces: Sequence[Trace], floor: np.ndarray) -> None:
        self.solution, self.traces, self.floor = solution, traces, floor
        problem, old = solution.problem, solution.windows
        self.claimed = replace(claimed, substeps=old.substeps)
        self.raw = _in_units(solution.evaluation, old, claimed)
        if old.decay is not None or old.jitter is not None:
            self.raw = problem.simulator(solution.values, solution.starts, self.claimed)

    def at(self, noise: Noise) -> Solution:
        """The solution in units of this noise, with recomputed normal equations."""
        windows = noise.apply_to(self.claimed, self.traces)
        e = _in_units(self.raw, self.claimed, windows)
        shift = windows.weight * (self.claimed.theta - windows.theta)  # of the samples, by delays
        problem = replace(self.solution.problem, windows=windows, noise=noise)
        if problem.rest is not None:
            problem = replace(problem, rest=problem.rest.with_noise(noise, problem.simulator, self.solution.values))
        return pose_again(self.solution, problem, whiten(windows, e._replace(residual=e.residual + shift)))

    def fixed_point(self, noise: Noise, rounds: int = 3) -> tuple[Noise, Solution]:
        """The noise with its sizes at their fixed point, or near it."""
        for _ in range(rounds):
            before = noise.factor
            noise = replace(noise, factor=np.maximum(before * self._grow(self.at(noise)), self.floor))
            if np.max(np.abs(np.log(noise.factor / before))) < 0.01:
                break
        return noise, self.at(noise)

    def _grow(self, point: Solution) -> np.ndarray:
        """Standard deviation of the residuals relative to the assumed one (R, n), with degrees of freedom counted."""
        residual, run = point.evaluation.residual, point.windows.run
        slope = point.problem.loss.weights(residual) * residual
        unused = (point.windows.weight > 0) - leverage(point)
        found = np.ones_like(self.floor)
        for r in np.unique(run):
            square = np.sum(slope[run == r] ** 2, axis=(0, 1)) / point.problem.loss.spread
            left = unused[run == r].sum(axis=(0, 1))
            every = np.sqrt(square.sum() / max(left.sum(), 1.0))
            # minimum number of remaining samples for the noise of a channel
            found[r] = np.where(left > 10, np.sqrt(square / np.maximum(left, 1.0)), every)
        return np.where(found > 0, found, 1.0)

    def estimate(self, noise: Noise) -> tuple[Noise, Solution]:
        """The noise estimated from these residuals, starting from another one."""
        white = replace(noise, decay=np.full_like(noise.decay, np.inf), delay=np.zeros_like(noise.delay))
        white, point = self.fixed_point(white)
        best, found = minus_two_log(point), (white, point)
        for tried in (self._with_memory(white, point), self._with_delay(white, point)):
            # minimum gain in log likelihood for a more complex noise model
            if tried is not None and minus_two_log(tried[1]) < best - 2 * 6.0:
                best, found = minus_two_log(tried[1]), tried
        return found

    def _with_memory(self, white: Noise, point: Solution) -> tuple[Noise, Solution] | None:
        """AR(1) noise, at first with a common memory; None if the residuals do not support it."""
        kept, sure = self._neighbours(point)
        if not correlates(kept, sure):
            return None
        interval = np.array([trace.interval for trace in self.traces])[:, None]
        decay = lambda rho: -np.log(np.clip(rho, 1e-6, MAX_CORRELATION)) / interval  # noqa: E731
        # fitted starts remove some of the memory and never add to it
        if not -WHITE < self._innovations(replace(white, decay=decay(kept))) < 2 * WHITE:
            return None
        shape = np.ones_like(white.factor)
        from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import, and white noise needs none

        cost = lambda rho: minus_two_log(self.fixed_point(replace(white, decay=decay(rho * shape)), 2)[1])  # noqa: E731
        rho = float(minimize_scalar(cost, bounds=(0.02, MAX_CORRELATION), method="bounded", options={"xatol": 4e-3}).x)
        each = np.clip(
            rho + np.where(np.abs(kept - kept.mean()) > 3 * sure, kept - kept.mean(), 0.0), 0.02, MAX_CORRELATION
        )
        noise, point = self.fixed_point(replace(white, decay=decay(each)))
        return (noise, point) if abs(self._innovations(noise)) < WHITE else None

    def _innovations(self, noise: Noise) -> float:
        """Correlation of neighbours in the residuals after a fit with correlated noise."""
        windows = noise.apply_to(self.claimed, self.traces)
        nothing = np.zeros((*windows.weight.shape, 0))
        left = whiten(windows, _in_units(self.raw._replace(jacobian=nothing), self.claimed, windows)).residual
        return lag_one(left, windows.weight > 0)[0]

    def _neighbours(self, point: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Correlation of neighbouring residuals of every run and link (R, n), and its error for white noise."""
        known, run = point.windows.weight > 0, point.windows.run
        found = np.zeros((2, *self.floor.shape))
        for r, j in product(np.unique(run), range(found.shape[2])):
            pick = run == r, slice(None), slice(j, j + 1)
            found[:, r, j] = lag_one(point.evaluation.residual[pick], known[pick])
        return found[0], found[1]

    def _with_delay(self, white: Noise, point: Solution) -> tuple[Noise, Solution] | None:
        """A delay of every frame; None if the residuals do not support it, or the delays are not random."""
        speed = motion(point.windows, self.traces)[0] * point.windows.weight
        square = np.sum(speed**2, axis=2)
        along = np.sum(speed * point.evaluation.residual, axis=2)
        delay = np.zeros_like(white.delay)
        for r in np.unique(point.windows.run):
            mine = point.windows.run == r
            more, size = np.sum(along[mine] ** 2 - square[mine]), np.sum(square[mine] ** 2)
            # significance of the links' common motion along their rates, in standard deviations, for a delay model
            if more > 5.0 * np.sqrt(2 * size):
                delay[r] = np.sqrt(more / size)
        late = along / np.maximum(np.sqrt(square), 1e-300)
        if not delay.any() or abs(lag_one(late[..., None], (square > 0)[..., None])[0]) > WHITE:
            return None
        from scipy.optimize import minimize_scalar  # noqa: PLC0415 - as above

        cost = lambda x: minus_two_log(self.fixed_point(replace(white, delay=delay * np.exp(x)), 2)[1])  # noqa: E731
        size = minimize_scalar(cost, bounds=(-1.5, 1.5), method="bounded", options={"xatol": 0.02}).x
        return self.fixed_point(replace(white, delay=delay * np.exp(size)))


def pose_again(solution: Solution, problem: Problem, evaluation: Evaluation) -> Solution:
    """The same point as a solution of another problem of the same motion, with new cost and normal equations."""
    level = level_of(problem, solution.gap_weight)
    known = level.undamped_step(evaluation, solution.values, 0.0) or solution
    return replace(
        solution,
        problem=problem,
        evaluation=evaluation,
        weights=problem.weights(evaluation),
        cost=level.cost(evaluation, solution.values),
        information=known.information,
        gradient=known.gradient,
        eliminated=known.eliminated,
    )


def minus_two_log(point: Solution) -> float:
    """Minus twice the restricted log likelihood of the noise in a solution's problem, up to constants."""
    reach = np.where(point.problem.held_mask, 0.0, np.inf)
    step = level_of(point.problem, point.gap_weight).undamped_step(point.evaluation, point.values, reach)
    if step is None:
        return np.inf
    free = np.flatnonzero(reach)
    shared = float(np.linalg.slogdet(step.information[np.ix_(free, free)])[1])  # 0 of an empty matrix
    return 2 * (point.cost - step.predicted) + start_covariances(point)[1] + shared + log_volume(point.windows)


def _in_units(evaluation: Evaluation, old: Windows, new: Windows) -> Evaluation:
    """An evaluation in units of the old windows' noise, in those of the new ones."""
    ratio = np.where(new.weight > 0, new.weight / np.where(old.weight > 0, old.weight, 1.0), 0.0)
    residual, jacobian = evaluation.residual * ratio, evaluation.jacobian * ratio[..., None]
    return evaluation._replace(residual=residual, jacobian=jacobian)


def memory_of(point: Solution) -> float:
    """Number of samples equivalent to one of white noise, `(1 + rho)/(1 - rho)` by the correlation of neighbours."""
    rho, sure = lag_one(point.evaluation.residual, point.windows.weight > 0)
    longest = max(1.0, point.windows.theta.shape[1] / 2)
    return min((1 + rho) / max(1 - rho, 1e-9), longest) if correlates(rho, sure) else 1.0


#: Rounds of fit and noise, and the change of the noise below which another fit would change nothing: an error of 5 % of
#: the weights costs less than 0.01 standard errors.
ROUNDS, SAME = 3, 0.05


def with_residual_noise(
    solution: Solution,
    claimed: Windows,
    traces: Sequence[Trace],
    floor: np.ndarray,
    again: Callable[[Solution], Solution],
) -> Solution:
    """The fit with the noise estimated from its own residuals, and this noise, at their common fixed point.

    Args:
        solution: a converged fit.
        claimed: its windows with the noise that the traces claim.
        floor: as for `ResidualNoiseModel`.
        again: continues from a solution whose noise has changed.
    """

    def estimate_noise(point: Solution) -> tuple[Solution, float]:
        before = point.problem.noise or Noise.as_claimed(*floor.shape)
        noise, point = ResidualNoiseModel(point, claimed, traces, floor).estimate(before)
        point.problem = replace(point.problem, memory=memory_of(point))
        return point, noise.max_relative_difference(before)

    return fit_with_noise(solution, estimate_noise, again)


def fit_with_noise(
    solution: Solution,
    estimate_noise: Callable[[Solution], tuple[Solution, float]],
    again: Callable[[Solution], Solution],
    same: float = SAME,
) -> Solution:
    """Alternate fit and noise estimate from a converged fit, up to their common fixed point.

    Args:
        estimate_noise: the solution in units of the noise from its residuals, and the relative change of this noise.
        again: continues from a solution whose noise has changed.
        same: change of the noise below which another fit would change nothing.
    """
    for _ in range(ROUNDS):
        solution, change = estimate_noise(solution)
        if change < same:
            break
        further = again(solution)
        if further.status != "ok":
            break
        further.iterations += solution.iterations
        solution = further
    return solution
