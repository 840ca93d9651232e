"""Multiple shooting: windows joined by weighted gaps, tightened step by step.

    minimise  1/2 sum |r_k|^2 + 1/2 sum |N' (end_k - start_{k+1})/(w s)|^2,      s = 0.1 rad and 1 rad/s

With small w the sensitivity of a chaotic motion improves the estimate: every window constrains all others. A real
system always differs from the model, so w (its process noise) is not driven to zero. It is estimated by Laplace's
approximation of the evidence.

Gaps in units of weight 1: `N' (end_k - start_{k+1})/(c_k s)`, with c_k the root of the ratio of window k's length to
the mean length, so that splitting a window does not allow more process noise. Only neighbours are coupled: a
block-tridiagonal matrix in the starts, bordered by the parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, part_of, silent
from fitting.estimate.least_squares import CONTINUED_ITERATIONS, descend
from fitting.estimate.objective import Objective
from fitting.estimate.solution import Solution

#: Gap weights, in order. Larger ratios lose the neighbourhood of the optimum (measured on the lab dropper).
GAP_WEIGHTS = (1.0, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
#: Difference of log evidence within which the largest weight is chosen, with the widest errors: the noise hardly
#: distinguishes such weights. Ratio of errors to standard errors for 60 random droppers: RMS 0.77 at a difference of
#: 0.5, with standard errors up to 1.4 times those of the smallest weight.
SAME_EVIDENCE = 0.2
#: Difference from the maximum log evidence at which the maximum counts as passed; and from the evidence that the linear
#: model predicts, at which the motion does not follow that model.
EVIDENCE_DROP = 5.0


def continue_at(objective: Objective, begin: Solution, count: int, progress: Progress) -> Solution:
    """Continue from a solution at one gap weight, after `count` evaluations."""
    found = descend(objective, begin, CONTINUED_ITERATIONS, progress=progress)
    return replace(found, iterations=count + found.iterations)


#: If gaps are much smaller than a weight allows, the weight has no effect: weights larger than this multiple of the
#: gaps' own RMS are skipped.
WIDE_GAPS = 5.0
#: Fraction of the evidence lost with a smaller weight that finer steps must recover if residuals are not noise.
RECOVERED_SHARE = 0.3
#: Change of the evidence between weights below which smaller weights are not tried.
FLAT_EVIDENCE = 0.02


def fit_shooting(
    begin: Solution,
    *,
    choose: bool = True,
    schedule: Sequence[float] = GAP_WEIGHTS,
    finer: Callable[[Solution], Solution | None] = lambda point: None,
    progress: Progress = silent,
) -> Solution:
    """Join the windows of a fit by `fit_windows`, whose noise must be in the windows' weights.

    Args:
        begin: the separate windows' solution.
        choose: whether tightening stops at the maximum of the evidence; otherwise at the end of the schedule.
        schedule: gap weights.
        finer: the solution on windows of half the step, or None if the step is fine enough. It is called when a smaller
            weight has less evidence: the error of a step leaves gaps like a wrong model, and would keep the weight
            large.

    Returns:
        The solution at the chosen weight (`gap_weight`, `evidence`), for `solve_to_end`.
    """
    if not begin.windows.follows.any():
        return begin
    memory = begin.problem.memory
    patience = 2
    if memory > 1:  # with correlated residuals the maximum of the evidence is clear
        patience = 1
    separate = begin.problem.gaps(begin.evaluation, begin.values).value
    wide = WIDE_GAPS * np.sqrt(np.mean(separate**2))
    schedule = [*(w for w in schedule[:-1] if w < wide), schedule[-1]]
    if choose and memory == 1:
        found_at_once = follow_linear_model(begin, schedule, finer, progress)
        if found_at_once is not None:
            return found_at_once
    found: list[Solution] = []
    point = begin
    worse = 0
    for i, weight in enumerate(schedule):
        done = (i + 1) / (len(schedule) + 1)
        most = max((p.evidence for p in found), default=-np.inf)
        point = solve_at_weight(point, weight, most, finer, part_of(progress, done, done))
        found.append(point)
        if (most - point.evidence) / memory > EVIDENCE_DROP:
            worse += 1
        else:
            worse = 0
        is_flat = i > 0 and abs(point.evidence - found[-2].evidence) < FLAT_EVIDENCE
        if choose and (is_flat or worse == patience):
            break
    best = found[-1]
    if choose:
        best = loosest(found)
    best.iterations = max(point.iterations, best.iterations)
    return best


def solve_at_weight(
    begin: Solution,
    weight: float,
    best_evidence: float,
    finer: Callable[[Solution], Solution | None],
    progress: Progress,
) -> Solution:
    """The solution at one gap weight, with finer steps while the error of a step costs evidence.

    Args:
        begin: solution at the weight before, or of separate windows.
        best_evidence: of all weights before.
        finer: as for `fit_shooting`.
    """
    point = begin
    again: Solution | None = begin
    while again is not None:
        objective = Objective(again.problem, weight, intermediate=True)
        point = continue_at(objective, again, point.iterations, progress)
        point.evidence = objective.evidence(point)
        text = f"gap weight {weight:g}, {point.windows.substeps} substeps, evidence {point.evidence:.1f}"
        progress(0.0, text)
        fell = best_evidence - point.evidence
        again = None
        if fell > SAME_EVIDENCE:
            again = finer(point)
        if again is not None and begin.problem.memory > 1 and not _is_step_wrong(point, again, objective, fell):
            again = None
    return point


def _is_step_wrong(point: Solution, finer: Solution, objective: Objective, fell: float) -> bool:
    """Whether finer steps recover the evidence that a smaller weight lost (`fell`); otherwise the model is wrong."""
    step = Objective(finer.problem, objective.weight).undamped_step(finer.evaluation, finer.values)
    if step is None:
        return False
    gain = point.cost - objective.cost(finer.evaluation, finer.values) + step.predicted
    return not gain < RECOVERED_SHARE * fell


def follow_linear_model(
    begin: Solution,
    schedule: Sequence[float],
    finer: Callable[[Solution], Solution | None],
    progress: Progress,
) -> Solution | None:
    """The solution at the weight that the linear model of the motion chooses; None if the motion does not follow it.

    One evaluation gives the evidence of all weights. The descent goes straight to the chosen one, and the evidence
    there has to be as predicted.
    """
    point = begin
    total = begin.iterations
    expected = log_evidence(point, schedule)
    for _ in schedule:
        if not np.isfinite(expected).all():
            return None
        chosen = loosest_of(expected)
        if point.gap_weight != schedule[chosen]:
            objective = Objective(point.problem, schedule[chosen], intermediate=True)
            point = continue_at(objective, point, total, part_of(progress, 0.5, 0.5))
            total = point.iterations
            before = expected
            expected = log_evidence(point, schedule)
            progress(0.5, f"gap weight {schedule[chosen]:g}, evidence {expected[chosen]:.1f}")
            if point.status != "ok" or not expected[chosen] > before[chosen] - EVIDENCE_DROP:
                return None
            continue
        point.evidence = expected[chosen]
        fell = np.flatnonzero(expected[chosen:] < expected.max() - SAME_EVIDENCE)
        again = None
        if len(fell):
            tight = Objective(point.problem, schedule[chosen + fell[0]])
            known = tight.undamped_step(point.evaluation, point.values) or point
            cost = tight.cost(point.evaluation, point.values)
            again = finer(tight.solution(point.values, point.evaluation, cost, known))
        if again is None:
            return point
        point = replace(again, gap_weight=None)
        total = total + 1
        expected = log_evidence(point, schedule)
    return None


def log_evidence(point: Solution, schedule: Sequence[float]) -> np.ndarray:
    """Log evidence of every weight by the linear model of the motion at a point."""
    return np.array([Objective(point.problem, weight).evidence(point) for weight in schedule])


def solve_to_end(point: Solution, progress: Progress = silent) -> Solution:
    """A solution fully converged at its gap weight; `fit_shooting` stops earlier, as finer steps may have to follow."""
    if not point.gap_weight:
        return point
    objective = Objective(point.problem, point.gap_weight)
    found = continue_at(objective, point, point.iterations, progress)
    if found.status == "ok":
        found.evidence = objective.evidence(found)
    return replace(found, step_bias=point.step_bias)


def loosest(found: Sequence[Solution]) -> Solution:
    """The solution at the largest weight whose evidence is near the best."""
    return found[loosest_of([point.evidence for point in found])]


def loosest_of(evidence: Sequence[float] | np.ndarray) -> int:
    """Number of the largest weight whose evidence is near the best: below it, the noise cannot distinguish weights."""
    return int(np.argmax(np.array(evidence) >= max(evidence) - SAME_EVIDENCE))
