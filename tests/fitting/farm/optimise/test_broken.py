"""Lines that break in windows: the link that is gone, and derivatives of what comes after."""

import numpy as np
import pytest

from dropper_jax import build, load_scene
from dropper_jax.base.errors import silent
from dropper_jax.statics.rest_problem import unbalanced
from fitting.farm.optimise.broken_link import link_of, with_link_mask
from fitting.farm.optimise.design import CHANGE
from fitting.farm.optimise.run import read_problem
from fitting.farm.optimise.values import Window
from fitting.farm.site import read_site

SITE = {
    "name": "broken",
    "scene": "looped-longline",
    "parameters": {"loops": 2, "loop_links": 2},
    "run": {"duration": 60.0, "seeds": 3, "skip": 15.0, "characteristic": "most_probable"},
    "sea_state": [{"name": "storm", "hs": 3.0, "tp": 9.0, "count": 20}],
    "cases": {"currents": [0.9], "states": ["intact", "west-leg"], "break_time": 30.0},
    "factors": {"intact": 1.67, "broken": 1.25},
    "part": [{"name": "lines", "lines": "*"}],
    "backbone": {"lines": "backbone", "deepest": 8.0},
    "variable": [
        {"name": "leg", "low": 55.0, "high": 80.0},
        {"name": "leg_diameter", "low": 0.01, "high": 0.05},
        {"name": "float_volume", "low": 0.05, "high": 0.3},
    ],
    "optimise": {"window": 45.0, "before": 30.0},
}


@pytest.mark.check
def test_a_link_that_is_gone_pulls_nothing_and_the_others_as_before():
    model, start = build(load_scene("looped-longline").with_values({"parameters.loops": 1, "parameters.loop_links": 2}))
    site = read_site(SITE)
    link = link_of(model, site.states[1])
    assert link == 5  # the sixth of the first line's ten
    plain, whole, gone = (
        unbalanced(m, start, 0 * start.r)[1] for m in (model, with_link_mask(model, None), with_link_mask(model, link))
    )
    assert plain[link] > 0.0
    np.testing.assert_array_equal(whole, plain)
    np.testing.assert_array_equal(gone, np.where(np.arange(len(plain)) == link, 0.0, plain))


@pytest.mark.check
@pytest.mark.parametrize("broken", [False, True])
def test_slopes_of_windows_are_those_of_designs_built_and_brought_to_rest_again(broken):
    """Those take steps of their own; at accuracy 0.01 they change slopes by 9 % where ropes snap after a break."""
    run = {**SITE["run"], "accuracy": 1e-4}
    design = read_problem(read_site({**SITE, "run": run, "optimise": {"window": 18.0, "before": 15.0}}))
    case = next(case for case in design.cases if (case.storm.broken is not None) == broken)

    def peaks(x, height=None):
        return design.window(x, Window(case, 0.0, np.ones(len(design.quantities[case.storm.kind])), height))

    found = peaks(design.start)
    (slopes,) = design.slopes([found], silent)
    spans = np.array([variable.span for variable in design.variables])
    by_range = []
    for change in np.diag(CHANGE * spans):
        ends = [peaks(design.start + sign * change, height=found.hard).soft for sign in (1.0, -1.0)]
        by_range.append((ends[0] - ends[1]) / (2.0 * CHANGE))
    slopes = slopes[:, : len(spans)] * spans
    np.testing.assert_allclose(np.transpose(by_range), slopes, rtol=0.02, atol=0.01 * np.max(np.abs(slopes)))
