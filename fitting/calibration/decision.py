"""Decide which laws the traces leave possible.

A law that another one contains is refuted if the traces require a coefficient that it lacks. A law that contains a
possible one is needless if its additional coefficients are not required and the traces exclude that any of them
dissipates 10 % of the energy; an effect that the traces could not show remains possible. Both are tests of coefficients
on their bound of zero. Twice the difference of the log likelihoods of q coefficients follows the mixture

    sum_i binom(q, i) 2^-q chi^2_i

(Self and Liang 1987; the weights are those of independent coefficients). If neither law contains the other, the two are
compared by their predictions of windows that were not fitted. A law that is significantly worse is refuted as well. The
remaining laws are possible; the decision is unique if one law remains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from math import comb

import numpy as np
from scipy.special import chdtrc

from fitting.calibration.cross_validation import Scores
from fitting.calibration.laws import LAWS, Law, contains

#: Probability below which the coefficients that a law lacks are significant: 0.01 over some ten laws.
REFUTED_PROBABILITY = 0.001
#: Probability above which additional coefficients count as needless.
NEEDLESS_PROBABILITY = 0.01
#: A law that does not contain the better one is refuted if its log score is worse by this number of standard errors.
REFUTING_ERRORS = 2.5
#: Minimum loss of log score for that; the same loss of log likelihood refutes a law of as many coefficients or more.
REFUTING_LOSS = 3.0
#: Loss of log likelihood with joined windows at which a law is refuted by another one of no more coefficients.
JOINED_REFUTING_LOSS = 4.0
#: Draws of windows for the laws' weights.
RESAMPLES = 1000


def chance(gain: float, coefficients: int) -> float:
    """Probability of a gain of at least `gain` in log likelihood by coefficients that are zero and non-negative."""
    total = float(gain <= 0.0)
    for i in range(1, coefficients + 1):
        total += comb(coefficients, i) * float(chdtrc(i, max(2 * gain, 0.0)))
    return total / 2**coefficients


def decide(rows: list[Law], scores: list[Scores]) -> list[Law]:
    """The laws with scores relative to the best, weights and reasons of refutation; the simplest possible is chosen."""
    logs = np.array([s.log_score for s in scores])
    best = int(np.argmax(logs.sum(1)))
    apart = logs - logs[best]
    totals = apart.sum(1).tolist()
    errors = sum_errors(apart).tolist()
    weights = shares(logs, np.random.default_rng(0)).tolist()
    # the cost of a fit that did not converge is an upper limit: a law that passes with it passes
    reasons = [""] * len(rows)
    if any(np.isfinite(row.cost) for row in rows):
        for i, row in enumerate(rows):
            if not np.isfinite(row.cost):
                reasons[i] = row.status
    alive = [i for i, reason in enumerate(reasons) if not reason]
    reasons = _by_prediction(rows, _by_likelihood(rows, reasons), logs, alive)
    found = []
    for i, row in enumerate(rows):
        reason = reasons[i]
        if reason and row.status not in ("ok", reason):
            reason = f"{row.status}; {reason}"
        found.append(replace(row, score=totals[i], score_error=errors[i], share=weights[i], refuted=reason))
    return _chosen(found)


def decide_joined(rows: list[Law], costs: Mapping[str, float], unseen: Mapping[str, tuple[str, ...]]) -> list[Law]:
    """The laws decided, using joined windows for those that were still undecided.

    Args:
        costs: of laws with joined windows, minus their log likelihoods, by name.
        unseen: their parts that may dissipate 10 % of the energy as far as joined windows show.
    """
    found = {row.name: row for row in rows}
    for name, cost in costs.items():
        found[name] = replace(found[name], joined=cost, unseen=unseen[name])
    some = [replace(row, cost=row.joined) for row in found.values() if row.name in costs]
    reasons = _by_likelihood(some, [""] * len(some))
    for (i, a), b in product(enumerate(some), some):
        apart = a.cost - b.cost
        comparable = a.coefficients >= b.coefficients and not contains(a.name, b.name)
        if not reasons[i] and comparable and apart > JOINED_REFUTING_LOSS:
            reasons[i] = f"is less likely than {b.name}, by {apart:.1f} in log likelihood"
    for row, reason in zip(some, reasons, strict=True):
        found[row.name] = replace(found[row.name], refuted=reason)
    return _chosen(list(found.values()))


def _chosen(rows: list[Law]) -> list[Law]:
    """The laws, with the simplest possible one chosen."""
    left = [i for i, row in enumerate(rows) if row.possible]
    simplest = min(left, key=lambda i: (rows[i].coefficients, -rows[i].score))
    return [replace(row, chosen=i == simplest) for i, row in enumerate(rows)]


def _by_likelihood(rows: list[Law], reasons: list[str]) -> list[str]:
    """Reasons to reject laws that others contain, or that contain others."""
    reasons = list(reasons)
    alive = [i for i, reason in enumerate(reasons) if not reason]
    for i, j in product(alive, alive):
        if not reasons[i] and contains(rows[j].name, rows[i].name):
            gain = rows[i].cost - rows[i].unreached - rows[j].cost
            p = chance(gain, rows[j].coefficients - rows[i].coefficients)
            if p < REFUTED_PROBABILITY:
                reasons[i] = f"lacks what {rows[j].name} has (p = {p:.1g})"
    # from the simplest law on: a law is needless only if a simpler law that it contains remains
    for j, i in product(sorted(alive, key=lambda j: rows[j].coefficients), alive):
        if not reasons[j] and not reasons[i] and contains(rows[j].name, rows[i].name):
            p = chance(rows[i].cost - rows[j].cost, rows[j].coefficients - rows[i].coefficients)
            more = set(LAWS[rows[j].name]) - set(LAWS[rows[i].name])
            # if a law has several more parts, one of them alone must be undecided
            between = [k for k in alive if contains(rows[k].name, rows[i].name)]
            between = [k for k in between if contains(rows[j].name, rows[k].name)]
            if between:
                open_parts = any(not reasons[k] for k in between)
            else:
                open_parts = more & set(rows[j].unseen)
            if p > NEEDLESS_PROBABILITY and not open_parts:
                reasons[j] = f"needs no more than {rows[i].name} (p = {p:.1g})"
    return reasons


def _by_prediction(rows: list[Law], reasons: list[str], logs: np.ndarray, alive: list[int]) -> list[str]:
    """Reasons to reject laws that predict worse than others of no more coefficients."""
    reasons = list(reasons)
    for i, j in product(alive, alive):
        if not reasons[i] and not reasons[j] and i != j and rows[i].coefficients >= rows[j].coefficients:
            apart = logs[j] - logs[i]
            loss = float(apart.sum())
            error = float(sum_errors(apart[None])[0])
            predicts = loss > REFUTING_LOSS and loss > REFUTING_ERRORS * error
            likelier = rows[i].cost - rows[j].cost > REFUTING_LOSS and loss > 0
            if not contains(rows[i].name, rows[j].name) and (predicts or likelier):
                reasons[i] = f"predicts worse than {rows[j].name}, by {loss:.1f} +- {error:.1f}"
    return reasons


def deviation(rows: np.ndarray) -> np.ndarray:
    """Standard deviations of rows (laws, windows); NaN if no window is scored (a run of one window)."""
    count = rows.shape[1]
    if count:
        return np.std(rows, axis=1, ddof=min(1, count - 1))
    return np.full(len(rows), np.nan)


def sum_errors(rows: np.ndarray) -> np.ndarray:
    """Standard errors of the sums of rows (laws, windows), whose windows are independent."""
    return deviation(rows) * np.sqrt(rows.shape[1])


def shares(logs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Weights (laws,) of log scores (laws, K), a mean over resampled windows (Yao et al. 2018, pseudo-BMA+)."""
    drawn = rng.dirichlet(np.ones(logs.shape[1]), RESAMPLES) * logs.shape[1]
    totals = drawn @ logs.T
    weights = np.exp(totals - totals.max(axis=1, keepdims=True))
    return np.mean(weights / weights.sum(axis=1, keepdims=True), axis=0)


def verdict(rows: list[Law]) -> str:
    """The decision in words: the law's name, or the names that the traces leave undecided."""
    left = [row.name for row in rows if row.possible]
    if len(left) == 1:
        return left[0]
    return "undecided {" + ", ".join(left) + "}"
