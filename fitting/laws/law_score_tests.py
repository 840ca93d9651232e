"""Is the damping law right? Score tests of the forces that a fit leaves out, on the joined windows of its end.

A wrong law leaves residuals that look like noise: the starts of the windows absorb it, and the gaps between windows
take what is left. Let g_b be the gradient of the cost on block b of windows and S_b its information, by the free
parameters f and one candidate c at zero, with the starts of the windows eliminated and the gaps included. With
S = sum S_b, the candidate and the free parameters would move, to first order, by

    d = -S^-1 g,    cov = (B - 1)/B sum_b (e_b - mean e)(e_b - mean e)',    e_b = (S - S_b)^-1 (g_b + S_b d)

(Rao 1948; jackknife over B blocks as in `uncertainty`), with B minus the number of parameters degrees of freedom. The
variance is pooled with that of the noise, of `NOISE_DEGREES` (Smyth 2004), and at least the latter. A large misfit has
a long memory, and its few blocks alone would have few degrees of freedom. The ratio `t = d_c/sqrt(cov_cc)` has
Student's law. A coefficient that the scene lacks can only grow: its test is one-sided. Holm's correction (1979)
accounts for the number of candidates.

A wrong law also loosens the joins of its fit: they are as tight as the evidence allows without the candidate. Each
candidate is tested at the gap weight that the evidence allows with it, by the linear model of the fit's end, which has
evidence for every weight. Its gain in log likelihood is the difference of both evidences.

The candidate of largest gain is freed in this model, and the others are tested again, as long as one is significant: a
force that seems to be missing only because another one is missing is not. Changes of a coefficient are candidates of
the same family, but are freed only once no force is significant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.special import ndtri, stdtr

from fitting.estimate.blocks import TimePieces, block_length, jackknife, time_pieces
from fitting.estimate.factors import eliminate_rows, solve_spd
from fitting.estimate.normal_equations import Evaluation, Prior, eliminate, move_along
from fitting.estimate.objective import objective_at
from fitting.estimate.shooting import GAP_WEIGHTS, loosest_of
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import Uncertainty
from fitting.laws.law_candidates import LawCandidate, law_candidates, with_coefficient_changes
from fitting.laws.law_tests import NOTICED_SHARE, SIGNIFICANCE, LawTest, LawTests, holm
from fitting.windows.prepared import Prepared

#: Change of a parameter [its standard errors] that matters if it is also at least `NOTICED_SHARE` of its value.
NOTICED_ERRORS = 2.0
#: Correlation of two candidates above which the traces cannot distinguish them.
ALIKE_CORRELATION = 0.98
#: Fraction of a candidate's information, in separate windows, that must remain once the free parameters are accounted
#: for. Any force moves tightly joined windows of a chaotic motion along one direction: 1e-5 remains there, and decides.
LEAST_INFORMATION_SHARE = 1e-4
#: Change of a parameter [its standard errors], by a force that is neither significant nor excluded, from which the
#: parameter includes that force: a correlation of 0.98 hides this much.
INCLUDED_ERRORS = 5.0
#: Probability that a force is below its upper limit.
EXCLUSION_PROBABILITY = 0.95
#: Fraction of a force's effect in separate windows from which a parameter that acts like it includes it.
INCLUDED_SHARE = 0.2
#: Degrees of freedom of the blocks below which nothing is tested.
FEWEST_DEGREES = 3
#: Degrees of freedom of the variance that the noise predicts.
NOISE_DEGREES = 10
#: Maximum number of candidates that are freed in the linear model, one after another.
MOST_FREED = 3


def score_tests(prepared: Prepared, solution: Solution, errors: Uncertainty) -> LawTests:
    """Test every candidate at the end of a fit; none if its programs do not know them.

    Args:
        errors: of the fit.
    """
    problem = solution.problem
    candidates = law_candidates(prepared, problem)
    forces = [one.parameter for one in candidates if one.coefficient is None]
    if not problem.simulator.knows(forces):
        return LawTests()
    every = (*problem.parameters, *forces)
    extended = replace(problem, simulator=problem.simulator.view_of(every), parameters=every, frozen=None)
    values = np.concatenate([solution.values, np.zeros(len(forces))])
    evaluation = extended.evaluate(values, solution.starts)
    if not np.isfinite(evaluation.jacobian).all():
        return LawTests()
    changes = [one for one in candidates if one.coefficient is not None]
    evaluation = with_coefficient_changes(solution, evaluation, changes)
    own = problem.prior(solution.values)  # nothing is known of the candidates beforehand
    more = len(candidates)
    prior = Prior(own.cost, np.pad(own.gradient, (0, more)), np.pad(own.curvature, (0, more)))
    no_change = np.zeros(len(prior.gradient))
    system = objective_at(problem, None).system(evaluation, solution.values)
    separate = eliminate(system, 0.0, prior, no_change, no_change).information
    variance = errors.noise**2 * problem.memory
    models = linear_models(solution, evaluation, prior, variance)
    free = np.flatnonzero(~problem.held_mask & ~errors.at_bound)
    return ScoreTests(solution, errors, candidates, models, separate, free, variance).run()


class LinearModel(NamedTuple):
    """The linear model of a fit's end at one gap weight, with the starts of the windows at their optimum.

    Attributes:
        information: by all parameters and candidates (k + c, k + c).
        gradient: of the cost (k + c,).
        evidence: log evidence of the weight, before a move of the parameters.
        parts: gradients and information of pieces of time.
    """

    information: np.ndarray
    gradient: np.ndarray
    evidence: float
    parts: TimePieces

    def evidence_with(self, free: np.ndarray, variance: float) -> float:
        """Log evidence of the weight with these numbers free; minus infinity if rounding leaves them undetermined.

        Args:
            variance: of the noise, times its memory.
        """
        gradient = self.gradient[free]
        try:
            step = solve_spd(self.information[np.ix_(free, free)], gradient)
        except LinAlgError:
            return -np.inf
        return self.evidence + 0.5 * gradient @ step / variance


def linear_models(solution: Solution, evaluation: Evaluation, prior: Prior, variance: float) -> list[LinearModel]:
    """The linear models at the gap weight of the fit and at all tighter ones."""
    every = np.arange(len(prior.gradient))
    no_change = np.zeros(len(every))
    weights = [solution.gap_weight]
    if solution.gap_weight:
        weights += [weight for weight in GAP_WEIGHTS if weight < solution.gap_weight]
    models = []
    for weight in weights:
        objective = objective_at(solution.problem, weight)
        try:
            step = eliminate(objective.system(evaluation, solution.values), 0.0, prior, no_change, no_change)
        except LinAlgError:  # tight joins of a chaotic motion exhaust the digits
            break
        gain = step.predicted - objective.cost(evaluation, solution.values)
        moved = move_along(evaluation, step.dz)
        at_weight = replace(solution, evaluation=moved, eliminated=step.eliminated, gap_weight=weight)
        evidence = gain / variance - objective.log_volume(step)
        models.append(LinearModel(step.information, step.gradient, evidence, time_pieces(at_weight, every)))
    return models


class CandidateTest(NamedTuple):
    """A test, the number of its candidate, and the linear model in which it was made."""

    test: LawTest
    candidate: int
    model: LinearModel


#: A force in words, and the sign (k,) of the change of each free parameter that it may cause; 0: none that matters.
HiddenForce = tuple[str, np.ndarray]


@dataclass(frozen=True)
class ScoreTests:
    """The tests of all candidates of one fit.

    Attributes:
        models: linear models at several gap weights.
        separate: information of separate windows, by all parameters and candidates.
        free: numbers of the free parameters that are not at a bound.
        variance: of the noise, in units of the assumed one, times its memory.
    """

    solution: Solution
    errors: Uncertainty
    candidates: Sequence[LawCandidate]
    models: Sequence[LinearModel]
    separate: np.ndarray
    free: np.ndarray
    variance: float

    def row(self, candidate: int) -> int:
        """Row of a candidate in the information: candidates follow the parameters of the fit."""
        return len(self.solution.values) + candidate

    def run(self) -> LawTests:
        """The tests of all candidates; the force of largest gain is freed as long as one is significant."""
        rows = np.array([self.row(i) for i in range(len(self.candidates))], int)
        remaining = np.diag(eliminate_rows(self.separate, self.free, rows))
        remaining_share = remaining / np.maximum(np.diag(self.separate)[rows], 1e-300)
        hidden: list[HiddenForce] = []
        untested = []
        for i, candidate in enumerate(self.candidates):
            if remaining_share[i] > LEAST_INFORMATION_SHARE:
                untested.append(i)
            elif candidate.only_grows:
                hidden.append((candidate.name, self._signs_of_duplicate(rows[i])))
        freed: list[LawTest] = []
        free = self.free
        while True:
            tests = self.test(untested, free)
            first = next((one for one in tests if one.test.p < SIGNIFICANCE), None)
            if first is None or len(freed) == MOST_FREED:
                break
            freed.append(replace(first.test, alike=self._alike(first, tests, free)))
            free = np.append(free, rows[first.candidate])
            untested.remove(first.candidate)
        for one in tests:
            if self.candidates[one.candidate].only_grows:
                hidden.append((one.test.name, self._signs_of_upper_limit(one, free)))
        others = (one.test for one in tests)
        return LawTests((*freed, *others), self._by_parameter(hidden, 1), self._by_parameter(hidden, -1))

    def _by_parameter(self, hidden: Sequence[HiddenForce], sign: int) -> dict[str, tuple[str, ...]]:
        """Names of the forces that may change a free parameter in the direction of this sign, by parameter."""
        forces: dict[str, tuple[str, ...]] = {}
        for force, signs in hidden:
            for j in np.flatnonzero(signs == sign):
                parameter = self.solution.problem.names[self.free[j]]
                forces[parameter] = (*forces.get(parameter, ()), force)
        return forces

    def test(self, candidates: Sequence[int], free: np.ndarray) -> list[CandidateTest]:
        """Tests of these candidates with the given rows free: forces first, by decreasing gain."""
        without = max((model.evidence_with(free, self.variance) for model in self.models), default=-np.inf)
        tests = []
        for i in candidates:
            tested = self._test_one(i, free, without)
            if tested is not None:
                tests.append(tested)
        corrected = holm([one.test.p for one in tests])
        tests = [one._replace(test=replace(one.test, p=p)) for one, p in zip(tests, corrected, strict=True)]
        return sorted(tests, key=lambda one: (not one.test.free, -one.test.gain))

    def _test_one(self, i: int, free: np.ndarray, without: float) -> CandidateTest | None:
        """The test of a candidate at the gap weight that the evidence allows with it; None with too few blocks.

        Args:
            without: the best log evidence without the candidate.
        """
        candidate = self.candidates[i]
        also_free = np.append(free, self.row(i))
        evidence = [model.evidence_with(also_free, self.variance) for model in self.models]
        if not np.isfinite(max(evidence, default=-np.inf)):
            return None
        model = self.models[loosest_of(evidence)]
        moved, errors, degrees = one_step(model, also_free, self.variance)
        if degrees < FEWEST_DEGREES:
            return None
        degrees += NOISE_DEGREES
        change = moved[-1]
        error = errors[-1]
        t = change / error
        if candidate.only_grows:
            p = stdtr(degrees, -t)
        else:
            p = 2 * stdtr(degrees, -abs(t))
        own = moved[: len(self.free)]
        names = self.solution.problem.names
        moves = {names[j]: move for j, move in zip(self.free, own, strict=True)}
        off = np.abs(own)
        if candidate.coefficient is not None:  # a changing coefficient is off by its own spread
            off = np.where(self.free == candidate.coefficient, np.maximum(off, abs(change)), off)
        matters = bool(np.any(off > self._noticed(NOTICED_ERRORS)))
        gain = max(evidence) - without
        test = LawTest(candidate.name, candidate.free, change, error, t, p, moves, gain, matters)
        return CandidateTest(test, i, model)

    def _noticed(self, errors: float) -> np.ndarray:
        """Changes of the free parameters that exceed this number of their errors and a fraction of their values."""
        values = np.abs(self.solution.values[self.free])
        return np.maximum(errors * self.errors.std_error[self.free], NOTICED_SHARE * values)

    def _alike(self, shown: CandidateTest, tests: Sequence[CandidateTest], free: np.ndarray) -> tuple[str, ...]:
        """Names of other significant forces that the traces cannot distinguish from a significant one."""
        others = [one for one in tests if one is not shown and one.test.free and one.test.p < SIGNIFICANCE]
        rows = np.array([self.row(one.candidate) for one in (shown, *others)])
        remaining = eliminate_rows(shown.model.information, free, rows)
        size = np.sqrt(np.maximum(np.diag(remaining), 1e-300))
        correlations = np.abs(remaining[0, 1:]) / (size[0] * size[1:])
        names = []
        for one, correlation in zip(others, correlations, strict=True):
            if correlation > ALIKE_CORRELATION:
                names.append(one.test.name)
        return tuple(names)

    def _signs_of_upper_limit(self, tested: CandidateTest, free: np.ndarray) -> np.ndarray:
        """Signs of the free parameters' changes that matter, by the largest force that the traces do not exclude."""
        row = self.row(tested.candidate)
        information = tested.model.information
        slope = solve_spd(information[np.ix_(free, free)], information[free, row])[: len(self.free)]
        largest = max(tested.test.change, 0.0) + ndtri(EXCLUSION_PROBABILITY) * tested.test.error
        return np.sign(slope) * (np.abs(slope) * largest > self._noticed(INCLUDED_ERRORS))

    def _signs_of_duplicate(self, row: int) -> np.ndarray:
        """Signs of the free parameters that together act as a candidate does in separate windows."""
        size = self.separate[row, row]
        if not size > 0 or not len(self.free):
            return np.zeros(len(self.free))
        information = self.separate[np.ix_(self.free, self.free)]
        slope = solve_spd(information, self.separate[self.free, row])
        share = slope * np.sqrt(np.diag(information) / size)
        return np.sign(share) * (np.abs(share) > INCLUDED_SHARE)


def one_step(model: LinearModel, free: np.ndarray, variance: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Change of the free numbers by one step from the fit, its errors, and the blocks' degrees of freedom."""
    parts = model.parts
    information = model.information[np.ix_(free, free)]
    own = TimePieces(parts.gradient[:, free], parts.information[:, free][:, :, free], parts.run)
    moved = -solve_spd(information, own.gradient.sum(axis=0))
    # scores at the end of the step: its own effect is not scatter
    after = own._replace(gradient=own.gradient + own.information @ moved)
    length = block_length(after, information)
    count = len(after.run)
    blocks = [np.arange(i, min(i + length, count)) for i in range(0, count, length)]
    by_noise = variance * np.diag(solve_spd(information, np.eye(len(free))))
    by_scatter = np.diag(jackknife(after, blocks, information))
    degrees = len(blocks) - len(free)
    noise_share = NOISE_DEGREES / (NOISE_DEGREES + max(degrees, 0))
    pooled = noise_share * by_noise + (1 - noise_share) * by_scatter
    return moved, np.sqrt(np.maximum(pooled, by_noise)), degrees
