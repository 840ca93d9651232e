"""Search for the groups of numbers that trials show to be needed: all free at first, then one after another fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress
from dropper_jax.base.read import ScenePath
from fitting.calibration.fault_groups import FaultGroup
from fitting.calibration.joint_information import joint_information
from fitting.calibration.trials import Trials
from fitting.estimate.solution import Solution
from fitting.laws.laws import part_of
from fitting.parameters.parameter import Parameter

#: Relative growth of the score above which a group is needed: a smaller one makes no difference to a user.
NEEDED_GROWTH = 0.05
#: Minimum fraction of a number's information that must be its own; below it the number duplicates others.
LEAST_INFORMATION_SHARE = 2e-4
#: Value added to the diagonal of the scaled information, whose numbers may duplicate one another.
DIAGONAL_RIDGE = 1e-12


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
        for p in parameters_of(found):
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
        every += parameters_of(free)
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
            mean = np.mean([self.values[p.name] for p in group.parameters])
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
                self.needed[group.name] = np.exp(now - self.lowest)
        return fixed

    def free_late(self, fixed: dict[FaultGroup, float], progress: Progress) -> None:
        """Free again, the best first, what was fixed while others held the fit far from its minimum."""
        late = [group for group, then in fixed.items() if self.lowest < then - np.log1p(NEEDED_GROWTH)]
        while late:
            self.values |= self.best.by_name
            for p in parameters_of(late):
                self.values[p.name] = self.start[p.name]
            progress(0.7, f"testing what may be wrong: with {', '.join(group.name for group in late)}")
            tries = [self.fit([*self.free, group]) for group in late]
            scores = [self.trials.score(one) for one in tries]
            k = np.argmin(scores)
            if not scores[k] < self.lowest - np.log1p(NEEDED_GROWTH):
                return
            group = late.pop(k)
            self.needed[group.name] = np.exp(self.lowest - scores[k])
            self.free.append(group)
            self.best = tries[k]
            self.lowest = scores[k]


def parameters_of(groups: Sequence[FaultGroup]) -> list[Parameter]:
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
    data = joint_information(at, base, trials.prepared.simulator, parameters_of(found)).data
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
