"""Freeing the parameters that cause a systematic error, one candidate at a time, while the log likelihood improves.

The first round is over separate windows, which remain solvable for any misfit. Isolated outliers switch on Student's
loss, and missing frames free a jump of the clock. Candidates from the score tests (`advice`) are tried. If several are
promising, each is fitted and their likelihoods decide, each with the noise that it leaves, minus `log(N)/2` per number.
Candidates within `MARGIN` of the best cannot be distinguished. They are reported together and the one with fewest
numbers is freed. The distance by which the others would move the estimates is added to the errors. The second round
uses the requested method, whose joined windows detect smaller faults, with score tests alone.

If the misfit is smooth, far above the noise, and not explained by any single candidate, the whole model is wrong. No
sample is then an outlier, and groups of numbers are freed by `trials`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dropper_jax.base.errors import Progress, silent
from fitting.calibration.advice import score_candidates, wide
from fitting.calibration.candidate import OR, WORTH, Candidate
from fitting.calibration.kicks import Fit
from fitting.calibration.lost_frames import SEVERAL, alone, far_off, lost_frames, starts_from_previous_windows
from fitting.calibration.preparation import Prepared, at_frames
from fitting.calibration.trials import free_groups, is_model_wrong
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import LEAST_SQUARES, Loss, StudentT
from fitting.estimate.noise import log_volume
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator
from fitting.estimate.windows import pick
from fitting.parameters.parameter import resolve
from fitting.parameters.targets import LOST

#: Maximum number of candidates freed one after another, and how many of them are fitted before one is chosen.
MOST_FREED = 6
TRIED = 4
#: Difference of log likelihoods below which candidates are indistinguishable.
MARGIN = 3.0
#: Log of the number of jumps searched, which one gains by chance; minimum size of a jump in frames, below which the
#: misfit is of another kind.
CHANCE = 9.0
LEAST_LOST = 0.7


@dataclass
class Freed:
    """State at the end of freeing.

    Attributes:
        prepared: with all freed parameters.
        solution: its solution.
        loss: used for the fit.
        names: freed candidates, in order.
        found: results of the score tests for the rest.
    """

    prepared: Prepared
    solution: Solution
    loss: Loss
    names: list[Candidate] = field(default_factory=list)
    found: list[Candidate] = field(default_factory=list)

    @property
    def end(self) -> Prepared:
        """The preparation, started from the end of its solution."""
        return self.prepared.starting_at(self.solution)


def with_freed(prepared: Prepared, paths: Sequence[str], simulator: Simulator, value: float | None = None) -> Prepared:
    """The preparation with more free parameters."""
    old = {p.name for p in prepared.parameters}
    more = resolve(prepared.simulator.model, paths, release=prepared.simulator.release)
    more = [p for p in at_frames(more, prepared.traces) if p.name not in old]
    begin = np.concatenate([prepared.values, [p.value if value is None else value for p in more]])
    return prepared.with_parameters([*prepared.parameters, *more], begin, simulator)


#: One candidate may explain the poses at rest at the expense of the motion, so that no second one converges with it.
#: Correlated noise leaves a chi-square of up to 10.
REST_CHI_SQUARE = 20.0


def free_by_advice(
    prepared: Prepared,
    fit: Fit,
    method: str,
    loss: Loss = LEAST_SQUARES,
    simulator: Simulator | None = None,
    progress: Progress = silent,
) -> Freed:
    """The fit with all beneficial candidates freed.

    Args:
        fit: an estimator.
        method: used for the last fits.
        simulator: must know the numbers of all candidates, such as that of an earlier call on the same scene.
    """
    simulator = simulator or wide(prepared)
    at = Freed(prepared, fit(prepared := with_freed(prepared, [], simulator), "windows", loss), loss)
    at.prepared = prepared
    _jumps(at, fit, simulator)
    if is_model_wrong(at.prepared, at.solution) and not _one_fault(at, fit, simulator, progress):
        simulator = _groups(at, fit, simulator, method, progress)
    wrong = is_model_wrong(at.prepared, at.solution)
    first = len(at.names)
    if not wrong:
        _outliers(at, fit)
    begin = replace(at, names=list(at.names))
    refused: set[str] = set()
    while not wrong and at.solution.status == "ok" and len(at.names) - first < MOST_FREED:
        progress(0.5, f"testing what may be wrong, {len(at.names)} freed")
        at.found = score_candidates(at.prepared, at.solution, simulator)
        tries = promising(at.found, refused)
        if not tries:
            break
        _choose(at, fit, simulator, tries, refused)
        _outliers(at, fit)
    if not wrong and is_model_wrong(at.prepared, at.solution, REST_CHI_SQUARE):
        simulator = _groups(begin, fit, simulator, method, progress)
        if len(begin.names) > first:
            at = begin
    for candidate in at.names[len(begin.names) :]:
        at = _reconsider(at, candidate, fit, simulator)
    if method == "windows":
        return at
    return _continue_with(at, fit, simulator, method, refused, progress)


#: Fraction of the best candidate's gain that another one must promise to be tried as well.
WORTH_TRYING = 0.3


def promising(found: Sequence[Candidate], refused: Collection[str] = ()) -> list[Candidate]:
    """The candidates to try next, the best first: those that promise more than their parameters cost."""
    named = [c for c in found if c.worth_naming and c.worth > 0 and c.name not in refused]
    best = max((c.worth for c in named), default=0.0)
    return [c for c in named if c.worth > WORTH_TRYING * best][:TRIED]


def _one_fault(at: Freed, fit: Fit, simulator: Simulator, progress: Progress) -> bool:
    """Free one candidate of the score tests if it alone explains a misfit far above the noise."""
    progress(0.5, "testing what may be wrong, one by one")
    if at.solution.status == "ok":
        tries = promising(score_candidates(at.prepared, at.solution, simulator))
    else:
        tries = []
    tries = [candidate for candidate in tries if _explains(at, candidate, simulator)]
    one = replace(at, names=list(at.names))
    _choose(one, fit, simulator, tries, set())
    if not tries or is_model_wrong(one.prepared, one.solution):
        return False
    at.prepared, at.solution, at.names = one.prepared, one.solution, one.names
    return True


#: A wrong candidate creeps: on the measured double pendulum a whole fit took 40 evaluations and explained nothing.
SHORT_FIT = 6


def _explains(at: Freed, candidate: Candidate, simulator: Simulator) -> bool:
    """Whether a short fit with one candidate free leaves no misfit far above the noise."""
    prepared = with_freed(at.end, candidate.free, simulator)
    short = fit_windows(prepared.problem(at.loss), prepared.values, prepared.starts, iterations=SHORT_FIT)
    return not is_model_wrong(prepared, short)


def _groups(at: Freed, fit: Fit, simulator: Simulator, method: str, progress: Progress) -> Simulator:
    """Free whole groups by trials; returns the simulator that knows their parameters."""
    found = free_groups(at.prepared, at.solution, at.loss, progress)
    if found is None:
        return simulator
    at.prepared, simulator, names = found
    at.solution = fit_windows(at.prepared.problem(at.loss), at.prepared.values, at.prepared.starts)
    if method == "windows" or not is_model_wrong(at.prepared, at.solution):  # else the other method's fit follows
        at.solution = fit(at.prepared, "windows", at.loss)
    at.names += names
    return simulator


def _reconsider(at: Freed, candidate: Candidate, fit: Fit, simulator: Simulator) -> Freed:
    """The fit without one of several freed candidates, or with another one instead, if that is more likely.

    With two faults, the first candidate to be freed had to explain both.
    """
    mine = [p.name for p in at.prepared.parameters if p.name.startswith(candidate.free)]
    rest = [c for c in at.names if c is not candidate]
    if not mine or candidate not in at.names or not any(c.changes for c in rest):
        return at
    keep = [i for i, p in enumerate(at.prepared.parameters) if p.name not in mine]
    fewer = [at.prepared.parameters[i] for i in keep]
    prepared = at.end.with_parameters(fewer, at.solution.values[keep], simulator)
    without = Freed(prepared, fit(prepared, "windows", at.loss), at.loss, rest)
    if without.solution.status != "ok":
        return at
    if _score(without) > _score(at):
        return without
    found = score_candidates(prepared, without.solution, simulator)
    found = [c for c in found if c.worth_naming and c.name not in candidate.name]
    _choose(without, fit, simulator, found[:TRIED], set())
    if _score(without) > _score(at):
        return without
    return at


def _score(at: Freed) -> float:
    """Log likelihood minus the penalty for the number of parameters (Schwarz 1978)."""
    return likelihood(at.solution) - 0.5 * np.log(max(at.solution.windows.samples, 2)) * len(at.prepared.parameters)


def _continue_with(
    at: Freed, fit: Fit, simulator: Simulator, method: str, refused: set[str], progress: Progress
) -> Freed:
    """Continue with another method, whose fits detect more."""
    at = replace(at, prepared=at.end, solution=fit(at.end, method, at.loss))
    while at.solution.status == "ok" and not is_model_wrong(at.prepared, at.solution):
        progress(0.9, f"testing what may be wrong, {len(at.names)} freed")
        at.found = score_candidates(at.prepared, at.solution, simulator)
        best = next((c for c in at.found if c.worth_naming and c.name not in refused), None)
        if best is None or len(at.names) >= MOST_FREED:
            break
        prepared = with_freed(at.end, best.free, simulator)
        solution = fit(prepared, method, at.loss)
        if solution.status != "ok":
            refused.add(best.name)
            continue
        near = [c for c in at.found if c.worth_naming and (c.name in best.alike or 0 <= best.worth - c.worth < MARGIN)]
        back = _back(prepared, solution, list(best.changes))
        doubt = {}
        for c in near:
            if c is not best:
                doubt[c.name] = {p: c.moves.get(p, 0.0) - move for p, move in best.moves.items()} | back
        best = replace(best, doubt=doubt)
        at = replace(at, prepared=prepared, solution=solution, names=[*at.names, best])
    return at


def _back(prepared: Prepared, solution: Solution, mine: Sequence[str]) -> dict[str, float]:
    """Moves that return some parameters to their start values."""
    return {p.name: p.value - solution.by_name[p.name] for p in prepared.parameters if p.name in mine}


def likelihood(solution: Solution) -> float:
    """Log likelihood of separate windows, with the noise estimated by their fit, corrected for its memory."""
    return -(solution.cost + 0.5 * log_volume(solution.windows)) / solution.problem.memory


def _choose(at: Freed, fit: Fit, simulator: Simulator, tries: Sequence[Candidate], refused: set[str]) -> None:
    """Free the best of several candidates, by fitting them."""
    price = 0.5 * np.log(max(at.solution.windows.samples, 2))
    before = likelihood(at.solution)
    fits = []
    for candidate in tries:
        prepared = with_freed(at.end, candidate.free, simulator)
        solution = fit(prepared, "windows", at.loss)
        gain = likelihood(solution) - before
        numbers = len(prepared.parameters) - len(at.prepared.parameters)
        if solution.status == "ok" and gain >= WORTH:
            fits.append((gain - price * numbers, numbers, replace(candidate, gain=gain), prepared, solution))
        else:
            refused.add(candidate.name)
    if not fits:
        return
    most = max(row[0] for row in fits)
    # indistinguishable candidates keep their order
    near = sorted((row for row in fits if row[0] > most - MARGIN), key=lambda row: (row[1], -round(row[0])))
    _, _, candidate, at.prepared, at.solution = near[0]
    if len(near) > 1:
        k = len(at.solution.values) - near[0][1]
        names = [p.name for p in at.prepared.parameters]
        back = _back(at.prepared, at.solution, names[k:])
        moved = {row[2].name: map(float, row[4].values[:k] - at.solution.values[:k]) for row in near[1:]}
        doubt = {name: {**dict(zip(names, move, strict=False)), **back} for name, move in moved.items()}
        candidate = replace(candidate, name=OR.join(row[2].name for row in near), doubt=doubt)
        refused.update(row[2].name for row in near[1:])
    at.names.append(candidate)


def _outliers(at: Freed, fit: Fit) -> None:
    """Student's loss if there are isolated outliers."""
    if at.loss != LEAST_SQUARES or alone(at.solution) < SEVERAL:
        return
    prepared = at.end
    count = alone(at.solution)
    solution = fit(prepared, "windows", StudentT())
    if solution.status == "ok":
        at.loss, at.prepared, at.solution = StudentT(), prepared, solution
        at.names.append(Candidate(f"outliers ({count} samples)", ("--student",), {}, {}, float(count), 0.0))


