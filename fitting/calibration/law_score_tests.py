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

The candidate of largest gain is freed in this model, and the others are tested again, as long as one is shown: a force
that seems to be missing only because another one is missing is not.

For laws outside the list, the coefficients of drag must not change with time or amplitude: a candidate whose derivative
in each window is that of the coefficient, multiplied by the window's mean time or RMS rate. They are candidates of the
same family, but are freed only once no force is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.special import ndtri, stdtr

from fitting.calibration.law_fits import DRAG, PARTS
from fitting.calibration.law_tests import LEVEL, SHARE, LawTest, LawTests, holm
from fitting.calibration.prepared import Prepared
from fitting.estimate.blocks import Pieces, block_of, jackknife, pieces
from fitting.estimate.factors import eliminate_rows, solve_spd
from fitting.estimate.least_squares import level_of
from fitting.estimate.normal_equations import Evaluation, Prior, eliminate, move_along
from fitting.estimate.residuals import Residuals, Solution
from fitting.estimate.shooting import SCHEDULE, loosest_of
from fitting.estimate.uncertainty import Uncertainty
from fitting.parameters.missing_forces import tested_parameters
from fitting.parameters.parameter import Parameter, given_effect
from fitting.parameters.targets import CAMERA

#: Change of a reported value by the candidate that matters, in its standard errors; also at least `SHARE` of the value.
ERRORS = 2.0
#: Correlation of two candidates above which they are one.
ALIKE = 0.98
#: Fraction of a candidate's information, in separate windows, that must remain once the free parameters are accounted
#: for. Any force moves tightly joined windows of a chaotic motion along one direction: 1e-5 remains there, and decides.
REMAINS = 1e-4
#: Change of a value, in its standard errors, by a force that is not shown and not excluded, from which the value
#: includes the force: a correlation of 0.98 hides this much. Probability that the force is below its upper limit.
HIDDEN = 5.0
EXCLUDED = 0.95
#: Fraction of a force's effect from which a parameter that acts like it includes it.
PART = 0.2
#: Degrees of freedom below which nothing is tested.
FEWEST = 3
#: Degrees of freedom of the variance that the noise predicts.
NOISE_DEGREES = 10
#: Maximum number of candidates that are freed in the linear model, one after another.
MOST = 3
#: What the coefficients of drag are tested to change with.
ALONG = ("time", "amplitude")


@dataclass(frozen=True)
class Suspect:
    """A force or a change that a scene may lack.

    Attributes:
        name: in words.
        free: paths that free it; empty if no number of a scene does.
        parameter: its size.
        grows: whether it can only grow from zero.
        of: for a change of a coefficient, the number of the coefficient among the free parameters.
        along: what it changes with, one of `ALONG`.
    """

    name: str
    free: tuple[str, ...]
    parameter: Parameter
    grows: bool = False
    of: int | None = None
    along: str = ""


QUADRATIC = "quadratic drag"
#: Names of the forces and the paths that free them, by their kind in `missing_forces`.
FORCES = {
    "linear": ("linear drag", PARTS["linear"]),
    "quadratic": (QUADRATIC, PARTS["quadratic"]),
    "viscous": ("viscous friction in the joints", PARTS["joint viscous"]),
    "dry": ("dry friction in the joints", PARTS["dry"]),
    "springs": ("springs in the joints", "effects.bending.EI"),
    "added_mass": ("added mass, or another gravity or clock", "clock.rate"),
}


