"""Result of a fit to channels: numbers with errors, undetermined parameters, the fitted scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from dropper_jax.base.json_values import jsonable
from dropper_jax.load.scene import Scene
from fitting.channels.problem import ChannelSolution, Evaluation, Problem
from fitting.channels.setup import setup_with_directions
from fitting.estimate.noise import Noise
from fitting.estimate.scene_fit import SceneFit
from fitting.estimate.uncertainty import Uncertainty, quantile, uncertainty
from fitting.parameters.fitted_scene import fitted_scene

#: Error of a parameter, over that of its prior, from which the data add next to nothing to the prior.
PRIOR_ERROR_SHARE = 0.95
#: Sensitivity up to which a parameter is not determined: 1 % of the channel changes it by 20 %.
LEAST_SENSITIVITY = 0.05


@dataclass(frozen=True)
class Between:
    """A parameter over several runs.

    Attributes:
        name: its path.
        mean, std_error, low, high: of the mean, with a 90 % interval.
        spread: tau, the standard deviation between runs.
        values, std_errors: of the runs (n,).
    """

    name: str
    mean: float
    std_error: float
    low: float
    high: float
    spread: float
    values: np.ndarray
    std_errors: np.ndarray


def combine_runs(name: str, values: np.ndarray, covariance: np.ndarray, level: float = 0.90) -> Between:
    """Mean and spread of a parameter from the runs' estimates (n,) and their covariance (n, n); n at least 2.

    Run r has `p_r = mu + u_r`, with u_r of variance tau^2. Its estimate is `b_r`; the covariance C of the estimates
    includes the parameters that runs share. With `V = C + tau^2 I`, and tau^2 by restricted maximum likelihood,

        mu = 1'V^-1 b/(1'V^-1 1),      se^2 = (b - mu)'V^-1 (b - mu)/(n - 1)/(1'V^-1 1),

    and intervals use Student's t with n - 1 degrees of freedom (Hartung and Knapp 2001): with few runs the variance
    between them is itself uncertain. If the errors of runs differ by a factor ten, such intervals cover 84 % instead
    of 90 %.
    """
    n = len(values)
    own = np.sqrt(np.diag(covariance))
    # a typical size, so that the search works in any unit
    top = float(np.var(values, ddof=1) + np.max(own**2)) or 1.0

    def solve_variance(variance: float) -> tuple[float, float, float, float]:
        """Mean, 1'V^-1 1, the weighted sum of squares, minus twice the restricted log likelihood."""
        total = covariance + (variance + 1e-14 * top) * np.eye(n)
        inverse = np.linalg.inv(total)
        weight = float(inverse.sum())
        mean = float(inverse.sum(axis=0) @ values) / weight
        square = float((values - mean) @ inverse @ (values - mean))
        return mean, weight, square, float(np.linalg.slogdet(total)[1]) + np.log(weight) + square

    def cost(log_variance: float) -> float:
        return solve_variance(np.exp(log_variance))[3]

    found = minimize_scalar(cost, bounds=(np.log(1e-8 * top), np.log(1e2 * top)), method="bounded")
    variance = float(np.exp(found.x))
    if solve_variance(0.0)[3] <= found.fun + 1e-9:
        variance = 0.0
    mean, weight, square, _ = solve_variance(variance)
    scatter = square / (n - 1)
    if variance == 0.0:  # runs that agree better than their errors do not make the mean surer
        scatter = max(scatter, 1.0)
    error = float(np.sqrt(scatter / weight))
    reach = float(stdtrit(n - 1, 0.5 + level / 2)) * error
    spread = float(np.sqrt(variance))
    return Between(name, mean, error, mean - reach, mean + reach, spread, np.asarray(values), own)


@dataclass(frozen=True, kw_only=True)
class Errors(Uncertainty):
    """Errors of the parameters.

    Attributes:
        sensitivity: s of every parameter and channel (p, c).
        determined: `yes`, `no`, `prior` or `upper bound` (p,).
        why: the reason, unless it is `yes`.
    """

    sensitivity: np.ndarray
    determined: tuple[str, ...]
    why: tuple[str, ...]


def estimate_errors(point: ChannelSolution) -> Errors:
    """Errors at a solution, and the parameters that its channels do not determine.

    White residuals of known size give the covariance `S^-1`; if neighbours remain correlated, the scatter of blocks of
    scores gives it. A parameter of fixed sign is *not determined* if no channel is sensitive to it: with

        s = RMS(p dy/dp)/RMS(y) of a tension,      RMS(p dy/dp)/std(y) of other channels,

    a calibration error of 1 % of the channel changes it by 1 %/s, for any number of samples.
    """
    u = uncertainty(point)
    sensitivity = _sensitivity(point)
    verdicts = [_verdict(point, i, u.std_error[i], sensitivity[i]) for i in range(len(point.values))]
    determined, why = zip(*verdicts, strict=True)
    return Errors(**vars(u), sensitivity=sensitivity, determined=determined, why=why)


