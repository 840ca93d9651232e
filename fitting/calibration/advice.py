"""Score tests of numbers that were assumed known: which of them cause a systematic error of the fit.

A candidate is tested at the end of the fit (`joint_information`): lengths, positions of fixed points, the camera's
roll, a marker, the clock, inertias. One more program is compiled; nothing is fitted again. Candidates with different
numbers of parameters are compared by their gain minus `log(N)/2` per parameter (Schwarz 1978). Holm's correction
accounts for the number of candidates. A candidate that the traces cannot distinguish from the free parameters is not
tested, which the report states. Example: the clock and a free inertia, for one link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.calibration.candidate import Candidate
from fitting.calibration.joint_information import JointInformation, ScoreChange, joint_information
from fitting.calibration.possible_faults import candidate_simulator, possible_faults
from fitting.calibration.result import FitResult
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.laws.law_tests import holm
from fitting.parameters.parameter import Parameter
from fitting.windows.prepared import Prepared


def advise(result: FitResult) -> list[Candidate]:
    """What else may be wrong, by score tests at the end of a fit: candidates in order of decreasing worth."""
    if result.tested or result.solution.status != "ok":
        return result.tested
    return score_candidates(result.prepared, result.solution)


def score_candidates(prepared: Prepared, solution: Solution, simulator: Simulator | None = None) -> list[Candidate]:
    """Candidates in order of decreasing worth; `simulator` must know their numbers."""
    problem = solution.problem
    candidates = untested_candidates(prepared, problem.parameters)
    numbers = [p for one in candidates for p in one.parameters]
    information = joint_information(prepared, solution, simulator or candidate_simulator(prepared), numbers)
    free = solution.free
    tested = []
    undistinguished = []
    for one in candidates:
        change = information.score_change(free, one.rows)
        if change is None:
            undistinguished.append(Candidate(one.name, one.paths, p=1.0))
        else:
            tested.append((one, change))
    penalty = 0.5 * np.log(max(solution.windows.samples / problem.memory, 2.0))
    names = [problem.names[i] for i in free]
    # indistinguishable candidates keep the order of their probabilities
    tested.sort(key=lambda pair: pair[1].p)
    found = []
    for (one, change), p in zip(tested, holm([change.p for _, change in tested]), strict=True):
        candidate = _as_candidate(one, change, names)
        candidate = replace(candidate, p=p, worth=change.gain - penalty * len(one.rows))
        if candidate.worth_naming:
            candidate = replace(candidate, alike=_names_alike(one, candidates, information, free))
        found.append(candidate)
    return sorted(found, key=lambda candidate: -round(candidate.worth, 1)) + undistinguished


def _names_alike(
    one: UntestedCandidate, candidates: Sequence[UntestedCandidate], information: JointInformation, free: np.ndarray
) -> tuple[str, ...]:
    """Names of candidates of as many numbers that carry no information once this one is free too."""
    also_free = np.concatenate([free, one.rows])
    names = []
    for other in candidates:
        same_size = other is not one and len(other.rows) == len(one.rows)
        if same_size and information.score_change(also_free, other.rows) is None:
            names.append(other.name)
    return tuple(names)


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


def untested_candidates(prepared: Prepared, parameters: Sequence[Parameter]) -> list[UntestedCandidate]:
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
