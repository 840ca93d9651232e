"""Fits of damping laws with joined windows, for those that separate windows leave undecided.

Separate windows lose the information on how much energy a motion loses from one to the next; joined ones (`shooting`)
keep it. The weight of the gaps and the time step are those of the law with the most parts. At this one weight all
costs, gaps included, are likelihoods of the same model, so laws can be compared by them as with separate windows. A law
starts from the best of those that it contains, so it never costs more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from fitting.calibration.compared_laws import ComparedLaws
from fitting.calibration.law_fits import better_fit, fit_law
from fitting.calibration.laws import LAWS, contains
from fitting.estimate.least_squares import descend
from fitting.estimate.objective import Objective
from fitting.estimate.residuals import Solution
from fitting.estimate.shooting import GAP_WEIGHTS, fit_shooting
from fitting.estimate.step_size import with_finer_step

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
    begin = fit_law(laws.prepared, family, most, [separate[most]])
    widest = fit_shooting(begin, finer=with_finer_step)
    if widest.status != "ok" or not widest.gap_weight:
        return {}
    family = replace(family, substeps=widest.windows.substeps)
    schedule = [weight for weight in GAP_WEIGHTS if weight >= widest.gap_weight]
    joined: dict[str, Solution] = {}
    for law in order:
        laws.progress(0.95, f"law {law}, joined")
        inner = [solution for name, solution in joined.items() if contains(law, name)]
        tries = []
        if law == most:
            tries.append(widest)
        if inner:  # the additional parts start at zero
            best = min(inner, key=lambda solution: solution.cost)
            problem = replace(best.problem, frozen=~family.free_mask(law))
            objective = Objective(problem, widest.gap_weight, intermediate=True)
            tries.append(descend(objective, replace(best, problem=problem), JOINED_ITERATIONS))
        if not any(solution.status == "ok" for solution in tries):
            begin = fit_law(laws.prepared, family, law, [separate[law]])
            tries.append(fit_shooting(begin, choose=False, schedule=schedule))
        joined[law] = better_fit(tries)
        if joined[law].status != "ok":
            return {}
    return joined