def _sensitivity(point: ChannelSolution) -> np.ndarray:
    """s of every parameter and channel (p, c)."""
    e = point.evaluation
    data = point.problem.data
    found = np.zeros((len(point.values), len(data.sensors)))
    for c, sensor in enumerate(data.sensors):
        shown = np.concatenate([run[c] for run in e.shown])
        slope = np.concatenate([run[c] for run in e.slopes])
        if not sensor.channel.of_tension:
            shown = shown - shown.mean(axis=0)
        size = np.sqrt(np.mean(shown**2))
        least = 1e-300 if sensor.relative else point.problem.noise_size[c]
        found[:, c] = np.sqrt(np.mean(slope**2, axis=(0, 1))) * np.abs(point.values) / max(size, least)
    return found


def _verdict(point: ChannelSolution, i: int, se: float, sensitivity: np.ndarray) -> tuple[str, str]:
    """How parameter i, of standard error `se` and sensitivity (c,), is determined; and why, unless it is `yes`."""
    p = point.problem.parameters[i]
    value = float(point.values[i])
    known = ("yes", "")
    if not p.low < p.high:
        return known
    if p.prior is not None and se >= PRIOR_ERROR_SHARE * p.prior[1]:
        return "prior", "determined by its prior only"
    if p.prior is not None or p.low < 0:
        return known
    most = float(sensitivity.max(initial=0.0))
    reach = quantile(0.95) * se
    bound = ("upper bound", f"below {max(value, 0.0) + reach:.3g} {p.unit} with 95 %")
    if p.in_model and p.low == 0 and value < reach:  # it is compatible with zero
        return bound
    if value > 0 and most <= LEAST_SENSITIVITY:
        moves = "no channel is sensitive to it"
        if most > 1e-6:
            name = point.problem.data.sensors[int(sensitivity.argmax())].channel.name
            moves = f"1 % of channel {name!r} is {1 / most:.0f} % of it"
        return "no", f"{moves} (d ln y/d ln p = {most:.2g})"
    if value < reach:
        return bound
    return known


#: Remark for each way in which a parameter is determined.
VERDICTS = {"yes": "", "no": "not determined", "prior": "by its prior alone", "upper bound": "upper bound"}


@dataclass(kw_only=True)
class ChannelFit(SceneFit[Problem, Evaluation]):
    """A scene fitted to channels: the content of every fit (`SceneFit`), and that of channels.

    Attributes:
        between: parameters that each run has separately, over the runs.
    """

    solution: ChannelSolution
    uncertainty: Errors
    between: tuple[Between, ...] = ()

    @property
    def errors(self) -> Errors:
        """Estimates of the parameters, and what determines them."""
        return self.uncertainty

    def note(self, i: int) -> str:
        """Remark on a parameter, by its number."""
        return ", ".join(filter(None, (VERDICTS[self.errors.determined[i]], super().note(i))))

    def fitted_scene(self, run: int = 0) -> Scene:
        """The scene of a run with the fitted values, including the run's own ones."""
        problem = self.solution.problem
        scene = problem.scenes[run]
        values = self.values[list(problem.of_run[run])]
        at = setup_with_directions(scene, problem.data, problem.plain, values)
        return fitted_scene(scene, at.setup.model, problem.plain, values)

    def channels(self) -> list[dict[str, Any]]:
        """Of every channel: kind, unit, samples, RMS of the residuals, estimated noise, remaining correlation."""
        problem = self.solution.problem
        found = []
        noise = problem.noise or Noise.as_claimed(len(problem.data.sensors), 1)
        deviations = problem.data.deviations(self.solution.evaluation.shown)
        for c, sensor in enumerate(problem.data.sensors):
            off = deviations[(problem.windows.weight[..., 0] > 0) & (problem.windows.source == c)[:, None]]
            interval = float(np.median(np.concatenate([np.diff(run.t[c]) for run in problem.data.runs])))
            noise_unit = "-" if sensor.relative else sensor.channel.measures
            found.append(
                {
                    "name": sensor.channel.name,
                    "kind": sensor.channel.kind,
                    "unit": sensor.channel.measures,
                    "samples": int(off.size),
                    "rms": float(np.sqrt(np.mean(off**2))),
                    "noise": float(problem.noise_size[c]),
                    "noise_unit": noise_unit,
                    "noise_claimed": sensor.noise,
                    "kept": float(np.exp(-noise.decay[c, 0] * interval)),
                    "correlation": float(self.errors.correlation_1[c]),
                }
            )
        return found

    def to_json(self) -> dict[str, Any]:
        """Plain values with the keys of the command line's JSON; values that are not finite become null."""
        e = self.errors
        names = [s.channel.name for s in self.solution.problem.data.sensors]
        table = self.estimates()
        for row, determined, why, felt in zip(table.values(), e.determined, e.why, e.sensitivity, strict=True):
            row |= {"determined": determined, "why": why, "sensitivity": dict(zip(names, felt, strict=True))}
        between = {row.pop("name"): row for row in map(asdict, self.between)}
        found = {"parameters": table, "channels": self.channels(), "between": between}
        found = self.common_json("channels", self.solution.problem.dt) | found
        return {key: jsonable(value) for key, value in found.items()}
