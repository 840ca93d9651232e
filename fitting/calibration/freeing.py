"""A fit whose candidates, the parameters that may cause a systematic error, are freed while the likelihood improves."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropper_jax.base.progress import Progress
from fitting.calibration.advice import score_candidates
from fitting.calibration.candidate import LEAST_GAIN, NAME_SEPARATOR, Candidate
from fitting.calibration.group_trials import WRONG_CHI_SQUARE, free_groups, is_model_wrong
from fitting.calibration.possible_faults import with_freed
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, StudentT
from fitting.estimate.simulator import Simulator
from fitting.estimate.solution import Solution
from fitting.estimate.whitening import log_volume
from fitting.windows.outliers import SEVERAL_OUTLIERS, count_outliers
from fitting.windows.prepared import Prepared

#: Maximum number of candidates that are freed one after another.
MOST_FREED = 6
#: Maximum number of candidates that are fitted before one of them is chosen.
MOST_FITTED = 4
#: Difference of log likelihoods below which candidates are indistinguishable.
INDISTINGUISHABLE_GAIN = 3.0
#: Fraction of the best candidate's gain that another one must promise to be tried as well.
PROMISING_SHARE = 0.3
#: A wrong candidate creeps: on the measured double pendulum a whole fit took 40 evaluations and explained nothing.
SHORT_FIT_ITERATIONS = 6


def promising(found: Sequence[Candidate], refused: Collection[str] = ()) -> list[Candidate]:
    """The candidates to try next, the best first: those that promise more than their parameters cost."""
    named = [c for c in found if c.worth_naming and c.worth > 0 and c.name not in refused]
    best = max((c.worth for c in named), default=0.0)
    return [c for c in named if c.worth > PROMISING_SHARE * best][:MOST_FITTED]


def likelihood(solution: Solution) -> float:
    """Log likelihood of separate windows, with the noise estimated by their fit, corrected for its memory."""
    return -(solution.cost + 0.5 * log_volume(solution.windows)) / solution.problem.memory


def _moves_back(prepared: Prepared, solution: Solution, mine: Sequence[str]) -> dict[str, float]:
    """Moves that return some parameters to their start values."""
    return {p.name: p.value - solution.by_name[p.name] for p in prepared.parameters if p.name in mine}


@dataclass
class Freeing:
    """A fit whose candidates are freed.

    Attributes:
        prepared: with all freed parameters.
        solution: its solution.
        loss: used for the fit.
        fit: an estimator: `fit(prepared, method, loss)`, with `frozen` parameters.
        simulator: knows the numbers of all candidates.
        freed: candidates that are free, in order.
        tested: score tests of the others.
        refused: names of candidates that were tried and do not help.
    """

    prepared: Prepared
    solution: Solution
    loss: Loss
    fit: Callable[..., Solution]
    simulator: Simulator
    progress: Progress
    freed: list[Candidate] = field(default_factory=list)
    tested: list[Candidate] = field(default_factory=list)
    refused: set[str] = field(default_factory=set)

    @property
    def end(self) -> Prepared:
        """The preparation, started from the end of its solution."""
        return self.prepared.starting_at(self.solution)

    @property
    def score(self) -> float:
        """Log likelihood minus the penalty for the number of parameters (Schwarz 1978)."""
        penalty = 0.5 * np.log(max(self.solution.windows.samples, 2))
        return likelihood(self.solution) - penalty * len(self.prepared.parameters)

    def is_wrong(self, limit: float = WRONG_CHI_SQUARE) -> bool:
        """Whether a smooth misfit far above the noise is left."""
        return is_model_wrong(self.prepared, self.solution, limit)

    def free_one_fault(self) -> bool:
        """Free one candidate of the score tests if it alone explains a misfit far above the noise."""
        self.progress(0.5, "testing what may be wrong, one by one")
        tries = []
        if self.solution.status == "ok":
            for candidate in promising(score_candidates(self.prepared, self.solution, self.simulator)):
                prepared = with_freed(self.end, candidate.free, self.simulator)
                problem = prepared.problem(self.loss)
                short = fit_windows(problem, prepared.values, prepared.starts, iterations=SHORT_FIT_ITERATIONS)
                if not is_model_wrong(prepared, short):
                    tries.append(candidate)
        trial = replace(self, freed=list(self.freed), refused=set())
        trial.free_best(tries)
        if not tries or trial.is_wrong():
            return False
        self.prepared = trial.prepared
        self.solution = trial.solution
        self.freed = trial.freed
        return True

    def accept(self, prepared: Prepared, solution: Solution, candidate: Candidate) -> None:
        """Continue from a fit with a candidate free."""
        self.prepared = prepared
        self.solution = solution
        self.freed.append(candidate)

    def free_groups(self, method: str) -> None:
        """Free whole groups by trials, with the simulator that knows their parameters."""
        found = free_groups(self.prepared, self.solution, self.loss, self.progress)
        if found is None:
            return
        self.prepared, self.simulator, names = found
        self.solution = fit_windows(self.prepared.problem(self.loss), self.prepared.values, self.prepared.starts)
        if method == "windows" or not self.is_wrong():  # else the other method's fit follows
            self.solution = self.fit(self.prepared, "windows", self.loss)
        self.freed += names

    def free_best(self, tries: Sequence[Candidate]) -> None:
        """Free the best of several candidates, by fitting them."""
        fits = []
        for candidate in tries:
            prepared = with_freed(self.end, candidate.free, self.simulator)
            trial = replace(self, prepared=prepared, solution=self.fit(prepared, "windows", self.loss))
            gain = likelihood(trial.solution) - likelihood(self.solution)
            if trial.solution.status == "ok" and gain >= LEAST_GAIN:
                fits.append((replace(candidate, gain=gain), trial))
            else:
                self.refused.add(candidate.name)
        if not fits:
            return
        most = max(trial.score for _, trial in fits)
        near = [pair for pair in fits if pair[1].score > most - INDISTINGUISHABLE_GAIN]
        # indistinguishable candidates keep their order
        near.sort(key=lambda pair: (len(pair[1].solution.values), -round(pair[1].score - self.score)))
        (candidate, best), *others = near
        if others:
            k = len(self.solution.values)
            names = best.prepared.names
            back = _moves_back(best.prepared, best.solution, names[k:])
            doubt = {}
            for other, trial in others:
                moved = trial.solution.values[:k] - best.solution.values[:k]
                doubt[other.name] = dict(zip(names[:k], moved.tolist(), strict=True)) | back
            candidate = replace(candidate, name=NAME_SEPARATOR.join(c.name for c, _ in near), doubt=doubt)
            self.refused.update(doubt)
        self.accept(best.prepared, best.solution, candidate)

    def free_outliers(self) -> None:
        """Student's loss if there are isolated outliers."""
        count = count_outliers(self.solution)
        if self.loss != LEAST_SQUARES or count < SEVERAL_OUTLIERS:
            return
        prepared = self.end
        solution = self.fit(prepared, "windows", StudentT())
        if solution.status == "ok":
            self.loss = StudentT()
            self.accept(prepared, solution, Candidate(f"outliers ({count} samples)", ("--student",), gain=float(count)))

    def reconsider(self, candidate: Candidate) -> Freeing:
        """The fit without one of several freed candidates, or with another one instead, if that is more likely.

        With two faults, the first candidate to be freed had to explain both.
        """
        mine = [name for name in self.prepared.names if name.startswith(candidate.free)]
        rest = [c for c in self.freed if c is not candidate]
        if not mine or candidate not in self.freed or not any(c.changes for c in rest):
            return self
        keep = [i for i, p in enumerate(self.prepared.parameters) if p.name not in mine]
        fewer = [self.prepared.parameters[i] for i in keep]
        prepared = self.end.with_parameters(fewer, self.solution.values[keep], self.simulator)
        solution = self.fit(prepared, "windows", self.loss)
        if solution.status != "ok":
            return self
        without = replace(self, prepared=prepared, solution=solution, freed=rest, tested=[], refused=set())
        if not without.score > self.score:
            found = score_candidates(prepared, solution, self.simulator)
            found = [c for c in found if c.worth_naming and c.name not in candidate.name]
            without.free_best(found[:MOST_FITTED])
        if without.score > self.score:
            without.refused = self.refused
            return without
        return self

    def continue_with(self, method: str) -> None:
        """Continue with another method, whose fits detect more."""
        self.prepared = self.end
        self.solution = self.fit(self.prepared, method, self.loss)
        while self.solution.status == "ok" and not self.is_wrong():
            self.progress(0.9, f"testing what may be wrong, {len(self.freed)} freed")
            self.tested = score_candidates(self.prepared, self.solution, self.simulator)
            named = [c for c in self.tested if c.worth_naming]
            best = next((c for c in named if c.name not in self.refused), None)
            if best is None or len(self.freed) >= MOST_FREED:
                break
            prepared = with_freed(self.end, best.free, self.simulator)
            solution = self.fit(prepared, method, self.loss)
            if solution.status != "ok":
                self.refused.add(best.name)
                continue
            back = _moves_back(prepared, solution, list(best.changes))
            doubt = {}
            for c in named:
                if c is not best and (c.name in best.alike or 0 <= best.worth - c.worth < INDISTINGUISHABLE_GAIN):
                    doubt[c.name] = {p: c.moves.get(p, 0.0) - move for p, move in best.moves.items()} | back
            self.accept(prepared, solution, replace(best, doubt=doubt))
