"""Errors of a fit to channels, and which parameters its channels do not determine.

White residuals of known size give the covariance `S^-1`; where neighbours still correlate, the scatter of blocks of
scores tells it (`estimate.sandwich`). A parameter that keeps its sign is *not determined* where no channel feels it:
with

    s = RMS(p dy/dp)/RMS(y) of a tension,      RMS(p dy/dp)/std(y) of other channels,

an error of calibration of 1 % of the channel moves it by 1 %/s, whatever the number of samples says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fitting.channels.descent import Point
from fitting.channels.noise import CORRELATED, CORRELATION_FLOOR, lag_one
from fitting.estimate.normal_equations import solve_spd
from fitting.estimate.sandwich import PIECES, Pieces, jackknife
from fitting.estimate.uncertainty import LEVEL, quantile
from fitting.parameters.place import ModelPlace

#: Largest sensitivity of the most sensitive channel at which a parameter is not determined.
INSENSITIVE = 0.05
#: Standard error over the prior's beyond which the prior alone tells a parameter.
PRIOR_ALONE = 0.95


@dataclass(frozen=True)
class Errors:
    """Errors of the parameters.

    Attributes:
        covariance: (p, p).
        std_error, low, high: and ends of 90 % intervals (p,).
        at_bound: (p,) bool.
        blocks: of scores that they come from; 0 where they come from the noise.
        correlation: of neighbouring residuals, by channel (c,).
        sensitivity: s of every parameter and channel (p, c).
        determined: `yes`, `no`, `prior` or `upper bound` (p,).
        why: in words, where it is not `yes`.
    """

    covariance: np.ndarray
    std_error: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_bound: np.ndarray
    blocks: int
    correlation: np.ndarray
    sensitivity: np.ndarray
    determined: tuple[str, ...]
    why: tuple[str, ...]


def errors_of(point: Point) -> Errors:
    """Errors where a fit ended."""
    problem, rows = point.problem, point.rows
    count = len(point.values)
    free = np.flatnonzero(~problem.held)
    information = point.information[np.ix_(free, free)]
    inner = solve_spd(information, np.eye(len(free))) if len(free) else information
    pull = point.weights * rows.residual
    told = [lag_one(rows, c, pull) for c in range(len(problem.data.sensors))]
    blocks = 0
    if any(abs(rho) > max(CORRELATED * sure, CORRELATION_FLOOR) for rho, sure in told):
        found = jackknife(_pieces(point, free), information, point.prior.curvature[np.ix_(free, free)])
        if found is not None:
            blocks, own = found.blocks, np.diag(inner)
            grow = np.sqrt(np.maximum(own / np.maximum(np.diag(found.covariance), 1e-300), 1.0))
            inner = found.covariance * np.outer(grow, grow)
    elif point.loss.spread != 1.0:  # a robust loss: slope over mean curvature, which its weights stand for
        weight = float(np.mean(point.weights))
        inner = inner * max(point.loss.spread / weight, 1.0) if weight > 0 else inner
    covariance = np.zeros((count, count))
    covariance[np.ix_(free, free)] = inner
    covariance = covariance + problem.known.carried_covariance(np.where(problem.held, 0.0, point.values))
    se = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    reach = quantile(0.5 + LEVEL / 2, blocks) * se
    least, most = (np.array([getattr(p, end) for p in problem.parameters]) for end in ("low", "high"))
    low, high = np.maximum(point.values - reach, least), np.minimum(point.values + reach, most)
    at_bound = ~problem.held & ((point.values <= least) | (point.values >= most))
    sensitivity = _sensitivity(point)
    verdicts = [_verdict(point, i, se[i], sensitivity[i]) for i in range(count)]
    return Errors(
        covariance,
        se,
        low,
        high,
        at_bound,
        blocks,
        np.array([rho for rho, _ in told]),
        sensitivity,
        tuple(kind for kind, _ in verdicts),
        tuple(why for _, why in verdicts),
    )


def _pieces(point: Point, free: np.ndarray) -> Pieces:
    """Gradients and information of pieces of time, all channels together."""
    rows = point.rows
    runs = int(rows.run.max()) + 1
    parts = max(int(np.ceil(PIECES / runs)), 2)
    gradient, information, of = [], [], []
    for run in range(runs):
        mine = rows.run == run
        low, high = rows.t[mine].min(), rows.t[mine].max()
        place = np.minimum(((rows.t[mine] - low) / max(high - low, 1e-300) * parts).astype(int), parts - 1)
        x, w, r = rows.jacobian[mine][:, free], point.weights[mine], rows.residual[mine]
        for part in range(parts):
            own = place == part
            gradient.append(x[own].T @ (w[own] * r[own]))
            information.append(x[own].T @ (w[own, None] * x[own]))
            of.append(run)
    return Pieces(np.array(gradient), np.array(information), np.array(of))


def _sensitivity(point: Point) -> np.ndarray:
    """s of every parameter and channel (p, c)."""
    e, data = point.evaluation, point.problem.data
    found = np.zeros((len(point.values), len(data.sensors)))
    for c, sensor in enumerate(data.sensors):
        shown = np.concatenate([run[c] for run in e.shown])
        slope = np.concatenate([run[c] for run in e.slopes])
        about = 0.0 if sensor.channel.of_tension else shown.mean(axis=0)
        size = np.sqrt(np.mean((shown - about) ** 2))
        size = max(float(size), float(point.noise.size[c]) if not sensor.relative else 0.0, 1e-300)
        found[:, c] = np.sqrt(np.mean(slope**2, axis=(0, 1))) * np.abs(point.values) / size
    return found


def _verdict(point: Point, i: int, se: float, sensitivity: np.ndarray) -> tuple[str, str]:
    p, value = point.problem.parameters[i], float(point.values[i])
    if not p.low < p.high:
        return "yes", ""
    if p.prior is not None:
        alone = se >= PRIOR_ALONE * p.prior[1]
        return ("prior", "its prior alone tells it") if alone else ("yes", "")
    if p.low < 0:
        return "yes", ""
    most, reach = float(sensitivity.max(initial=0.0)), quantile(0.95) * se
    bound = "upper bound", f"below {max(value, 0.0) + reach:.3g} {p.unit} with 95 %"
    if isinstance(p.where, ModelPlace) and p.low == 0 and value < reach:  # it may as well not be there
        return bound
    if value > 0 and most <= INSENSITIVE:
        name = point.problem.data.sensors[int(sensitivity.argmax())].channel.name
        moves = f"1 % of channel {name!r} is {1 / most:.0f} % of it" if most > 1e-6 else "no channel feels it"
        return "no", f"{moves} (d ln y/d ln p = {most:.2g})"
    return bound if value < reach else ("yes", "")