def _without_far_off(at: Freed, fit: Fit) -> Solution:
    """A fit without the windows that contain a jump: their misfit would be taken for damping and for noise."""
    off = far_off(at.solution)
    if not off.any():
        return at.solution
    prepared = replace(at.prepared, windows=at.prepared.windows.without_samples(off))
    # a jump that only shows in these windows
    slopes = at.solution.evaluation.jacobian[~off][..., at.solution.problem.freedoms :]
    unseen = ~np.any(slopes, axis=(0, 1, 2))
    solution = fit(prepared, "windows", at.loss, frozen=unseen if unseen.any() else None)
    if solution.status == "ok":
        return solution
    return at.solution


def _join_before(at: Freed, fit: Fit, clean: Solution, k: int) -> Solution:
    """Merge window k with the previous one: a jump between separate windows costs nothing.

    Returns:
        The solution `clean` with the starts of the remaining windows.
    """
    pieces = [at.prepared.windows.piece(i) for i in range(at.prepared.windows.count)]
    pieces[k - 1 : k + 1] = [pieces[k - 1]._replace(steps=pieces[k - 1].steps + pieces[k].steps)]
    starts = pick(clean.starts, np.arange(len(pieces) + 1) != k)
    at.prepared = replace(at.prepared.with_pieces(pieces), begin=clean.values, starts=starts)
    at.solution = fit(at.prepared, "windows", at.loss)
    return replace(clean, starts=starts)


