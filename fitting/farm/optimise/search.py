"""The search for a design: rounds of linear programmes within a reach that grows where they are accurate.

After a round of some steps (`search_round`) the windows are chosen again from whole runs. A design is accepted if its
whole runs meet all constraints, and the search ends with the best of these.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dropper_jax.base.progress import Progress
from fitting.farm.optimise.design_problem import DesignProblem
from fitting.farm.optimise.programme import PENALTY_AT_START
from fitting.farm.optimise.search_round import SMALLEST_REACH, run_round, try_design
from fitting.farm.optimise.search_state import Search, Start
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.windows import Window

#: Permitted excess of constraints of the best design over 1: rounding.
PERMITTED_EXCESS = 1e-9


def measure_design(
    search: Search, problem: DesignProblem, say: Progress, predicted: Values | None = None
) -> tuple[tuple[Window, ...], Values]:
    """Update the windows and compute the constraints by whole runs; the best design so far is stored.

    Args:
        predicted: values of this design with the previous windows and factors, for the residual.
    """
    windows, found = problem.measure(search.x, say)
    search.residual = None
    if predicted is not None:
        search.residual = np.max(np.abs(predicted.value - found.value), initial=0.0)
    row = {"round": search.round, "objective": found.objective, "worst": found.worst}
    search.history.append({**row, "whole": True, "residual": search.residual, "values": search.x.tolist()})
    if found.worst <= 1.0 + PERMITTED_EXCESS and found.objective < search.best_objective:
        search.best = search.x.copy()
        search.best_objective = found.objective
        search.best_residual = search.residual
    return windows, found


def snap_to_catalogue(search: Search, problem: DesignProblem, values: Values) -> np.ndarray:
    """The design with variables on sizes of their catalogues: the neighbours with the lowest cost to first order."""
    x = search.x.copy()
    limit = 1.0 - problem.settings.margin
    for k, variable in enumerate(problem.variables):
        if variable.catalogue:
            sizes = np.array(variable.sizes(x[k]))
            d = sizes - x[k]
            over = np.maximum(values.value[:, None] + values.slopes[:, k, None] * d - limit, 0.0)
            x[k] = sizes[np.argmin(values.slope[k] * d / search.scale + PENALTY_AT_START * over.sum(axis=0))]
    return x


def run_search(search: Search, problem: DesignProblem, save: Callable[[], None], say: Progress) -> Start:
    """The whole search, from its current state; returns the design at its start."""
    settings = problem.settings
    windows, found = measure_design(search, problem, say)
    start = search.before
    if start is None:
        start = Start(search.x.tolist(), found.objective, constraints_by_name(found))
        search.scale = abs(found.objective) or 1.0
        search.before = start
        save()
    last = search.best_objective
    still_better = True
    while search.round < search.sized + settings.rounds and still_better:
        here = run_round(search, problem, windows, save, say)
        search.round += 1
        windows, found = measure_design(search, problem, say, here)
        save()
        # the first design that meets all constraints gains
        gained = last - search.best_objective if np.isfinite(last) else np.inf
        # windows that were off by more than the margin are other ones now, in which steps may be longer again
        movable = search.reach > SMALLEST_REACH or (search.residual or 0.0) > settings.margin
        still_better = here.solved and (gained > settings.enough * search.scale or (found.worst > 1.0 and movable))
        last = search.best_objective
        if search.fixed is None and (not still_better or search.round >= settings.rounds):
            if search.best is not None:
                search.x = search.best.copy()
            if any(v.catalogue for v in problem.variables):
                windows = _fix_sizes(search, problem, windows, say)
                last = search.best_objective
                still_better = True
                save()
    search.done = True
    save()
    return start


def _fix_sizes(
    search: Search, problem: DesignProblem, windows: tuple[Window, ...], say: Progress
) -> tuple[Window, ...]:
    """Fix variables on sizes of their catalogues: the others are optimised again, with these windows."""
    say(0.0, "sizes of the catalogues: derivatives")
    storms = problem.storm_runs
    runs = storms.differentiate(storms.run_windows(search.x, windows, say), say)
    search.x = snap_to_catalogue(search, problem, problem.values(runs))
    search.fixed = np.array([bool(v.catalogue) for v in problem.variables])
    search.reach = problem.settings.reach
    search.sized = search.round
    search.best = None
    search.best_objective = np.inf
    there, _ = try_design(problem, search.x, windows, say)
    predicted = None if there is None else problem.values(there)
    return measure_design(search, problem, say, predicted)[0]


def constraints_by_name(values: Values) -> dict[str, float]:
    """Constraints by name."""
    return dict(zip(values.names, values.value.tolist(), strict=True))
