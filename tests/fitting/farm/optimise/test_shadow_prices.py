"""Prices of constraints at designs whose Lagrange multipliers are known, and against designs that are sought again."""

from dataclasses import replace

import numpy as np
import pytest

from dropper_jax.base.progress import silent
from fitting.farm.optimise.calm_model import ASSUMPTIONS
from fitting.farm.optimise.run import read_problem
from fitting.farm.optimise.search_round import run_round
from fitting.farm.optimise.search_state import Search
from fitting.farm.optimise.shadow_prices import shadow_prices
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import bounds
from fitting.farm.site import read_site

FREE = np.zeros(2, bool)
LOW, HIGH = np.full(2, -2.0), np.full(2, 2.0)


def circle(angle, limit=1.0):
    """min -x - y within x^2 + y^2 <= 2 limit, on the circle: the best is -2 sqrt(limit), at 45 degrees."""
    x = np.sqrt(2 * limit) * np.array([np.cos(angle), np.sin(angle)])
    return x, Values(-x.sum(), -np.ones(2), ("circle",), np.array([x @ x / 2]), x[None])


def test_the_shadow_price_of_a_curved_constraint_is_the_slope_of_its_optimum():
    x, values = circle(np.pi / 4)
    found = shadow_prices(values, x, LOW, HIGH, FREE, limit=1.0)
    # d(-2 sqrt(limit))/d limit = -1; a linear programme in a box would have one variable at the box's wall
    np.testing.assert_allclose([found.by_constraint[0], found.unbalanced], [1.0, 0.0], atol=1e-12)


def test_a_design_that_is_no_optimum_is_reported():
    x, values = circle(np.pi / 4 + 0.3)
    found = shadow_prices(values, x, LOW, HIGH, FREE, limit=1.0)
    np.testing.assert_allclose(found.unbalanced, np.sin(0.3), rtol=1e-9)  # what of the slope lies along the circle


def test_bounds_hold_what_constraints_do_not():
    # min -x - 3 y, x at its bound, x + y <= 1: the constraint's price is that of y alone
    values = Values(0.0, np.array([-1.0, -3.0]), ("sum",), np.array([1.0]), np.ones((1, 2)))
    found = shadow_prices(values, np.array([-2.0, 3.0]), LOW, np.array([2.0, 9.0]), FREE, limit=1.0)
    np.testing.assert_allclose([found.by_constraint[0], found.unbalanced], [3.0, 0.0], atol=1e-12)


def test_sizes_of_a_catalogue_stay_and_idle_constraints_cost_nothing():
    values = Values(0.0, np.array([-1.0, -4.0]), ("a", "b"), np.array([1.0, 0.5]), np.array([[2.0, 9.0], [1.0, 1.0]]))
    found = shadow_prices(values, np.zeros(2), LOW, HIGH, np.array([False, True]), limit=1.0)
    np.testing.assert_allclose([*found.by_constraint, found.unbalanced], [0.5, 0.0, 0.0], atol=1e-12)


SITE = {
    "name": "small",
    "scene": "looped-longline",
    "parameters": {"loops": 2, "loop_links": 2, "leg_diameter": 0.010, "backbone_diameter": 0.020},
    "run": {"duration": 45.0, "seeds": 1, "skip": 15.0},
    "sea_state": [{"name": "storm", "hs": 3.0, "tp": 9.0, "count": 20}],
    "cases": {"currents": [0.9]},
    "factors": {"intact": 3.0},
    "part": [{"name": "legs", "lines": "*-leg"}, {"name": "rest", "lines": ["backbone", "loop-*"]}],
    "backbone": {"lines": "backbone", "deepest": 6.0},
    "objective": {"float_price": 5.0},
    "variable": [
        {"name": "leg_diameter", "low": 0.006, "high": 0.03},
        {"name": "float_volume", "low": 0.03, "high": 0.3},
        {"name": "leg", "low": 60.0, "high": 75.0},
    ],
    "optimise": {"window": 36.0, "before": 20.0, "renew": 15, "enough": 1e-4},
}


def best(site, windows, x, margin=0.01):
    """The best design by windows that stay as they are, and its values."""
    design = read_problem(site)
    design.settings = replace(design.settings, margin=margin)
    own = [replace(w, case=case) for w, case in zip(windows, design.cases, strict=True)]
    search = Search(np.array(x), 0.05, scale=1.0)
    run_round(search, design, own, lambda: None, silent)
    runs = design.run_windows(search.x, own, silent)
    return design, search.x, design.values(design.differentiate(runs, silent, assumptions=True))


@pytest.mark.check
def test_prices_of_limits_and_assumptions_are_those_of_designs_optimised_again():
    site = read_site(SITE)
    start = read_problem(site)
    windows, _ = start.measure(start.start, silent)
    design, x, values = best(site, windows, start.start)
    found = shadow_prices(values, x, *bounds(design.variables), np.zeros(len(x), bool), 0.99)
    assert found.unbalanced < 0.1
    predicted = {"limits": -0.01 * found.by_constraint.sum()}
    costs = values.slope[len(x) :] + found.by_constraint @ values.slopes[:, len(x) :]
    predicted |= {name: 0.01 * cost for name, cost in zip(ASSUMPTIONS, costs, strict=True)}
    moved = {
        "limits": (site, 0.0),
        "wave height": (read_site({**SITE, "sea_state": [{**SITE["sea_state"][0], "hs": 3.03}]}), 0.01),
        "current": (read_site({**SITE, "cases": {"currents": [0.909]}}), 0.01),
    }
    for name, (other, margin) in moved.items():
        _, _, there = best(other, windows, x, margin)
        change = there.objective - values.objective
        assert change == pytest.approx(predicted[name], rel=0.2), (name, change, predicted[name])
