"""Size and kind of the noise of samples, estimated from the residuals of a fit: restricted maximum likelihood.

With r the residuals, X their derivatives by all starts and parameters, V the noise's covariance (Patterson and Thompson
1971):

    -2 log L = log|V| + log|X' V^-1 X| + min (r + X d)' V^-1 (r + X d)

Gaps between joined windows and priors count as measurements in X. For white noise its size in channel j has a fixed
point, the residual sum over the remaining degrees of freedom,

    sigma_j^2 = sum_j r^2/(N_j - tr_j),     tr_j = trace of X (X' V^-1 X)^-1 X' V^-1 over the channel's samples

Memory (AR(1)) or a delay common to a frame's links is used if it raises L enough and its innovations are white. Smooth
misfits, which differ from noise, leave innovations that are equally smooth. There the noise stays white, and standard
errors come from blocks of scores (`uncertainty`). The links of traces are seen by one camera and share a memory unless
they differ clearly; the sensors of a run have one each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fitting.estimate.neighbour_correlation import WHITE_CORRELATION, is_correlated, lag_one, lag_one_by_source
from fitting.estimate.noise import Noise, motion
from fitting.estimate.normal_equations import Evaluation
from fitting.estimate.objective import objective_at
from fitting.estimate.residuals import Residuals
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import leverage, start_covariances
from fitting.estimate.whitening import in_noise_units, log_volume, whiten
from fitting.estimate.windows import Windows
from fitting.traces.trace import Trace

#: Maximum correlation of neighbours in the noise that is used, at which 400 samples count as one.
MAX_CORRELATION = 0.995
#: Its minimum in noise with memory, which then differs little from white noise, and the accuracy of its search.
MIN_CORRELATION = 0.02
CORRELATION_TOLERANCE = 4e-3
#: Rise of the log likelihood from which a more complex noise model is used. Twice it, a chi-square of one number, is
#: reached by chance with a probability of 0.0005.
LIKELIHOOD_GAIN = 6.0
#: Degrees of freedom above which a channel's noise is its own, and not that of all channels of its run: the standard
#: error of a size from 10 is 22 %.
MIN_DEGREES_OF_FREEDOM = 10
#: Relative change of the noise's size at its fixed point.
SIZE_TOLERANCE = 0.01
#: Standard errors by which the correlation of a channel must differ from the mean to count as its own.
SEPARATE_MEMORY_ERRORS = 3.0
#: Significance of the links' common motion along their rates, in standard deviations, for a delay model: a normal
#: number reaches it with a probability below 1e-6.
DELAY_SIGNIFICANCE = 5.0
#: Range of a delay's logarithm around its moment estimate in which it is searched for, and the accuracy of the search.
DELAY_LOG_RANGE = 1.5
DELAY_LOG_TOLERANCE = 0.02


class ResidualNoiseModel:
    """The residuals of a solution, in units of the claimed noise, and the noise models that they support.

    Args:
        solution: end of a fit, with any noise in its problem's samples.
        claimed: the same samples with the claimed noise.
        traces: of windows; none for sensors, whose samples have no common delays.
        floor: minimum standard deviation of each run's links, or of each sensor (R, n), relative to the claimed one.
    """

    def __init__(self, solution: Solution, claimed: Windows, traces: Sequence[Trace], floor: np.ndarray) -> None:
        self.solution = solution
        self.claimed = claimed
        self.traces = traces
        self.floor = floor
        self.raw = solution.problem.raw_evaluation(solution, claimed)
        times = claimed.times()
        known = np.any(claimed.weight > 0, axis=2)
        both = known[:, 1:] & known[:, :-1]
        self.interval = np.ones((len(floor), 1))
        for r in range(len(floor)):
            steps = np.diff(times)[both & (claimed.source == r)[:, None]]
            if len(steps):
                self.interval[r] = np.median(steps)

    def at(self, noise: Noise) -> Solution:
        """The solution in units of this noise, with recomputed normal equations."""
        windows = noise.apply_to(self.claimed, self.traces)
        e = in_noise_units(self.raw, self.claimed, windows)
        if noise.delay.any():  # which move the samples
            e = e._replace(residual=e.residual + windows.weight * (self.claimed.theta - windows.theta))
        problem = self.solution.problem.with_noise(noise, windows, self.solution.values)
        return transfer_solution(self.solution, problem, whiten(windows, e))

    def fixed_point(self, noise: Noise, rounds: int = 3) -> Solution:
        """The solution in units of a noise with its sizes at their fixed point, or near it."""
        for _ in range(rounds):
            before = noise.factor
            noise = replace(noise, factor=np.maximum(before * self._size_ratio(self.at(noise)), self.floor))
            if np.max(np.abs(np.log(noise.factor / before))) < SIZE_TOLERANCE:
                break
        return self.at(noise)

    def _size_ratio(self, point: Solution) -> np.ndarray:
        """Standard deviation of the residuals relative to the assumed one (R, n), with degrees of freedom counted."""
        source = point.windows.source
        unused = (point.windows.weight > 0) - leverage(point)
        squares = point.problem.loss.squares(point.evaluation.residual)
        found = np.ones_like(self.floor)
        for r in np.unique(source):
            square = squares[source == r].sum(axis=(0, 1))
            left = unused[source == r].sum(axis=(0, 1))
            every = np.sqrt(square.sum() / max(left.sum(), 1.0))
            found[r] = np.where(left > MIN_DEGREES_OF_FREEDOM, np.sqrt(square / np.maximum(left, 1.0)), every)
        return np.where(found > 0, found, 1.0)

    def estimate(self, noise: Noise) -> Solution:
        """The solution in units of the noise estimated from these residuals, starting from another one."""
        white_noise = replace(noise, decay=np.full_like(noise.decay, np.inf), delay=np.zeros_like(noise.delay))
        white = self.fixed_point(white_noise)
        found = white
        groups = [np.ones_like(self.floor, bool)]
        if not self.traces:
            sensors = np.arange(len(self.floor))[:, None]
            groups = [sensors == sensor for sensor in range(len(self.floor))]
        for channels in groups:
            found = self._likelier(found, self._with_memory(found, channels))
        if self.traces:
            return self._likelier(found, self._with_delay(white))
        return found

    def _likelier(self, found: Solution, tried: Solution | None) -> Solution:
        """A more complex noise model, if there is one whose log likelihood is higher by `LIKELIHOOD_GAIN`."""
        if tried is None or not minus_two_log_likelihood(tried) < minus_two_log_likelihood(found) - 2 * LIKELIHOOD_GAIN:
            return found
        return tried

    def _likeliest(self, noise_at: Callable[[float], Noise], low: float, high: float, tolerance: float) -> float:
        """The number between two ends whose noise has the highest likelihood."""
        from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import, and white noise needs none

        def cost(x: float) -> float:
            return minus_two_log_likelihood(self.fixed_point(noise_at(x), 2))

        return float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": tolerance}).x)

    def _with_memory(self, point: Solution, channels: np.ndarray) -> Solution | None:
        """AR(1) noise of some channels (R, n), at first with a common memory; None if residuals do not support it."""
        noise = point.problem.noise
        correlation, error = lag_one_by_source(point.windows, point.evaluation.residual, len(self.floor))
        if not is_correlated(correlation[channels], error[channels]):
            return None

        def with_memory(rho: np.ndarray | float) -> Noise:
            decay = -np.log(np.clip(rho, 1e-6, MAX_CORRELATION)) / self.interval
            return replace(noise, decay=np.where(channels, decay, noise.decay))

        # fitted starts remove some of the memory and never add to it
        remaining = self._innovation_correlation(with_memory(correlation), channels)
        if not -WHITE_CORRELATION < remaining < 2 * WHITE_CORRELATION:
            return None
        rho = self._likeliest(with_memory, MIN_CORRELATION, MAX_CORRELATION, CORRELATION_TOLERANCE)
        off = correlation - correlation[channels].mean()
        own = np.abs(off) > SEPARATE_MEMORY_ERRORS * error
        each = np.clip(rho + np.where(own, off, 0.0), MIN_CORRELATION, MAX_CORRELATION)
        found = self.fixed_point(with_memory(each))
        if abs(self._innovation_correlation(found.problem.noise, channels)) < WHITE_CORRELATION:
            return found
        return None

    def _innovation_correlation(self, noise: Noise, channels: np.ndarray) -> float:
        """Correlation of neighbours in the residuals of some channels after a fit with correlated noise."""
        windows = noise.apply_to(self.claimed, self.traces)
        no_jacobian = np.zeros((*windows.weight.shape, 0))
        left = whiten(windows, in_noise_units(self.raw._replace(jacobian=no_jacobian), self.claimed, windows)).residual
        return lag_one(left, (windows.weight > 0) & channels[windows.source][:, None])[0]

    def _with_delay(self, point: Solution) -> Solution | None:
        """A delay of every frame; None if the residuals do not support it, or the delays are not random."""
        white = point.problem.noise
        speed = motion(point.windows, self.traces)[0] * point.windows.weight
        square = np.sum(speed**2, axis=2)
        along = np.sum(speed * point.evaluation.residual, axis=2)
        delay = np.zeros_like(white.delay)
        for r in np.unique(point.windows.run):
            in_run = point.windows.run == r
            more = np.sum(along[in_run] ** 2 - square[in_run])
            size = np.sum(square[in_run] ** 2)
            if more > DELAY_SIGNIFICANCE * np.sqrt(2 * size):
                delay[r] = np.sqrt(more / size)
        late = along / np.maximum(np.sqrt(square), 1e-300)
        if not delay.any() or abs(lag_one(late[..., None], (square > 0)[..., None])[0]) > WHITE_CORRELATION:
            return None

        def delayed(x: float) -> Noise:
            return replace(white, delay=delay * np.exp(x))

        log_ratio = self._likeliest(delayed, -DELAY_LOG_RANGE, DELAY_LOG_RANGE, DELAY_LOG_TOLERANCE)
        return self.fixed_point(delayed(log_ratio))


def transfer_solution(solution: Solution, problem: Residuals, evaluation: Evaluation) -> Solution:
    """The same point as a solution of another problem of the same motion, with new cost and normal equations."""
    objective = objective_at(problem, solution.gap_weight)
    known = objective.undamped_step(evaluation, solution.values, 0.0) or solution
    return replace(
        solution,
        problem=problem,
        evaluation=evaluation,
        weights=problem.weights(evaluation),
        cost=objective.cost(evaluation, solution.values),
        information=known.information,
        gradient=known.gradient,
        eliminated=known.eliminated,
    )


def minus_two_log_likelihood(point: Solution) -> float:
    """Minus twice the restricted log likelihood of the noise in a solution's problem, up to constants."""
    reach = np.where(point.problem.held_mask, 0.0, np.inf)
    step = objective_at(point.problem, point.gap_weight).undamped_step(point.evaluation, point.values, reach)
    if step is None:
        return np.inf
    free = np.flatnonzero(reach)
    shared = np.linalg.slogdet(step.information[np.ix_(free, free)])[1]  # 0 of an empty matrix
    return 2 * (point.cost - step.predicted) + start_covariances(point)[1] + shared + log_volume(point.windows)


def memory_of(point: Solution) -> float:
    """Number of samples equivalent to one of white noise, `(1 + rho)/(1 - rho)` by the correlation of neighbours."""
    rho, error = lag_one(point.evaluation.residual, point.windows.weight > 0)
    longest = max(1.0, point.windows.weight.shape[1] / 2)
    if is_correlated(rho, error):
        return min((1 + rho) / max(1 - rho, 1e-9), longest)
    return 1.0
