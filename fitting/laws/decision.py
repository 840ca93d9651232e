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

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import comb

import numpy as np
from scipy.special import chdtrc

from fitting.laws.cross_validation import Scores
from fitting.laws.laws import LAWS, Law, contains

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
        total += comb(coefficients, i) * chdtrc(i, max(2 * gain, 0.0))
    return total / 2**coefficients


def decide(rows: list[Law], scores: list[Scores]) -> list[Law]:
    """The laws with scores relative to the best, weights and reasons of refutation; the simplest possible is chosen."""
    logs = np.array([s.log_score for s in scores])
    best = np.argmax(logs.sum(1))
    apart = logs - logs[best]
    totals = apart.sum(1).tolist()
    errors = sum_errors(apart).tolist()
    weights = shares(logs, np.random.default_rng(0)).tolist()
    refuted: dict[str, str] = {}
    # the cost of a fit that did not converge is an upper limit: a law that passes with it passes
    if any(np.isfinite(row.cost) for row in rows):
        refuted = {row.name: row.status for row in rows if not np.isfinite(row.cost)}
    fitted = [row for row in rows if row.name not in refuted]
    _refute_by_likelihood(fitted, refuted)
    _refute_by_prediction(fitted, dict(zip([row.name for row in rows], logs, strict=True)), refuted)
    found = []
    for i, row in enumerate(rows):
        reason = refuted.get(row.name, "")
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
    refuted: dict[str, str] = {}
    _refute_by_likelihood(some, refuted)
    for law, other in product(some, some):
        apart = law.cost - other.cost
        comparable = law.coefficients >= other.coefficients and not contains(law.name, other.name)
        if law.name not in refuted and comparable and apart > JOINED_REFUTING_LOSS:
            refuted[law.name] = f"is less likely than {other.name}, by {apart:.1f} in log likelihood"
    for name in costs:
        found[name] = replace(found[name], refuted=refuted.get(name, ""))
    return _chosen(list(found.values()))


def _chosen(rows: list[Law]) -> list[Law]:
    """The laws, with the simplest possible one chosen."""
    left = [i for i, row in enumerate(rows) if row.possible]
    simplest = min(left, key=lambda i: (rows[i].coefficients, -rows[i].score))
    return [replace(row, chosen=i == simplest) for i, row in enumerate(rows)]


def _refute_by_likelihood(laws: Sequence[Law], refuted: dict[str, str]) -> None:
    """Refute laws that others contain, or that contain others: adds the reasons by name."""
    for law, larger in product(laws, laws):
        if law.name not in refuted and contains(larger.name, law.name):
            p = chance(law.cost - law.unreached - larger.cost, larger.coefficients - law.coefficients)
            if p < REFUTED_PROBABILITY:
                refuted[law.name] = f"lacks what {larger.name} has (p = {p:.1g})"
    # from the simplest law on: a law is needless only if a simpler law that it contains remains
    for law, smaller in product(sorted(laws, key=lambda law: law.coefficients), laws):
        if not refuted.keys() & {law.name, smaller.name} and contains(law.name, smaller.name):
            p = chance(smaller.cost - law.cost, law.coefficients - smaller.coefficients)
            if p > NEEDLESS_PROBABILITY and not _has_open_part(law, smaller, laws, refuted):
                refuted[law.name] = f"needs no more than {smaller.name} (p = {p:.1g})"


def _has_open_part(law: Law, smaller: Law, laws: Sequence[Law], refuted: Mapping[str, str]) -> bool:
    """Whether a part that a law has in addition to a smaller one is undecided; of several, one of them alone."""
    between = [one.name for one in laws if contains(law.name, one.name) and contains(one.name, smaller.name)]
    if between:
        return not refuted.keys() >= set(between)
    return not set(law.unseen) <= set(LAWS[smaller.name])


def _refute_by_prediction(laws: Sequence[Law], logs: Mapping[str, np.ndarray], refuted: dict[str, str]) -> None:
    """Refute laws that predict worse than others of no more coefficients: adds the reasons by name.

    Args:
        logs: log scores of the windows (K,) by law.
    """
    for law, other in product(laws, laws):
        possible = law is not other and not refuted.keys() & {law.name, other.name}
        if possible and law.coefficients >= other.coefficients and not contains(law.name, other.name):
            apart = logs[other.name] - logs[law.name]
            loss = apart.sum()
            error = sum_errors(apart[None])[0]
            predicts = loss > REFUTING_LOSS and loss > REFUTING_ERRORS * error
            likelier = law.cost - other.cost > REFUTING_LOSS and loss > 0
            if predicts or likelier:
                refuted[law.name] = f"predicts worse than {other.name}, by {loss:.1f} +- {error:.1f}"


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
