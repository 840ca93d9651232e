"""Fits of damping laws with joined windows, for those that separate windows leave undecided.

Separate windows lose the information on how much energy a motion loses from one to the next; joined ones (`shooting`)
keep it. The weight of the gaps and the time step are those of the law with the most parts. At this one weight all
costs, gaps included, are likelihoods of the same model, so laws can be compared by them as with separate windows. A law
starts from the best of those that it contains, so it never costs more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fitting.estimate.least_squares import descend
from fitting.estimate.objective import Objective
from fitting.estimate.shooting import GAP_WEIGHTS, fit_shooting
from fitting.estimate.solution import Solution
from fitting.estimate.step_size import with_finer_step
from fitting.laws.compared_laws import ComparedLaws
from fitting.laws.law_fits import better_fit, fit_law
from fitting.laws.laws import LAWS, contains

#: Evaluations of joined windows between a law and one that contains it.
JOINED_ITERATIONS = 15


def join_laws(laws: ComparedLaws, separate: Mapping[str, Solution], dry_friction: bool) -> dict[str, Solution]:
    """Joined solutions of laws by name; empty if windows do not follow each other or a law does not converge.

    Args:
        separate: solutions of separate windows by name.
        dry_friction: which family, that has the parts of all these laws.
    """
    if not laws.prepared.windows.follows.any():
        return {}
    order = sorted(separate, key=lambda law: len(LAWS[law]))
    most = order[-1]
    laws.progress(0.95, f"law {most}, joined")
    family = laws.families[dry_friction]
    widest = fit_shooting(fit_law(laws.prepared, family, most, [separate[most]]), finer=with_finer_step)
    if widest.status != "ok" or not widest.gap_weight:
        return {}
    family = replace(family, substeps=widest.windows.substeps)
    joined: dict[str, Solution] = {}
    for law in order:
        laws.progress(0.95, f"law {law}, joined")
        tries = []
        if law == most:
            tries.append(widest)
        inner = [solution for name, solution in joined.items() if contains(law, name)]
        if inner:
            tries.append(_with_more_parts(inner, ~family.free_mask(law), widest.gap_weight))
        if not any(solution.status == "ok" for solution in tries):
            schedule = [weight for weight in GAP_WEIGHTS if weight >= widest.gap_weight]
            begin = fit_law(laws.prepared, family, law, [separate[law]])
            tries.append(fit_shooting(begin, choose=False, schedule=schedule))
        joined[law] = better_fit(tries)
        if joined[law].status != "ok":
            return {}
    return joined


def _with_more_parts(inner: Sequence[Solution], frozen: np.ndarray, gap_weight: float) -> Solution:
    """A law joined from the best of those that it contains; its additional parts start at zero.

    Args:
        frozen: parameters (k,) bool that the law lacks.
    """
    best = min(inner, key=lambda solution: solution.cost)
    problem = replace(best.problem, frozen=frozen)
    objective = Objective(problem, gap_weight, intermediate=True)
    return descend(objective, replace(best, problem=problem), JOINED_ITERATIONS)
