"""Comparison with joined windows of laws that separate windows leave undecided.

Separate windows lose the information on how much energy a motion loses from one to the next; joined ones (`shooting`)
keep it. The weight of the gaps and the time step are those of the law with the most parts. At this one weight all
costs, gaps included, are likelihoods of the same model, so laws can be compared by them as with separate windows. A law
starts from the best of those that it contains, so it never costs more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dropper_jax.base.progress import Progress, silent
from fitting.calibration.law_fits import Family, fit_law
from fitting.calibration.laws import LADDER, contains
from fitting.calibration.prepared import Prepared
from fitting.estimate.problem import Solution
from fitting.estimate.refinement import finer_step
from fitting.estimate.shooting import SCHEDULE, JoinedWindows, fit_shooting

#: Evaluations of separate windows in the widest law's family, and between a law and one that contains it.
ITERATIONS, ONWARD = 25, 15


def join_laws(
    prepared: Prepared, family: Family, laws: Mapping[str, Solution], progress: Progress = silent
) -> dict[str, Solution]:
    """Joined solutions of laws by name; empty if windows do not follow each other or a law does not converge.

    Args:
        family: contains the parts of all these laws.
        laws: solutions of separate windows.
    """
    if not prepared.windows.follows.any():
        return {}
    order = sorted(laws, key=lambda law: len(LADDER[law]))
    most = order[-1]
    progress(0.95, f"law {most}, joined")
    widest = fit_shooting(fit_law(prepared, family, most, [laws[most]], ITERATIONS), finer=finer_step)
    if widest.status != "ok" or not widest.gap_weight:
        return {}
    family = replace(family, substeps=widest.windows.substeps)
    schedule = [weight for weight in SCHEDULE if weight >= widest.gap_weight]
    found: dict[str, Solution] = {}
    for law in order:
        progress(0.95, f"law {law}, joined")
        inner = [one for name, one in found.items() if contains(law, name)]
        tries = [widest] if law == most else []
        tries += (
            [_onward(min(inner, key=lambda one: one.cost), ~family.free_mask(law), widest.gap_weight)] if inner else []
        )
        if not any(one.status == "ok" for one in tries):
            begin = fit_law(prepared, family, law, [laws[law]], ITERATIONS)
            tries.append(fit_shooting(begin, continuity="tight", schedule=schedule))
        found[law] = min(tries, key=lambda one: (one.status != "ok", one.cost))
    return found if all(one.status == "ok" for one in found.values()) else {}


def _onward(inner: Solution, frozen: np.ndarray, weight: float) -> Solution:
    """From a law's joined solution to a law that contains it, whose additional parts start at zero."""
    problem = replace(inner.problem, frozen=frozen)
    level = JoinedWindows(problem, weight, intermediate=True)
    return level.descend(replace(inner, problem=problem), ONWARD)
