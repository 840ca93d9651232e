"""What an optimum says of its limits and assumptions, against designs that were sought anew."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.farm.optimise.models import ASSUMPTIONS
from fitting.farm.optimise.prices import prices
from fitting.farm.optimise.run import read_problem
from fitting.farm.optimise.search import Search, run_round
from fitting.farm.site import read_site

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


def silent(*_):
    pass


def best(site, windows, x, margin=0.01):
    """The best design by windows that stay as they are, and its values."""
    design = read_problem(site)
    design.settings = replace(design.settings, margin=margin)
    own = [replace(w, case=case) for w, case in zip(windows, design.cases, strict=True)]
    search = Search(np.array(x), 0.05, scale=1.0)
    run_round(search, design, own, lambda: None, silent)
    runs = design.run_windows(search.x, own, silent)
    return design, search.x, design.derivatives(runs, silent, assumptions=True)


@pytest.mark.check
def test_prices_of_limits_and_assumptions_are_those_of_designs_sought_anew():
    site = read_site(SITE)
    start = read_problem(site)
    windows, _ = start.measure(start.start, silent)
    design, x, values = best(site, windows, start.start)
    low, high = (np.array([getattr(v, key) for v in design.variables]) for key in ("low", "high"))
    found = prices(values, x, low, high, np.zeros(len(x), bool), 0.99)
    assert found.left < 0.1
    foretold = {"limits": -0.01 * found.of.sum()}
    costs = values.slope[len(x) :] + found.of @ values.slopes[:, len(x) :]
    foretold |= {name: 0.01 * cost for name, cost in zip(ASSUMPTIONS, costs, strict=True)}
    moved = {
        "limits": (site, 0.0),
        "wave height": (read_site({**SITE, "sea_state": [{**SITE["sea_state"][0], "hs": 3.03}]}), 0.01),
        "current": (read_site({**SITE, "cases": {"currents": [0.909]}}), 0.01),
    }
    for name, (other, margin) in moved.items():
        _, _, there = best(other, windows, x, margin)
        change = there.objective - values.objective
        assert change == pytest.approx(foretold[name], rel=0.2), (name, change, foretold[name])
