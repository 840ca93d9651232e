"""`optimise`: from a site to a design, with a check of its derivatives, in a search that can be resumed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.progress import Progress, silent
from dropper_jax.study.gradient_check import GradientCheck
from fitting.farm.optimise.along_gradient import check_along
from fitting.farm.optimise.calm_model import ASSUMPTIONS
from fitting.farm.optimise.design_problem import DesignProblem
from fitting.farm.optimise.optimum import CHARACTERISTIC, Optimum, design_warnings
from fitting.farm.optimise.programme import solve_programme
from fitting.farm.optimise.read_goals import read_goals
from fitting.farm.optimise.search import constraints_by_name, run_search
from fitting.farm.optimise.search_file import digest_inputs, load_search, save_search
from fitting.farm.optimise.search_state import Search, Start
from fitting.farm.optimise.settings import SearchSettings
from fitting.farm.optimise.shadow_prices import shadow_prices
from fitting.farm.optimise.values import Values, dominated_slopes
from fitting.farm.optimise.variables import bounds, read_variables
from fitting.farm.site import Site


def read_problem(site: Site) -> DesignProblem:
    """The design problem of a site, checked.

    Raises:
        SceneError: for any invalid input, before anything runs.
    """
    variables = read_variables(site.raw.get("variable", []), site.scene)
    if None not in site.states:
        raise SceneError("cases.states: must include 'intact', because the intact farm is optimised")
    return DesignProblem(
        site, variables, read_goals(site), SearchSettings.read(site.raw.get("optimise", {}), "optimise")
    )


def optimise(site: Site, state: str | Path | None = None, say: Progress = silent) -> Optimum:
    """The best design of a site.

    Args:
        state: file that stores the search after every step; an existing one is resumed.

    Raises:
        SceneError: a site that cannot be used, constraints that no design within the bounds meets to first order, or
            runs that fail.
    """
    problem = read_problem(site)
    file = None if state is None else Path(state)
    digest = digest_inputs(problem)
    search, along = load_search(file, digest, problem)

    def save() -> None:
        save_search(file, digest, search, along)

    if search.before is None:
        _check_depths(problem)
        along = check_along(problem, say)
        save()
    start = search.before
    if start is None or not search.done:
        start = run_search(search, problem, save, say)
    return _optimum(problem, search, start, along, say)


def _check_depths(problem: DesignProblem) -> None:
    """Reject depths at rest that no design within the bounds meets to first order, before any storm is run."""
    low, high = bounds(problem.variables)
    for storm in {storm.still: storm for storm in problem.site.storms}.values():
        rows = problem.depths(problem.start, storm)
        if not rows:
            continue
        names, value, slopes = zip(*rows, strict=True)
        values = Values(0.0, np.zeros(len(low)), names, np.array(value), np.array(slopes))
        step = solve_programme(values, low - problem.start, high - problem.start, 1.0, 1.0)
        if step.violation > 1e-3:
            left = values.value + values.slopes[:, : len(low)] @ step.step
            raise SceneError(
                f"constraint: {names[int(np.argmax(left))]} cannot be met together with the others within the "
                "variables' bounds; use wider bounds, or limits that do not contradict"
            )


def _optimum(problem: DesignProblem, search: Search, before: Start, along: GradientCheck, say: Progress) -> Optimum:
    """The end of a search: constraints of whole runs, prices, assumptions."""
    x = search.x if search.best is None else search.best
    say(0.95, "final whole runs and prices")
    windows, found = problem.measure(x, say)
    runs = problem.storm_runs
    here = problem.values(runs.differentiate(runs.run_windows(x, windows, say), say, assumptions=True))
    p = len(problem.variables)
    limit = 1.0 - problem.settings.margin
    low, high = bounds(problem.variables)
    fixed = np.zeros(p, bool) if search.fixed is None else search.fixed
    price = shadow_prices(here, x, low, high, fixed, limit)
    costs = here.slope[p:] + price.by_constraint @ here.slopes[:, p:]
    dominated = dominated_slopes(here, high - low, limit)
    rows = []
    for one in dominated:
        name = problem.variables[one.variable].name
        rows.append({**one._asdict(), "variable": name, "seed": problem.site.run.first_seed + one.seed})
    residual = np.nan if search.best_residual is None else search.best_residual
    return Optimum(
        variables=problem.variables,
        before=np.array(before.x),
        after=x,
        of=problem.goals.objective.of,
        objective=(before.objective, found.objective),
        constraints={n: (before.constraints[n], after) for n, after in constraints_by_name(found).items()},
        prices={n: -0.01 * by for n, by in zip(here.names, price.by_constraint, strict=True) if by > 0},
        assumptions={n: 0.01 * c for n, c in zip(ASSUMPTIONS, costs, strict=True)},
        feasible=search.best is not None,
        residual=residual,
        held=1.0 - price.unbalanced,
        rounds=search.round,
        runs=len(search.history),
        history=search.history,
        characteristic=CHARACTERISTIC[problem.site.run.characteristic],
        along=along,
        warnings=tuple(design_warnings(residual, 1.0 - price.unbalanced, search.reach, dominated, along)),
        dominated=tuple(rows),
    )
