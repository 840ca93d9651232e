"""Lines that break in windows: the link that is gone, its derivatives, and whole runs beside those of load cases."""

import numpy as np
import pytest

from dropper_jax.load.source import load_scene
from dropper_jax.run.build import build
from dropper_jax.statics.system import unbalanced
from fitting.cases.one import Runner
from fitting.optimise.broken import link_of, masked
from fitting.optimise.run import checked, read_problem
from fitting.optimise.storms import full_storm
from fitting.optimise.values import Window
from fitting.site import read_site

SITE = {
    "name": "broken",
    "scene": "looped-longline",
    "parameters": {"loops": 2, "loop_links": 2},
    "run": {"duration": 40.0, "seeds": 1, "skip": 20.0},
    "sea_state": [{"name": "storm", "hs": 3.0, "tp": 9.0, "count": 20}],
    "cases": {"currents": [0.9], "states": ["intact", "west-leg:3"], "break_time": 20.0},
    "factors": {"intact": 1.67, "broken": 1.25},
    "part": [{"name": "legs", "lines": "*-leg"}, {"name": "rest", "lines": ["backbone", "loop-*"]}],
    "variable": [
        {"name": "leg_diameter", "low": 0.01, "high": 0.05},
        {"name": "float_volume", "low": 0.05, "high": 0.3},
    ],
    "optimise": {"window": 36.0, "before": 20.0},
}


def test_a_link_that_is_gone_pulls_nothing_and_the_others_as_before():
    model, start = build(load_scene("looped-longline").with_values({"parameters.loops": 1, "parameters.loop_links": 2}))
    site = read_site(SITE)
    link = link_of(model, site.states[1])
    assert link == 2  # the third link of the first line
    plain, whole, gone = (
        unbalanced(m, start, 0 * start.r)[1] for m in (model, masked(model, None), masked(model, link))
    )
    assert plain[link] > 0.0
    np.testing.assert_array_equal(whole, plain)
    np.testing.assert_array_equal(gone, np.where(np.arange(len(plain)) == link, 0.0, plain))


@pytest.mark.check
def test_windows_with_a_broken_leg_have_the_derivatives_of_differences():
    assert checked(read_problem(read_site(SITE))) < 1e-4


@pytest.mark.check
def test_whole_runs_with_a_broken_leg_are_those_of_load_cases():
    site = read_site(SITE)
    design, case = read_problem(site), site.cases[1]
    stand = design.stand(design.start, case, {})
    found = full_storm(site, site.scene, case, design.quantities(case, stand.still), stand.rest.state)
    run = Runner(site)(case)  # what counts begins with the break, in both
    links = {line.name: line.links for line in Runner(site).scene(case).lines}
    edges = np.cumsum([0, *links.values()])
    for q, part in enumerate(site.parts):
        capacity = dict(zip(part.lines, part.capacity, strict=True))
        used = [
            1.25 * run["largest"][a:b].max() / capacity[owner]
            for (name, _), a, b in zip(links.items(), edges, edges[1:], strict=False)
            for owner in part.lines
            if name == owner or name.startswith(f"{owner}-") and name.removeprefix(f"{owner}-").isdecimal()
        ]
        np.testing.assert_allclose(found.hard[q], max(used), rtol=1e-6)
    assert found.when[0] > 20.0
    # and the window has the blow of the break: its line is gone from the second third on
    window = Window(case, 8.0, np.ones(len(found.hard)), None)
    peaks = design.window(design.start, window, stand, slopes=False)
    assert peaks.solved
    assert np.all(peaks.when > 12.0)
