"""Score tests of numbers that were assumed known: which of them cause a systematic error of the fit.

A candidate c is tested at the end of the fit: lengths, positions of fixed points, the camera's roll, a marker, the
clock, inertias. Let f be the free numbers and S the information of all numbers together. Let g be the gradient, with
the starts of the windows eliminated; both include the gaps of joined windows, priors and poses at rest. Freeing c would
change its numbers by d and raise the log likelihood, to first order, by

    d = -A^-1 u,    gain = u' A^-1 u / 2,    A = S_cc - S_cf S_ff^-1 S_fc,    u = g_c - S_cf S_ff^-1 g_f

in units of the noise that the fit estimated, including its memory (Rao 1948). One more program is compiled; nothing is
fitted again. Candidates with different numbers of parameters are compared by their gain minus `log(N)/2` per parameter
(Schwarz 1978). Holm's correction accounts for the number of candidates. A candidate that the traces cannot distinguish
from the free parameters is not tested, which the report states. Example: the clock and a free inertia, for one link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from fitting.calibration.candidate import Candidate
from fitting.calibration.law_tests import holm
from fitting.calibration.possible_faults import candidate_simulator, possible_faults
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult
from fitting.estimate.factors import invert_spd, solve_spd
from fitting.estimate.normal_equations import eliminate, prior_of
from fitting.estimate.objective import objective_at
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator
from fitting.parameters.parameter import Parameter
from fitting.parameters.rig_priors import rig_priors


def advise(result: FitResult) -> list[Candidate]:
    """What else may be wrong, by score tests at the end of a fit: candidates in order of decreasing worth."""
    if result.tested or result.solution.status != "ok":
        return result.tested
    return score_candidates(result.prepared, result.solution)


def score_candidates(prepared: Prepared, solution: Solution, simulator: Simulator | None = None) -> list[Candidate]:
    """Candidates in order of decreasing worth; `simulator` must know their numbers."""
    problem = solution.problem
    asked = _not_free(prepared, problem.parameters)
    more = [p for one in asked for p in one.parameters]
    information = joint_information(prepared, solution, simulator or candidate_simulator(prepared), more)
    free = solution.free
    tested = []
    undistinguished = []
    for one in asked:
        change = information.score_change(free, one.rows)
        if change is None:
            undistinguished.append(Candidate(one.name, one.paths, p=1.0))
        else:
            tested.append((one, change))
    penalty = 0.5 * np.log(max(solution.windows.samples / problem.memory, 2.0))
    names = [problem.names[i] for i in free]
    # indistinguishable candidates keep the order of their probabilities
    tested.sort(key=lambda pair: pair[1].p)
    rows = []
    for (one, change), p in zip(tested, holm([change.p for _, change in tested]), strict=True):
        row = _as_candidate(one, change, names)
        row = replace(row, p=p, worth=change.gain - penalty * len(one.rows))
        if row.worth_naming:
            also_free = np.concatenate([free, one.rows])
            alike = []
            for other in asked:
                same_size = other is not one and len(other.rows) == len(one.rows)
                if same_size and information.score_change(also_free, other.rows) is None:
                    alike.append(other.name)
            row = replace(row, alike=tuple(alike))
        rows.append(row)
    return sorted(rows, key=lambda row: -round(row.worth, 1)) + undistinguished


def _as_candidate(one: UntestedCandidate, change: ScoreChange, names: Sequence[str]) -> Candidate:
    """A candidate with its changes; `names` are those of the free parameters that it moves."""
    own = [p.name for p in one.parameters]
    changes = dict(zip(own, change.change.tolist(), strict=True))
    errors = dict(zip(own, change.error.tolist(), strict=True))
    moves = dict(zip(names, change.moves.tolist(), strict=True)) | changes
    return Candidate(one.name, one.paths, changes, errors, change.gain, moves=moves)


@dataclass(frozen=True)
class UntestedCandidate:
    """A candidate to be tested: its name, the paths that free it, its numbers, and their rows in the information."""

    name: str
    paths: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    rows: np.ndarray


def _not_free(prepared: Prepared, parameters: Sequence[Parameter]) -> list[UntestedCandidate]:
    """The candidates whose numbers are not free yet; their rows follow those of the free parameters."""
    free = {p.name for p in parameters}
    found: list[UntestedCandidate] = []
    end = len(parameters)
    for label, paths, every in possible_faults(prepared.simulator.model, prepared.simulator.release):
        more = tuple(p for p in every if p.name not in free)
        if not more or any(f"{name}.".startswith(f"{path}.") for name in free for path in paths):
            continue
        found.append(UntestedCandidate(label, tuple(paths), more, np.arange(end, end + len(more))))
        end += len(more)
    return found


class ScoreChange(NamedTuple):
    """First-order changes of a candidate's numbers, their errors, moves of free parameters, gain and probability."""

    change: np.ndarray
    error: np.ndarray
    moves: np.ndarray
    gain: float
    p: float


#: Fraction of a candidate's information that must remain once the free parameters are accounted for.
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
