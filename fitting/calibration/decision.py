"""Decide which laws the traces leave possible.

A law that another one contains is refuted if the traces require a coefficient that it lacks. A law that contains a
possible one is needless if its additional coefficients are not required and the traces exclude that any of them
dissipates 10 % of the energy; an effect that the traces could not show remains possible. Both are tests of coefficients
on their bound of zero. Twice the difference of the log likelihoods of q coefficients follows the mixture

    sum_i binom(q, i) 2^-q chi^2_i

(Self and Liang 1987; the weights are those of independent coefficients). If neither law contains the other, the two are
compared by their predictions of windows that were not fitted. A law that is significantly worse is refuted as well. The
remaining laws are possible; the decision is unique if one law remains.

Parts of a damping law that the traces could not have shown.

Let w_i be the energy that a unit of coefficient i would dissipate in the measured motion (its power over the whole
trace, without any simulation). A part of a law with coefficients c dissipates w . c. A fraction `SHARE` of the total
loss is excluded if

    w . c + z sqrt(w' C w) < SHARE W,       C: covariance of c given all other parameters of the law

at the optimum without bounds. A part that is neither significant nor excluded remains undecided: its damping of this
motion was too weak to be detected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import chdtrc, ndtri

from dropper_jax.effects.joint_friction import JointFriction
from dropper_jax.model import Model
from dropper_jax.model.slots import Force
from fitting.calibration.cross_validation import Scores
from fitting.calibration.law_fits import LADDER, Law, contains
from fitting.calibration.preparation import Prepared
from fitting.estimate.factors import solve_spd
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator
from fitting.parameters.names import DAMPING
from fitting.parameters.parameter import apply
from fitting.traces import planar
from fitting.traces.noise import smooth_stretch


def dissipation(model: Model, theta: Array, omega: Array) -> Array:
    """Power [W] dissipated by the damping in a pose with rates."""
    s = planar.to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    taken = jnp.zeros(())
    for effect in model.having(Force):
        if effect.name in DAMPING:
            taken = taken - jnp.sum(effect.force(k) * k.v)
        if isinstance(effect, JointFriction) and effect.dry is not None:
            rate = jnp.sum(jnp.abs(effect.relative_rates(k)), axis=1)
            taken = taken + jnp.sum(jnp.broadcast_to(effect.dry, (model.line.links + 1,))[: len(rate)] * rate)
    return taken


#: Fraction of the lost energy that must be detectable for a part, and normal quantile of its upper limit.
SHARE = 0.1
LIMIT = float(ndtri(0.95))


#: Half width of the smoother of the measured motion, as a fraction of the shortest link's period.
SMOOTHER = 0.06


def unit_work(prepared: Prepared, simulator: Simulator, owner: Sequence[str | None]) -> np.ndarray:
    """Energy dissipated in the measured motions by a unit of every coefficient (k,) [J per unit]; otherwise 0."""
    found = np.zeros(len(owner))
    whole = np.array([p.value for p in simulator.parameters])
    others = np.array([part is None for part in owner])

    @jax.jit
    def power(values: Array, theta: Array, omega: Array) -> Array:
        model = apply(simulator.model, simulator.parameters, values)
        return jax.vmap(lambda a, w: dissipation(model, *planar.close_chain(model, a, w)))(theta, omega)

    for run, trace in enumerate(prepared.traces):
        mine = prepared.windows.run == run
        if not mine.any():
            continue
        span = float(prepared.windows.begin[mine].min()), float(prepared.windows.ends[mine].max())
        motion = smooth_stretch(trace, span, SMOOTHER * prepared.period)
        if motion is None:
            continue
        t, theta, omega = motion
        for i in np.flatnonzero(~others):
            values = np.where(others, whole, np.arange(len(owner)) == i)
            found[i] += float(np.mean(power(jnp.asarray(values), theta, omega))) * float(t[-1] - t[0])
    return found


def unseen(law: Solution, owner: Sequence[str | None], per_unit: np.ndarray) -> tuple[str, ...]:
    """Parts of a law for which the traces do not exclude that they dissipate `SHARE` of the energy."""
    free = np.flatnonzero(~law.problem.held_mask)
    if not len(free) or not per_unit.any():
        return ()
    prior = law.problem.prior(law.values).curvature
    memory = law.problem.memory
    information = ((law.information - prior) / memory + prior)[np.ix_(free, free)]
    covariance = solve_spd(information, np.eye(len(free)))
    centre = law.values[free] - covariance @ law.gradient[free] / memory
    lost = float(per_unit @ law.values)
    work = {}
    for i in free:
        work[owner[i]] = np.where([owner[j] == owner[i] for j in free], per_unit[free], 0.0)
    highest = {part: float(w @ centre) + LIMIT * np.sqrt(w @ covariance @ w) for part, w in work.items()}
    return tuple(part for part, most in highest.items() if part is not None and most >= SHARE * lost)


#: Probability below which a missing coefficient counts as shown (0.01 over some ten laws), and above which an
#: additional one counts as needless.
LACKS = 0.001
NEEDLESS = 0.01
#: A law that does not contain the better one is refuted if its log score is worse by this many of its standard errors
#: and by at least this amount, or if its likelihood is that much worse with as many coefficients or more.
STANDARD_ERRORS = 2.5
WORSE = 3.0
#: Draws of windows for the laws' weights.
DRAWS = 1000


def chance(gain: float, coefficients: int) -> float:
    """Probability of a gain of at least `gain` in log likelihood by coefficients that are zero and non-negative."""
    beyond = [float(gain <= 0.0), *(chdtrc(i, max(2 * gain, 0.0)) for i in range(1, coefficients + 1))]
    return float(sum(comb(coefficients, i) * p for i, p in enumerate(beyond)) / 2**coefficients)


def decide(rows: list[Law], scores: list[Scores]) -> list[Law]:
    """The laws with scores relative to the best, weights and reasons of refutation; the simplest possible is chosen."""
    logs = np.array([s.log_score for s in scores])
    best = int(np.argmax(logs.sum(1)))
    apart = logs - logs[best]
    share = shares(logs, np.random.default_rng(0))
    columns = np.array([apart.sum(1), deviation(apart) * np.sqrt(logs.shape[1]), share]).T.tolist()
    rows = [replace(row, score=a, score_error=b, share=c) for row, (a, b, c) in zip(rows, columns, strict=True)]
    # the cost of a fit that did not converge is an upper limit: a law that passes with it passes
    none_finite = not any(np.isfinite(row.cost) for row in rows)
    reasons = ["" if none_finite or np.isfinite(row.cost) else row.status for row in rows]
    alive = [i for i, reason in enumerate(reasons) if not reason]
    reasons = _by_prediction(rows, _by_likelihood(rows, reasons), logs, alive)
    reasons = [
        f"{row.status}; {reason}" if reason and row.status not in ("ok", reason) else reason
        for row, reason in zip(rows, reasons, strict=True)
    ]
    return _chosen([replace(row, refuted=reason) for row, reason in zip(rows, reasons, strict=True)])


def decide_joined(rows: list[Law], costs: Mapping[str, float], unseen: Mapping[str, tuple[str, ...]]) -> list[Law]:
    """The laws decided, using joined windows for those that were still undecided.

    Args:
        costs: of laws with joined windows, minus their log likelihoods, by name.
        unseen: their parts that may dissipate 10 % of the energy as far as joined windows show.
    """
    rows = [replace(row, joined=costs[row.name], unseen=unseen[row.name]) if row.name in costs else row for row in rows]
    some = [replace(row, cost=row.joined) for row in rows if row.name in costs]
    reasons = _by_likelihood(some, [""] * len(some))
    for (i, a), b in product(enumerate(some), some):
        apart = a.cost - b.cost
        # difference of log likelihood with joined windows at which a law is refuted by another of no more coefficients
        if not reasons[i] and a.coefficients >= b.coefficients and not contains(a.name, b.name) and apart > 4.0:
            reasons[i] = f"is less likely than {b.name}, by {apart:.1f} in log likelihood"
    refuted = {row.name: reason for row, reason in zip(some, reasons, strict=True)}
    return _chosen([replace(row, refuted=refuted.get(row.name, row.refuted)) for row in rows])


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
            reasons[i] = f"lacks what {rows[j].name} has (p = {p:.1g})" if p < LACKS else ""
    # from the simplest law on: a law is needless only if a simpler law that it contains remains
    for j, i in product(sorted(alive, key=lambda j: rows[j].coefficients), alive):
        if not reasons[j] and not reasons[i] and contains(rows[j].name, rows[i].name):
            p = chance(rows[i].cost - rows[j].cost, rows[j].coefficients - rows[i].coefficients)
            more = set(LADDER[rows[j].name]) - set(LADDER[rows[i].name])
            # if a law has several more parts, one of them alone must be undecided
            between = [k for k in alive if contains(rows[k].name, rows[i].name)]
            between = [k for k in between if contains(rows[j].name, rows[k].name)]
            if between:
                open_parts = any(not reasons[k] for k in between)
            else:
                open_parts = more & set(rows[j].unseen)
            if p > NEEDLESS and not open_parts:
                reasons[j] = f"needs no more than {rows[i].name} (p = {p:.1g})"
    return reasons


def _by_prediction(rows: list[Law], reasons: list[str], logs: np.ndarray, alive: list[int]) -> list[str]:
    """Reasons to reject laws that predict worse than others of no more coefficients."""
    reasons = list(reasons)
    for i, j in product(alive, alive):
        if not reasons[i] and not reasons[j] and i != j and rows[i].coefficients >= rows[j].coefficients:
            apart = logs[j] - logs[i]
            error = 0.0
            if len(apart):
                error = np.sqrt(len(apart)) * np.std(apart)
            predicts = apart.sum() > max(STANDARD_ERRORS * error, WORSE)
            likelier = rows[i].cost - rows[j].cost > WORSE and apart.sum() > 0
            if not contains(rows[i].name, rows[j].name) and (predicts or likelier):
                reasons[i] = f"predicts worse than {rows[j].name}, by {apart.sum():.1f} +- {error:.1f}"
    return reasons


def deviation(rows: np.ndarray) -> np.ndarray:
    """Standard deviations of rows (laws, windows); NaN if no window is scored (a run of one window)."""
    count = rows.shape[1]
    if count:
        return np.std(rows, axis=1, ddof=1 if count > 1 else 0)
    return np.full(len(rows), np.nan)


def shares(logs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Weights (laws,) of log scores (laws, K), a mean over resampled windows (Yao et al. 2018, pseudo-BMA+)."""
    drawn = rng.dirichlet(np.ones(logs.shape[1]), DRAWS) * logs.shape[1]
    totals = drawn @ logs.T
    weights = np.exp(totals - totals.max(axis=1, keepdims=True))
    return np.mean(weights / weights.sum(axis=1, keepdims=True), axis=0)


def verdict(rows: list[Law]) -> str:
    """The decision in words: the law's name, or the names that the traces leave undecided."""
    left = [row.name for row in rows if row.possible]
    if len(left) == 1:
        return left[0]
    return "undecided {" + ", ".join(left) + "}"