def test_laws(prepared: Prepared, solution: Solution, u: Uncertainty) -> LawTests:
    """Test every candidate at the end of a fit with these errors."""
    problem = solution.problem
    suspects = _suspects(prepared, problem)
    simulated = [s.parameter for s in suspects if s.of is None]
    if not problem.simulator.knows(simulated):
        return LawTests()
    every = (*problem.parameters, *simulated)
    extended = replace(problem, simulator=problem.simulator.view_of(every), parameters=every, frozen=None)
    values = np.concatenate([solution.values, np.zeros(len(simulated))])
    evaluation = extended.evaluate(values, solution.starts)
    if not np.isfinite(evaluation.jacobian).all():
        return LawTests()
    evaluation = _with_changes(solution, evaluation, [s for s in suspects if s.of is not None])
    scale = u.noise**2 * problem.memory
    own = problem.prior(solution.values)  # without knowledge of the candidates
    more = evaluation.jacobian.shape[-1] - problem.freedoms - len(solution.values)
    prior = Prior(own.cost, np.pad(own.gradient, (0, more)), np.pad(own.curvature, (0, more)))
    no_change = np.zeros(len(prior.gradient))
    system = level_of(problem, None).system(evaluation, solution.values)
    separate = eliminate(system, 0.0, prior, no_change, no_change).information
    levels = _levels(solution, evaluation, prior, scale)
    free = np.flatnonzero(~problem.held_mask & ~u.at_bound)
    return ScoreTests(solution, u, suspects, levels, separate, free, scale).run()


def _suspects(prepared: Prepared, problem: Residuals) -> list[Suspect]:
    """Candidates that are not free, and changes of the free coefficients of drag, in the order of the derivatives."""
    free = list(compress(problem.names, ~problem.held_mask))
    suspects = []
    for p in tested_parameters(prepared.simulator.model, problem.parameters):
        name, path = FORCES.get(p.where.field, ("a roll of the camera", CAMERA))
        if any(free_name.startswith(path) for free_name in free):
            continue
        lacks = path.startswith("effects.") and not np.any(given_effect(prepared.scene, path))
        suspects.append(Suspect(name, (path,), p, grows=lacks))
    for i, p in enumerate(problem.parameters):
        if p.name in DRAG and p.name in free:
            short = p.name.rsplit(".", 1)[1]
            for along in ALONG:
                suspects.append(Suspect(f"a {short} that changes with {along}", (), p, of=i, along=along))
    return suspects


def _with_changes(solution: Solution, evaluation: Evaluation, changes: Sequence[Suspect]) -> Evaluation:
    """The evaluation with derivatives by changes of coefficients, in units of their spread over the windows."""
    windows = solution.windows
    m2 = solution.problem.freedoms
    series = {"time": 0.5 * (windows.begin + windows.ends), "amplitude": _rates(solution)}
    for suspect in changes:
        along = series[suspect.along]
        factor = (along - along.mean()) / max(float(np.std(along)), 1e-300)
        for name in ("jacobian", "start_jacobian", "end_jacobian"):
            old = getattr(evaluation, name)
            column = old[..., m2 + suspect.of] * factor.reshape(-1, *[1] * (old.ndim - 2))
            evaluation = evaluation._replace(**{name: np.concatenate([old, column[..., None]], axis=-1)})
    return evaluation


