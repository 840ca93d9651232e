"""Errors of a fit to channels, and the parameters that its channels do not determine.

White residuals of known size give the covariance `S^-1`; if neighbours remain correlated, the scatter of blocks of
scores gives it (`estimate.sandwich`). A parameter of fixed sign is *not determined* if no channel is sensitive to it:
with

    s = RMS(p dy/dp)/RMS(y) of a tension,      RMS(p dy/dp)/std(y) of other channels,

a calibration error of 1 % of the channel changes it by 1 %/s, for any number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.estimate.problem import Solution
from fitting.estimate.uncertainty import Uncertainty, quantile, uncertainty
from fitting.parameters.target import ModelPlace

#: Sensitivity of the most sensitive channel up to which a parameter is not determined.
INSENSITIVE = 0.05
#: Ratio of the standard error to that of the prior above which only the prior determines a parameter.
PRIOR_ALONE = 0.95


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


def errors_of(point: Solution) -> Errors:
    """Errors at a solution."""
    u, sensitivity = uncertainty(point), _sensitivity(point)
    verdicts = [_verdict(point, i, u.std_error[i], sensitivity[i]) for i in range(len(point.values))]
    determined, why = zip(*verdicts, strict=True)
    return Errors(**vars(u), sensitivity=sensitivity, determined=determined, why=why)


def _sensitivity(point: Solution) -> np.ndarray:
    """s of every parameter and channel (p, c)."""
    e, data = point.evaluation, point.problem.data
    found = np.zeros((len(point.values), len(data.sensors)))
    for c, sensor in enumerate(data.sensors):
        shown = np.concatenate([run[c] for run in e.shown])
        slope = np.concatenate([run[c] for run in e.slopes])
        about = 0.0 if sensor.channel.of_tension else shown.mean(axis=0)
        size = np.sqrt(np.mean((shown - about) ** 2))
        size = max(float(size), float(point.problem.noise.size[c]) if not sensor.relative else 0.0, 1e-300)
        found[:, c] = np.sqrt(np.mean(slope**2, axis=(0, 1))) * np.abs(point.values) / size
    return found


def _verdict(point: Solution, i: int, se: float, sensitivity: np.ndarray) -> tuple[str, str]:
    p, value = point.problem.parameters[i], float(point.values[i])
    if not p.low < p.high:
        return "yes", ""
    if p.prior is not None:
        alone = se >= PRIOR_ALONE * p.prior[1]
        return ("prior", "determined by its prior only") if alone else ("yes", "")
    if p.low < 0:
        return "yes", ""
    most, reach = float(sensitivity.max(initial=0.0)), quantile(0.95) * se
    bound = "upper bound", f"below {max(value, 0.0) + reach:.3g} {p.unit} with 95 %"
    if isinstance(p.where, ModelPlace) and p.low == 0 and value < reach:  # it is compatible with zero
        return bound
    if value > 0 and most <= INSENSITIVE:
        name = point.problem.data.sensors[int(sensitivity.argmax())].channel.name
        moves = f"1 % of channel {name!r} is {1 / most:.0f} % of it" if most > 1e-6 else "no channel is sensitive to it"
        return "no", f"{moves} (d ln y/d ln p = {most:.2g})"
    return bound if value < reach else ("yes", "")
