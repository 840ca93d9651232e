"""Groups of numbers that may be wrong together, tested by fits and scored on stretches that these fits do not use.

If the misfit is smooth and far above the noise everywhere, score tests find nothing: their gains are in units of the
misfit, and a single number reduces it only slightly. All groups are therefore freed at once: geometry, inertia,
markers, camera, clock and parts of the damping law. Their priors are as wide as the usual errors of such numbers, and
three fifths of every run are fitted. The score is the error on the other two fifths, with only their starts fitted.
Then one group after another is fixed again, and stays fixed unless this makes the score worse. Groups that were fixed
while the fit was still far from its minimum are tried once more at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dropper_jax.base.errors import Progress, silent
from dropper_jax.base.read import ScenePath
from dropper_jax.run.build import build
from fitting.calibration.advice import joint_information
from fitting.calibration.candidate import Candidate
from fitting.calibration.fault_groups import FaultGroup, fault_groups
from fitting.calibration.held_out import score_held_out, window_length
from fitting.calibration.law_fits import substeps_of
from fitting.calibration.law_scenes import scene_with_law, without_unused_parts
from fitting.calibration.laws import JOINT_PARTS, LAW_PARTS, part_of
from fitting.calibration.possible_faults import candidate_simulator
from fitting.calibration.prepared import Prepared, fitted_parts, program_space
from fitting.calibration.result import chi2_per_dof
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.loss import Loss
from fitting.estimate.noise import Noise, lag_one
from fitting.estimate.residual_noise import memory_of
from fitting.estimate.residuals import Solution
from fitting.estimate.simulator import Simulator, choose_stepper
from fitting.estimate.windows import LONGEST_WINDOW, Span, Starts, Windows, pick, with_rows
from fitting.parameters.parameter import Parameter
from fitting.parameters.paths import resolve
from fitting.parameters.targets import all_joints

#: Chi-square per degree of freedom from which a smooth misfit shows that the whole model is wrong: ten times the noise.
WRONG_CHI_SQUARE = 100.0
#: Correlation of neighbouring residuals above which a misfit is smooth: one at 6 Hz, sampled at 60 Hz, has 0.81.
SMOOTH_CORRELATION = 0.8
#: Number of parts of a run.
PARTS_OF_RUN = 5
#: Numbers, from 0, of the parts that are scored: one between fitted ones, and the end, where damping counts.
SCORED_PARTS = (2, 4)
#: Relative growth of the score above which a group is needed: a smaller one makes no difference to a user.
NEEDED_GROWTH = 0.05
#: Minimum fraction of a number's information that must be its own; below it the number duplicates others.
LEAST_INFORMATION_SHARE = 2e-4
#: Value added to the diagonal of the scaled information, whose numbers may duplicate one another.
DIAGONAL_RIDGE = 1e-12


def is_model_wrong(prepared: Prepared, solution: Solution, limit: float = WRONG_CHI_SQUARE) -> bool:
    """Whether a fit leaves a smooth misfit far above the noise claimed by the traces."""
    expected = prepared.windows.weight
    if solution.windows.weight.shape != expected.shape or not np.isfinite(solution.cost):
        return False
    neighbours, _ = lag_one(solution.errors * expected, expected > 0)
    return chi2_per_dof(prepared, solution) > limit and neighbours > SMOOTH_CORRELATION


#: Maximum evaluations of a trial, which starts near its end.
TRIAL_ITERATIONS = 12


class Trials:
    """Fits of some windows of a preparation, scored on the stretches of the others.

    Args:
        prepared: with a simulator that knows the parameters of all trials.
        loss: of the fits.
        solution: of all windows.
        windows: the solution's, with the noise that the traces claim.

    Attributes:
        spans: the scored stretches.
        used: windows (K,) bool that are fitted.
        claimed: these windows with the noise that the traces claim.
        noise: by the misfit of the last solution that `weigh` was given.
    """

    def __init__(self, prepared: Prepared, loss: Loss, solution: Solution, windows: Windows) -> None:
        scored = scored_windows(prepared)
        self.spans = stretches(prepared, scored)
        self.used = ~scored
        self.loss = loss
        fitted = map(Span, prepared.windows.run, prepared.windows.begin, prepared.windows.ends)
        inside = fitted_parts(prepared.traces, list(fitted))
        self.prepared = replace(prepared, traces=inside, held_out=tuple((low, high) for _, low, high in self.spans))
        self.claimed = prepared.windows.pick(self.used)
        self.weigh(solution, windows)

    def weigh(self, solution: Solution, claimed: Windows) -> None:
        """Weight each link by its misfit and each sample by the memory of the noise, so that priors count.

        Args:
            claimed: the solution's windows with the claimed noise.
        """
        known = claimed.weight > 0
        noise = Noise.of_misfit(solution.errors * claimed.weight, known, claimed.run, self.prepared.floor)
        self.noise = replace(noise, factor=noise.factor * np.sqrt(memory_of(solution)))
        self.prepared = replace(self.prepared, noise=self.noise)

    def fit(self, parameters: Sequence[Parameter], values: np.ndarray, starts: Starts) -> Solution:
        """A short fit of the windows that are not scored, with the noise of the last misfit."""
        at = self.prepared.with_parameters(parameters, values)
        windows = self.noise.apply_to(self.claimed, self.prepared.traces)
        problem = at.problem(self.loss).with_noise(self.noise, windows, values)
        return fit_windows(problem, values, starts, iterations=TRIAL_ITERATIONS)

    def score(self, solution: Solution) -> float:
        """Mean logarithm of the RMS errors [rad] of the windows of all scored stretches."""
        at = self.prepared.with_parameters(solution.problem.parameters, solution.values)
        held = [score_held_out(at, solution.values, (low, high), run).solution for run, low, high in self.spans]
        known = np.concatenate([(one.windows.weight > 0).sum(axis=(1, 2)) for one in held])
        square = np.concatenate([np.sum(one.errors**2, axis=(1, 2)) for one in held])
        return float(np.mean(0.5 * np.log(np.maximum(square[known > 0] / known[known > 0], 1e-24))))


def scored_windows(prepared: Prepared) -> np.ndarray:
    """Windows (K,) in the scored parts of their runs; none of runs with too few windows."""
    windows = prepared.windows
    scored = np.zeros(windows.count, bool)
    for i in np.unique(windows.run):
        mine = windows.run == i
        low = windows.begin[mine].min()
        middle = 0.5 * (windows.begin + windows.ends)[mine]
        part = np.floor(PARTS_OF_RUN * (middle - low) / (windows.ends[mine].max() - low))
        scored[mine] = np.isin(part, SCORED_PARTS) & (len(part) >= PARTS_OF_RUN)
    return scored & ~windows.released


def stretches(prepared: Prepared, scored: np.ndarray) -> list[Span]:
    """(run, from, to) of neighbouring scored windows, in equal parts of at most `LONGEST_WINDOW` [s]."""
    windows = prepared.windows
    found: list[Span] = []
    for k in np.flatnonzero(scored):
        span = Span(int(windows.run[k]), float(windows.begin[k]), float(windows.ends[k]))
        if found and scored[k - 1] and windows.follows[k]:
            span = span._replace(low=found.pop().low)
        found.append(span)
    parts = []
    for run, low, high in found:
        edges = np.linspace(low, high, int(np.ceil((high - low) / LONGEST_WINDOW)) + 1).tolist()
        parts += [Span(run, a, b) for a, b in pairwise(edges)]
    return parts


def with_full_law(prepared: Prepared, solution: Solution) -> tuple[Prepared, list[Parameter]]:
    """The preparation with every part of a damping law in the model, and friction of all joints as separate numbers.

    Dry friction needs another scheme, which costs many times as much. It is a candidate for rigs of rods or with
    friction in their joints, not for strings of point masses.
    """
    scene = prepared.scene
    own = prepared.simulator
    given = scene.effects.get("joint_friction", {})
    free = prepared.names
    zero = {part: 0.0 for part in JOINT_PARTS if LAW_PARTS[part] in free}
    dry = given.get("dry") is not None or own.model.line.compound
    scene = scene_with_law(scene, dry, zero, JOINT_PARTS)
    model, _ = build(scene)
    parameters = []
    shared = []
    for p in prepared.parameters:
        new = (p,)
        if not p.is_lost:
            new = resolve(model, [p.name], release=own.release)
        if new[0].name == p.name:
            parameters.append(replace(p, where=new[0].where))
        else:  # joints now have separate numbers
            parameters.append(replace(p, where=all_joints(model, ScenePath(p.name).key)))
            shared.append(parameters[-1])
    simulator = Simulator(model, parameters, choose_stepper(model), own.release)
    substeps = substeps_of(replace(prepared, windows=solution.windows), simulator)
    windows = replace(prepared.windows, substeps=substeps)
    return replace(prepared, scene=scene, parameters=tuple(parameters), simulator=simulator, windows=windows), shared


def free_groups(
    prepared: Prepared, solution: Solution, loss: Loss, progress: Progress = silent
) -> tuple[Prepared, Simulator, list[Candidate]] | None:
    """The preparation with the groups free that held-out stretches require; None if they require none.

    Args:
        solution: of the preparation.
    """
    before = prepared
    prepared, shared = with_full_law(prepared, solution)
    found = fault_groups(prepared.simulator.model, prepared.parameters, shared)
    zero = [replace(p, value=0.0) for p in shared]
    simulator = candidate_simulator(prepared, [*_parameters_of(found), *zero])
    trials = Trials(replace(prepared, simulator=simulator), loss, solution, before.windows)
    if not (trials.spans and trials.used.any()):  # no windows to score, or none to fit
        return None
    # the programs also run the windows that score the stretches
    longest = max(window_length(prepared, (low, high)) for _, low, high in trials.spans)
    steps, slots = program_space(prepared.traces, longest, prepared.windows.dt)
    simulator.capacity = max(simulator.capacity[0], steps), max(simulator.capacity[1], slots)
    progress(0.5, "testing what may be wrong: unchanged model")
    base = trials.fit(prepared.parameters, solution.values, pick(solution.starts, trials.used))
    first = trials.score(base)
    search = Search(trials, effective(trials, base, found), base)
    progress(0.55, "testing what may be wrong: everything free")
    search.free_all()
    if not search.lowest < first - np.log1p(NEEDED_GROWTH):
        return None
    search.free_late(search.fix_needless(progress), progress)
    if not search.free:
        return None
    best = search.best
    at = trials.prepared.with_parameters(best.problem.parameters, best.values)
    scene = without_unused_parts(at.scene, before.scene, at.names)
    at = replace(
        at,
        scene=scene,
        traces=before.traces,
        held_out=before.held_out,
        noise=before.noise,
        starts=with_rows(solution.starts, trials.used, best.starts),
    )
    return at, simulator, [_candidate(group, search.needed[group.name], best) for group in search.free]


class Search:
    """Groups that trials show to be needed.

    Args:
        trials: fit and score.
        found: groups that may be free.
        base: fit without them.

    Attributes:
        values: of every number at the end of the last fit in which it was free.
        free, best, lowest: free groups, their fit, and the smallest score so far.
        needed: by name of a group, the factor of the held-out error without it.
    """

    def __init__(self, trials: Trials, found: Sequence[FaultGroup], base: Solution) -> None:
        self.trials = trials
        self.groups = found
        values = base.by_name
        self.start: dict[str, float] = {}
        for p in _parameters_of(found):
            own = values.get(p.name, p.value)
            self.start[p.name] = values.get(ScenePath(p.name).stem, own)
        self.values = self.start | values
        self.free: list[FaultGroup] = []
        self.best = base
        self.lowest = np.inf
        self.needed: dict[str, float] = {}

    def fit(self, free: Sequence[FaultGroup]) -> Solution:
        """A fit with these groups free, from the best one so far."""
        replaced = _replaced_by(free)
        every = [p for p in self.trials.prepared.parameters if p.name not in replaced]
        every += _parameters_of(free)
        return self.trials.fit(every, np.array([self.values[p.name] for p in every]), self.best.starts)

    def free_all(self) -> None:
        """All groups free, three times, weighted by the misfit of the fit before, which becomes smaller."""
        self.best = self.fit(self.groups)
        for _ in range(2):
            self.values |= self.best.by_name
            self.trials.weigh(self.best, self.trials.claimed)
            self.best = self.fit(self.groups)
        self.free = list(self.groups)
        self.lowest = self.trials.score(self.best)

    def fix_needless(self, progress: Progress) -> dict[FaultGroup, float]:
        """Fix every group without which the score is not worse; returns them and the smallest score at that time."""
        fixed = {}
        for group in self.groups:
            progress(0.6, f"testing what may be wrong: without {group.name}")
            self.values |= self.best.by_name
            mean = float(np.mean([self.values[p.name] for p in group.parameters]))
            self.values |= {p.name: mean for p in group.instead}
            fewer = [other for other in self.free if other is not group]
            less = self.fit(fewer)
            now = self.trials.score(less)
            if now < self.lowest + np.log1p(NEEDED_GROWTH):
                self.free = fewer
                self.best = less
                self.lowest = min(self.lowest, now)
                fixed[group] = self.lowest
            else:
                self.needed[group.name] = float(np.exp(now - self.lowest))
        return fixed

    def free_late(self, fixed: dict[FaultGroup, float], progress: Progress) -> None:
        """Free again, the best first, what was fixed while others held the fit far from its minimum."""
        late = [group for group, then in fixed.items() if self.lowest < then - np.log1p(NEEDED_GROWTH)]
        while late:
            self.values |= self.best.by_name
            for p in _parameters_of(late):
                self.values[p.name] = self.start[p.name]
            progress(0.7, f"testing what may be wrong: with {', '.join(group.name for group in late)}")
            tries = [self.fit([*self.free, group]) for group in late]
            scores = [self.trials.score(one) for one in tries]
            k = int(np.argmin(scores))
            if not scores[k] < self.lowest - np.log1p(NEEDED_GROWTH):
                return
            group = late.pop(k)
            self.needed[group.name] = float(np.exp(self.lowest - scores[k]))
            self.free.append(group)
            self.best = tries[k]
            self.lowest = scores[k]


def _parameters_of(groups: Sequence[FaultGroup]) -> list[Parameter]:
    """The numbers of all groups."""
    return [p for group in groups for p in group.parameters]


def _replaced_by(groups: Sequence[FaultGroup]) -> set[str]:
    """Names of the parameters that the numbers of these groups replace."""
    return {p.name for group in groups for p in group.instead}


def effective(trials: Trials, base: Solution, found: Sequence[FaultGroup]) -> list[FaultGroup]:
    """The groups without numbers that move no angle, or that duplicate others of the group or free ones.

    For coefficients of damping, all known earlier ones count, including those of other groups.
    """
    at = trials.prepared.with_parameters(base.problem.parameters, base.values)
    _, _, data = joint_information(at, base, trials.prepared.simulator, _parameters_of(found))
    size = np.sqrt(np.maximum(np.diag(data), 0.0))
    size = np.where(size > 0, size, 1.0)
    scaled = data / np.outer(size, size)
    replaced = _replaced_by(found)
    free = [i for i, p in enumerate(base.problem.parameters) if p.name not in replaced]
    row = len(base.problem.parameters)
    left = []
    for group in found:
        known = list(free)
        own = []
        for p in group.parameters:
            inner = scaled[np.ix_(known, known)] + DIAGONAL_RIDGE * np.eye(len(known))
            alike = scaled[row, known] @ np.linalg.solve(inner, scaled[known, row])
            if data[row, row] > 0 and 1.0 - alike > LEAST_INFORMATION_SHARE:
                known.append(row)
                own.append(p)
            row += 1
        if any(part_of(p.name) for p in own):
            free = known
        if own:
            left.append(replace(group, parameters=tuple(own)))
    return left


def _candidate(group: FaultGroup, factor: float, solution: Solution) -> Candidate:
    """A group that was freed, with the changes of its numbers."""
    variance = np.diag(np.linalg.pinv(solution.information, hermitian=True))
    error = dict(zip(solution.by_name, np.sqrt(np.maximum(variance, 0.0)), strict=True))
    changes = {p.name: solution.by_name[p.name] - p.value for p in group.parameters}
    errors = {name: float(max(error[name], 1e-300)) for name in changes}
    name = f"{group.name} (held-out error {factor:.2f} times larger without)"
    return Candidate(name, tuple(changes), changes, errors, float(np.log(factor)))