def _jumps(at: Freed, fit: Fit, simulator: Simulator) -> None:
    """Jumps of the clock at missing frames."""
    while sum(p.is_lost for p in at.prepared.parameters) < 2:
        clean = _without_far_off(at, fit)
        lost = lost_frames(at.prepared, clean)
        if lost is None:
            return
        name = f"{LOST}.{lost.run}.{lost.frame}"
        trace = at.prepared.traces[lost.run]
        # the window with the jump starts where the previous one ends
        windows = at.prepared.windows
        starting = windows.begin <= trace.t[lost.frame] + 1e-6 * trace.interval
        own = np.flatnonzero(starting & (windows.run == lost.run))[-1:]
        clean = replace(clean, starts=starts_from_previous_windows(clean, np.isin(np.arange(windows.count), own)))
        near = np.abs(windows.begin - trace.t[lost.frame]) < 0.5 * trace.interval
        for k in own[(windows.follows & near)[own]]:
            clean = _join_before(at, fit, clean, int(k))
        prepared = with_freed(at.prepared.starting_at(clean), [name], simulator, lost.frames * trace.interval)
        solution = fit(prepared, "windows", at.loss)
        gain = likelihood(solution) - likelihood(at.solution)
        k = len(solution.values) - 1
        seconds = float(solution.values[-1])
        if solution.status != "ok" or gain < WORTH + CHANCE or abs(seconds) < LEAST_LOST * trace.interval:
            return
        at.prepared, at.solution = prepared, solution
        words = f"{seconds / trace.interval:.1f} lost frames before frame {lost.frame} of {trace.name}"
        words += f" ({trace.t[lost.frame]:.3f} s)"
        errors = {name: float(solution.information[k, k]) ** -0.5}
        at.names.append(Candidate(words, (name,), {name: seconds}, errors, gain, 0.0))
