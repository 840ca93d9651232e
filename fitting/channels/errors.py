"""Errors of the parameters of a fit to channels, and which of them the channels determine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.channels.problem import ChannelSolution
from fitting.estimate.uncertainty import Uncertainty, quantile, uncertainty

#: Error of a parameter, over that of its prior, from which the data add next to nothing to the prior.
PRIOR_ERROR_SHARE = 0.95
#: Sensitivity up to which a parameter is not determined: 1 % of the channel changes it by 20 %.
LEAST_SENSITIVITY = 0.05
#: Remark for each way in which a parameter is determined.
VERDICTS = {"yes": "", "no": "not determined", "prior": "by its prior alone", "upper bound": "upper bound"}


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
    verdicts = [_verdict(point, i, *row) for i, row in enumerate(zip(u.std_error, sensitivity, strict=True))]
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
    value = point.values[i]
    known = ("yes", "")
    if not p.low < p.high:
        return known
    if p.prior is not None and se >= PRIOR_ERROR_SHARE * p.prior[1]:
        return "prior", "determined by its prior only"
    if p.prior is not None or p.low < 0:
        return known
    most = sensitivity.max(initial=0.0)
    reach = quantile(0.95) * se
    bound = ("upper bound", f"below {max(value, 0.0) + reach:.3g} {p.unit} with 95 %")
    if p.in_model and p.low == 0 and value < reach:  # it is compatible with zero
        return bound
    if value > 0 and most <= LEAST_SENSITIVITY:
        moves = "no channel is sensitive to it"
        if most > 1e-6:
            name = point.problem.data.sensors[sensitivity.argmax()].channel.name
            moves = f"1 % of channel {name!r} is {1 / most:.0f} % of it"
        return "no", f"{moves} (d ln y/d ln p = {most:.2g})"
    if value < reach:
        return bound
    return known