def _rates(solution: Solution) -> np.ndarray:
    """RMS rate of the links (K,) over every window [rad/s], from both its ends."""
    ends = np.stack([solution.evaluation.start, solution.evaluation.end], axis=1)
    rates = ends[..., ends.shape[-1] // 2 :]
    return np.sqrt(np.mean(rates**2, axis=(1, 2)))


class Level(NamedTuple):
    """The linear model of a fit's end at one gap weight, with the starts of the windows at their optimum.

    Attributes:
        information, gradient: by all parameters and candidates.
        evidence: of the weight, before a move of the parameters.
        parts: gradients and information of pieces of time.
    """

    information: np.ndarray
    gradient: np.ndarray
    evidence: float
    parts: Pieces

    def evidence_with(self, chosen: np.ndarray, scale: float) -> float:
        """Log evidence of the weight with these parameters and candidates free; minus infinity if they are undetermined
        within rounding."""
        gradient = self.gradient[chosen]
        try:
            step = solve_spd(self.information[np.ix_(chosen, chosen)], gradient)
        except LinAlgError:
            return -np.inf
        return self.evidence + 0.5 * float(gradient @ step) / scale


def _levels(solution: Solution, evaluation: Evaluation, prior: Prior, scale: float) -> list[Level]:
    """The linear model at the gap weight of the fit and at all tighter ones."""
    every = np.arange(len(prior.gradient))
    no_change = np.zeros(len(every))
    weights = [solution.gap_weight]
    if solution.gap_weight:
        weights += [weight for weight in SCHEDULE if weight < solution.gap_weight]
    levels = []
    for weight in weights:
        level = level_of(solution.problem, weight)
        try:
            step = eliminate(level.system(evaluation, solution.values), 0.0, prior, no_change, no_change)
        except LinAlgError:  # tight joins of a chaotic motion exhaust the digits
            break
        gain = step.predicted - level.cost(evaluation, solution.values)
        moved = move_along(evaluation, step.dz)
        at_weight = replace(solution, evaluation=moved, eliminated=step.eliminated, gap_weight=weight)
        evidence = gain / scale - level.log_volume(step)
        levels.append(Level(step.information, step.gradient, evidence, pieces(at_weight, every)))
    return levels


class SuspectTest(NamedTuple):
    """A test with the number of its suspect and the level at which it was made."""

    test: LawTest
    suspect: int
    level: Level


@dataclass(frozen=True)
class ScoreTests:
    """The tests of all suspects of one fit.

    Attributes:
        levels: linear models at several gap weights.
        separate: information of separate windows, by all parameters and suspects.
        free: numbers of the free parameters that are not at a bound.
        scale: variance of the noise and its memory.
    """

    solution: Solution
    u: Uncertainty
    suspects: Sequence[Suspect]
    levels: Sequence[Level]
    separate: np.ndarray
    free: np.ndarray
    scale: float

    def run(self) -> LawTests:
        """The tests of all suspects; the force of largest gain is freed as long as one is shown."""
        candidates = len(self.solution.values) + np.arange(len(self.suspects))
        remaining = np.diag(eliminate_rows(self.separate, self.free, candidates))
        own_fraction = remaining / np.maximum(np.diag(self.separate)[candidates], 1e-300)
        hidden: list[tuple[str, np.ndarray]] = []
        untested = []
        for i, suspect in enumerate(self.suspects):
            if own_fraction[i] > REMAINS:
                untested.append(i)
            elif suspect.grows:
                hidden.append((suspect.name, self._likeness(candidates[i])))
        shown: list[LawTest] = []
        given = self.free
        while True:
            tests = self.test(untested, given)
            first = next((one for one in tests if one.test.p < LEVEL), None)
            if first is None or len(shown) == MOST:
                break
            shown.append(replace(first.test, alike=self.alike(first, tests, given)))
            given = np.append(given, candidates[first.suspect])
            untested.remove(first.suspect)
        for one in tests:
            if self.suspects[one.suspect].grows:
                hidden.append((one.test.name, self._hiding(one, given)))
        others = (one.test for one in tests)
        return LawTests((*shown, *others), self._by_parameter(hidden, 1), self._by_parameter(hidden, -1))

    def _by_parameter(self, hidden: Sequence[tuple[str, np.ndarray]], sign: int) -> dict[str, tuple[str, ...]]:
        """Names of forces by the free parameters that change with this sign; `hidden`: their names and all signs."""
        forces: dict[str, tuple[str, ...]] = {}
        for force, signs in hidden:
            for j in np.flatnonzero(signs == sign):
                parameter = self.solution.problem.names[self.free[j]]
                forces[parameter] = (*forces.get(parameter, ()), force)
        return forces

    def test(self, suspects: Sequence[int], given: np.ndarray) -> list[SuspectTest]:
        """Tests of these suspects with the given parameters and candidates free: forces first, by decreasing gain."""
        without = max((level.evidence_with(given, self.scale) for level in self.levels), default=-np.inf)
        tests = []
        for i in suspects:
            found = self._test_one(i, given, without)
            if found is not None:
                tests.append(found)
        over_family = holm([one.test.p for one in tests])
        tests = [one._replace(test=replace(one.test, p=p)) for one, p in zip(tests, over_family, strict=True)]
        return sorted(tests, key=lambda one: (not one.test.free, -one.test.gain))

    def _test_one(self, i: int, given: np.ndarray, without: float) -> SuspectTest | None:
        """The test of a suspect at the gap weight that the evidence allows with it; None with too few blocks.

        Args:
            without: the best log evidence without the suspect.
        """
        suspect = self.suspects[i]
        chosen = np.append(given, len(self.solution.values) + i)
        evidence = [level.evidence_with(chosen, self.scale) for level in self.levels]
        if not np.isfinite(max(evidence, default=-np.inf)):
            return None
        level = self.levels[loosest_of(evidence)]
        moved, errors, degrees = _one_step(level, chosen, self.scale)
        if degrees < FEWEST:
            return None
        degrees += NOISE_DEGREES
        change = float(moved[-1])
        error = float(errors[-1])
        t = change / error
        if suspect.grows:
            p = float(stdtr(degrees, -t))
        else:
            p = 2 * float(stdtr(degrees, -abs(t)))
        own = moved[: len(self.free)]
        names = self.solution.problem.names
        moves = {names[j]: float(move) for j, move in zip(self.free, own, strict=True)}
        off = np.abs(own)
        if suspect.of is not None:  # a changing coefficient is off by its own spread
            off = np.where(self.free == suspect.of, np.maximum(off, abs(change)), off)
        matters = bool(np.any(off > self._noticed(ERRORS)))
        gain = max(evidence) - without
        return SuspectTest(LawTest(suspect.name, suspect.free, change, error, t, p, moves, gain, matters), i, level)

    def _noticed(self, errors: float) -> np.ndarray:
        """Changes of the free parameters that exceed this number of their errors and a fraction of them."""
        values = np.abs(self.solution.values[self.free])
        return np.maximum(errors * self.u.std_error[self.free], SHARE * values)

    def alike(self, shown: SuspectTest, tests: Sequence[SuspectTest], given: np.ndarray) -> tuple[str, ...]:
        """Names of other forces that are shown and that the traces cannot distinguish from one."""
        others = [one for one in tests if one is not shown and one.test.free and one.test.p < LEVEL]
        numbers = len(self.solution.values) + np.array([shown.suspect, *(one.suspect for one in others)])
        remaining = eliminate_rows(shown.level.information, given, numbers)
        size = np.sqrt(np.maximum(np.diag(remaining), 1e-300))
        correlation = np.abs(remaining[0, 1:]) / (size[0] * size[1:])
        return tuple(one.test.name for one, value in zip(others, correlation, strict=True) if value > ALIKE)

    def _hiding(self, tested: SuspectTest, given: np.ndarray) -> np.ndarray:
        """Signs of the changes of the free parameters that matter, by a force as large as the traces do not exclude."""
        mine = len(self.solution.values) + tested.suspect
        information = tested.level.information
        slope = solve_spd(information[np.ix_(given, given)], information[given, mine])[: len(self.free)]
        largest = max(tested.test.change, 0.0) + float(ndtri(EXCLUDED)) * tested.test.error
        return np.sign(slope) * (np.abs(slope) * largest > self._noticed(HIDDEN))

    def _likeness(self, mine: int) -> np.ndarray:
        """Signs of the free parameters that together act as a candidate does in separate windows."""
        size = self.separate[mine, mine]
        if not size > 0 or not len(self.free):
            return np.zeros(len(self.free))
        free = self.separate[np.ix_(self.free, self.free)]
        slope = solve_spd(free, self.separate[self.free, mine])
        part = slope * np.sqrt(np.diag(free) / size)
        return np.sign(part) * (np.abs(part) > PART)


def _one_step(level: Level, chosen: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Change of the chosen parameters by one step from the fit, its errors, and the blocks' degrees of freedom."""
    parts = level.parts
    information = level.information[np.ix_(chosen, chosen)]
    mine = Pieces(parts.gradient[:, chosen], parts.information[:, chosen][:, :, chosen], parts.run)
    moved = -solve_spd(information, mine.gradient.sum(axis=0))
    # scores at the end of the step: its own effect is not scatter
    after = mine._replace(gradient=mine.gradient + mine.information @ moved)
    length = block_of(after, information)
    count = len(after.run)
    blocks = [np.arange(i, min(i + length, count)) for i in range(0, count, length)]
    by_noise = scale * np.diag(solve_spd(information, np.eye(len(chosen))))
    scatter = jackknife(after, blocks, information)
    degrees = len(blocks) - len(chosen)
    share = NOISE_DEGREES / (NOISE_DEGREES + max(degrees, 0))
    variance = share * by_noise + (1 - share) * np.diag(scatter)
    return moved, np.sqrt(np.maximum(variance, by_noise)), degrees
