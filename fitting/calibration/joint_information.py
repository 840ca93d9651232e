"""Information and gradient of free and further parameters at the end of a fit, and score tests of the further ones.

Let f be the free numbers, S the information of all numbers together and g their gradient, with the starts of the
windows eliminated; both include the gaps of joined windows, priors and poses at rest. Freeing the numbers c would
change them by d and raise the log likelihood, to first order, by

    d = -A^-1 u,    gain = u' A^-1 u / 2,    A = S_cc - S_cf S_ff^-1 S_fc,    u = g_c - S_cf S_ff^-1 g_f

in units of the noise that the fit estimated, including its memory (Rao 1948).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from fitting.estimate.factors import invert_spd, solve_spd
from fitting.estimate.normal_equations import eliminate, prior_of
from fitting.estimate.objective import objective_at
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import rig_priors
from fitting.windows.prepared import Prepared


class ScoreChange(NamedTuple):
    """What freeing c numbers would do, to first order.

    Attributes:
        change, error: of these numbers and its standard error (c,).
        moves: of the free parameters (f,).
        gain: in log likelihood.
        p: probability of such a gain if nothing is wrong.
    """

    change: np.ndarray
    error: np.ndarray
    moves: np.ndarray
    gain: float
    p: float


#: Fraction of a number's information that must remain once the free parameters are accounted for.
LEAST_INFORMATION_SHARE = 1e-7


class JointInformation(NamedTuple):
    """Information (k, k) and gradient (k,) of free and further parameters.

    Attributes:
        S, g: of measurements and priors.
        data: information of the measurements alone.
    """

    S: np.ndarray
    g: np.ndarray
    data: np.ndarray

    def score_change(self, free: np.ndarray, mine: np.ndarray) -> ScoreChange | None:
        """The change that freeing the numbers `mine` would make; None if the traces carry no information on them."""
        if not (np.diag(self.data)[mine] > 0).all():
            return None
        A = self.S[np.ix_(mine, mine)]
        u = self.g[mine]
        inner = np.zeros((0, len(mine) + 1))
        if len(free):
            rows = np.column_stack([self.S[np.ix_(free, mine)], self.g[free]])
            inner = solve_spd(self.S[np.ix_(free, free)], rows)
            cross = self.S[np.ix_(mine, free)]
            A = A - cross @ inner[:, :-1]
            u = u - cross @ inner[:, -1]
        scale = 1 / np.sqrt(np.diag(self.S)[mine])
        if np.linalg.eigvalsh(A * np.outer(scale, scale))[0] < LEAST_INFORMATION_SHARE:
            return None
        change = -solve_spd(A, u)
        gain = float(-0.5 * u @ change)
        error = np.sqrt(np.diag(invert_spd(A)))
        p = float(chdtrc(len(A), max(2 * gain, 0.0)))
        return ScoreChange(change, error, -inner @ np.append(change, 1.0), gain, p)


def joint_information(
    prepared: Prepared, solution: Solution, simulator: Simulator, more: Sequence[Parameter]
) -> JointInformation:
    """Information of the free and further parameters at the end of a fit."""
    problem = solution.problem
    every, known = rig_priors(prepared.scene, prepared.simulator.model, [*problem.parameters, *more])
    values = np.concatenate([solution.values, [p.value for p in more]])
    extended = replace(problem, simulator=simulator.view_of(every), parameters=every, frozen=None, known=known)
    evaluation = extended.evaluate(values, solution.starts)
    system = objective_at(extended, solution.gap_weight).system(evaluation, values)
    no_change = np.zeros(len(values))
    step = eliminate(system, 0.0, extended.prior(values), no_change, no_change)
    prior = prior_of(every, values, known.common)
    data = step.information - prior.curvature
    slope = step.gradient - prior.gradient
    return JointInformation(data / problem.memory + prior.curvature, slope / problem.memory + prior.gradient, data)
