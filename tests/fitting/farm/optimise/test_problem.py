"""Design problems: what is read and refused, slopes of models and of poses, the linear programme."""

import copy
import json
from dataclasses import asdict

import numpy as np
import pytest

from dropper_jax import SceneError, build, build_model, load_scene, packaged_scene
from dropper_jax.base.json_values import jsonable
from dropper_jax.base.progress import silent
from dropper_jax.quantities.end_forces import fixed_point_loads
from dropper_jax.scene import line_slices
from dropper_jax.statics.rest_problem import unbalanced
from dropper_jax.study.gradient_check import GradientCheck
from fitting.farm.optimise.broken_link import link_of, with_link_mask
from fitting.farm.optimise.calm_model import build_calm_model, differentiate_calm_model
from fitting.farm.optimise.equilibria import find_equilibrium, find_equilibrium_slopes
from fitting.farm.optimise.programme import solve_programme
from fitting.farm.optimise.quantities import Steps
from fitting.farm.optimise.read_goals import read_goals
from fitting.farm.optimise.run import optimise, read_problem
from fitting.farm.optimise.search_state import Search
from fitting.farm.optimise.storm_runs import WINDOW_DIFFERENCE_STEP, StormRuns
from fitting.farm.optimise.values import Values
from fitting.farm.optimise.variables import read_variables
from fitting.farm.optimise.window_peaks import Peaks, check_windows
from fitting.farm.optimise.windows import Window, WindowRuns
from fitting.farm.site import read_site

LOOPS = packaged_scene("looped-longline")
SITE = {
    "scene": "looped-longline",
    "parameters": {"loops": 2, "loop_links": 2},
    "run": {"duration": 60.0, "seeds": 1, "skip": 15.0},
    "sea_state": [{"name": "storm", "hs": 3.0, "tp": 9.0, "count": 20}],
    "cases": {"currents": [0.9]},
    "factors": {"intact": 1.67},
    "part": [{"name": "lines", "lines": "*"}],
    "backbone": {"lines": "backbone", "deepest": 8.0},
    "variable": [
        {"name": "leg", "low": 55.0, "high": 80.0},
        {"name": "leg_diameter", "low": 0.01, "high": 0.05, "catalogue": [0.012, 0.02, 0.04]},
        {"name": "float_volume", "low": 0.05, "high": 0.3},
    ],
}


@pytest.fixture(scope="module")
def site():
    return read_site(SITE)


def changed(**sections):
    return read_site({**copy.deepcopy(SITE), **sections})


def test_variables_are_parameters_with_bounds_and_neighbouring_sizes(site):
    leg, diameter, _ = read_variables(site.raw["variable"], site.scene)
    assert (leg.path, leg.value, leg.span) == ("parameters.leg", 60.0, 25.0)
    assert diameter.sizes(0.025) == (0.02, 0.04)
    assert diameter.sizes(0.045) == (0.04,)
    assert leg.sizes(61.5) == (61.5,)


def variable(name, low, high, **more):
    return {"variable": [{"name": name, "low": low, "high": high, **more}]}


def constraint(kind, **more):
    return {"constraint": [{"kind": kind, **more}]}


HEMP = {**LOOPS, "line": [{**row, "type": "library:rope-hemp-0.03"} for row in LOOPS["line"]]}


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        (variable("legg", 1.0, 2.0), "legg.*did you mean.*leg"),
        (variable("leg", 60.0, 60.0), "variable.0.high.*leaves an empty interval"),
        (variable("leg", 61.0, 80.0), "leave out the scene's 60"),
        (variable("backbone_length", 1.0, 9.0), "follows from others"),
        ({"variable": [SITE["variable"][0]] * 2}, "is a duplicate"),
        (variable("leg", 55.0, 80.0, catalogue=[90.0]), "catalogue.0.*out of bounds"),
        ({"variable": []}, "variable: none is given"),
        ({"objective": {"of": "load", "part": "line"}}, "objective.part.*'line' is unknown"),
        ({"objective": {"of": "beauty"}}, "objective.of.*'beauty' is unknown"),
        ({"objective": {"part": "legs"}}, "objective.part: is not used to minimise 'material'"),
        ({"objective": {"of": "load", "lines": "leg*"}}, "objective.lines: is not used to minimise 'load'"),
        (
            constraint("depth", points="p*", shallowest=5.0, deepest=4.0),
            "constraint.0.deepest: 4 m contradicts shallow",
        ),
        # backbone.deepest is 8 m
        (
            constraint("depth", points="p1", shallowest=8.5),
            "depth 0 shallowest of 8.5 m contradicts backbone deepest of 8",
        ),
        (constraint("price"), "constraint.0.kind.*'price' is unknown"),
        (constraint("clearance", lines=[], minimum=1.0), r"constraint.0.lines: \[\] is empty; allowed: at least one"),
        (constraint("motion", lines=[], maximum=1.0), r"constraint.0.lines: \[\] is empty"),
        ({"objective": {"of": "motion", "lines": []}}, r"objective.lines: \[\] is empty"),
        (constraint("quantity", of="tension.leg.max", most=1.0), "constraint.0.most: unknown key"),
        (constraint("depth", points="q*", deepest=4.0), "'q.' matches no free point"),
        ({"scene": HEMP}, "line.0.type: library: 'rope-hemp-0.03' is unknown"),
        ({"sea_state": [{"name": "storm", "hs": 16.0, "tp": 9.5}]}, "sea_state.0.hs: 'storm' of 16 m breaks"),
        ({"optimise": {"before": 5.0}}, "optimise.before: 5 s"),
        ({"run": {**SITE["run"], "characteristic": "most_probable"}}, "run.seeds: 1 for the most probable"),
        ({"cases": {"states": ["west-leg"]}, "factors": {"broken": 1.25}}, "cases.states: must include 'intact'"),
        # the scene's own current is not that of the cases
        (
            {"variable": [*SITE["variable"], *variable("current", 0.5, 1.5)["variable"]]},
            "variable: 'current' moves nothing",
        ),
    ],
)
def test_a_bad_problem_is_refused_before_anything_runs(sections, message):
    with pytest.raises(SceneError, match=message):
        read_problem(changed(**sections))


def first_model(own):
    """The model of a site's first load case at rest, with its variables at their start."""
    variables = read_variables(own.raw["variable"], own.scene)
    return build_calm_model(own, variables, np.array([v.value for v in variables]), own.cases[0].storm)


@pytest.mark.parametrize(("height", "met"), [(-0.2, True), (0.4, True), (0.7, False)])
def test_a_point_may_be_allowed_above_the_water(height, met):
    """A bound of -0.5 m allows half a metre above the water's level."""
    own = changed(**constraint("depth", points="p1", shallowest=-0.5))
    model = first_model(own)
    r = np.full((model.free_nodes, 3), height)
    (bound,) = read_goals(own).depths[-1].utilisations(model, r, np.zeros((3, *r.shape)), 0.0)
    assert (bound.value <= 1.0) == met


def droppers(*ends, links=1):
    """A site of lines that hang 2 m apart from fixed points, from each to the point of the same number in `ends`."""
    names = [f"dropper-{i}" for i in range(len(ends))]
    points = [{"name": f"top-{i}", "position": [2.0 * i, 0.0, -1.0]} for i in range(len(ends))]
    for name in dict.fromkeys(ends):
        points.append({"name": name, "kind": "free", "position": [0.0, 0.0, -4.0], "mass": 9.0, "volume": 0.002})
    rope = {"name": "rope", "mass": 1.2, "diameter": 0.03, "EA": 5e4, "breaking_load": 9e3, "cdn": 1.2}
    lines = []
    for i, (name, end) in enumerate(zip(names, ends, strict=True)):
        lines.append({"name": name, "from": f"top-{i}", "to": end, "type": "rope", "length": 3.0, "links": links})
    scene = {
        "name": "droppers",
        "run": {"dt": 0.02, "duration": 1.0},
        "line_type": [rope],
        "point": points,
        "line": lines,
        "sea": {"depth": 10.0},
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
    }
    table = {key: SITE[key] for key in ("run", "sea_state", "cases", "factors", "part")}
    return read_site({**table, "scene": scene, **constraint("clearance", lines="*", minimum=0.5)})


@pytest.mark.parametrize("links", [1, 2])
def test_lines_of_one_link_keep_the_distance_of_their_free_ends(links):
    own = droppers("a", "b", "c", links=links)
    model = build_model(own.scene)
    r = np.zeros((1, model.free_nodes, 3))
    r[0, :, 0] = [*np.arange(3.0).repeat(links - 1), 0.0, 0.8, 2.0]  # inner nodes 1 m apart, then ends
    (signal,) = (one for one in read_goals(own).quantities(own, model) if one.name == "clearance 1")
    steps = Steps(r, np.zeros((1, model.line.links)), np.ones(1))
    assert 0.5 / np.max(signal.signal(model, steps)) == pytest.approx(0.8 if links == 1 else 1.0)


def test_lines_without_nodes_of_their_own_have_no_clearance():
    own = droppers("a", "a")
    with pytest.raises(
        SceneError, match=r"constraint.0.lines: 'dropper-0' and 'dropper-1' have no free nodes of their"
    ):
        read_goals(own).quantities(own, build_model(own.scene))


@pytest.mark.check
def test_a_constraint_may_limit_a_quantity_by_name():
    limits = {"tension.west-leg.fairlead.max": 2e4, "offset.p1.max": 5.0}
    rows = [{"kind": "quantity", "of": of, "maximum": most} for of, most in limits.items()]
    own = changed(constraint=rows, anchor=[{"points": "*", "capacity": 6e3}])
    model = first_model(own)
    pose = find_equilibrium(model, None)
    tension, offset = read_goals(own).quantities(own, model)[-2:]
    steps = Steps(pose.r[None], pose.tension[None], np.ones(1))
    leg = line_slices(own.scene)[0].links
    assert float(tension.signal(model, steps).max()) == pytest.approx(float(pose.tension[leg.stop - 1]) / 2e4)
    spec = next(point for point in own.scene.points if point.name == "p1")
    node = int(model.geometry.point_node[[p.name for p in model.points].index("p1")])
    moved = np.linalg.norm(np.asarray(pose.r)[node, :2] - np.asarray(spec.position)[:2])
    assert float(offset.signal(model, steps).max()) == pytest.approx(moved / 5.0)
    # the utilisation of a tested anchor is |load| times factor over capacity; other kinds have their own
    load = fixed_point_loads(own.scene, np.asarray(model.nodes(pose.r, model.ends(0.0))), np.asarray(pose.tension))
    x, y, up = load["west-anchor"]
    screw = {"kind": "screw", "plates": [0.3, 0.3], "depths": [2.0, 3.0], "strength": 5e4}  # 9 times that over its area
    expected = {
        np.linalg.norm([x, y, up]) / 6e3: {"capacity": 6e3},
        (np.hypot(x, y) / 0.5 + up) / 4e3: {"kind": "dead_weight", "weight": 4e3, "friction": 0.5},
        np.linalg.norm([x, y, up]) / (9 * 5e4 * 2 * np.pi * 0.15**2): screw,
        up / (9 * 5e4 * 2 * np.pi * 0.15**2) + np.hypot(x, y) / 3e3: {**screw, "lateral": 3e3},
    }
    for utilisation, kind in expected.items():
        own = changed(anchor=[{"points": "*", **kind}])
        anchor = next(q for q in read_goals(own).quantities(own, model) if q.name == "west-anchor")
        factor = own.anchors[0].factor["intact"]
        assert float(anchor.signal(model, steps).max()) == pytest.approx(utilisation * factor, rel=1e-6)
    for name, words in (("tension.west-lag.max", "did you mean 'west-leg'"), ("energy.max", "cannot be limited")):
        with pytest.raises(SceneError, match=words):
            read_goals(changed(constraint=[{"kind": "quantity", "of": name, "maximum": 1.0}]))


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("dropper-release-a", "a single line cannot be designed; allowed: systems of lines that join at points"),
        ("paper-case-2-pitching", "friction, bodies or effects with a state cannot be designed"),
    ],
)
def test_windows_of_models_that_are_not_nodes_and_ropes_are_refused(scene, message):
    with pytest.raises(SceneError, match=message):
        check_windows(build_model(load_scene(scene)))


@pytest.mark.check
def test_models_and_poses_follow_the_variables_as_differences_say(site):
    design = read_problem(site)
    case, x = design.cases[0], design.start
    found = differentiate_calm_model(site, design.variables, x, case.storm)
    own = find_equilibrium_slopes(found)
    for k, variable in enumerate(design.variables):
        step = np.zeros(len(x))
        step[k] = 1e-5 * variable.span
        ends = [build_calm_model(design.site, design.variables, x + s * step, case.storm) for s in (1.0, -1.0)]
        places = [find_equilibrium(model, own.state).r for model in ends]
        by = np.asarray(places[0] - places[1]) / (2 * step[k])
        np.testing.assert_allclose(own.dr[k], by, rtol=1e-4, atol=1e-5 * np.max(np.abs(by)))


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"site": "another", "along": GradientCheck.of(1.0, 1.0)._asdict()}, "belongs to another site"),
        ({"site": "another"}, "is not a state of a search"),
    ],
)
def test_a_state_of_another_search_is_refused(site, tmp_path, state, message):
    file = tmp_path / "state.json"
    file.write_text(json.dumps(jsonable({**state, **asdict(Search(np.zeros(3), 0.1))})))
    with pytest.raises(SceneError, match=message):
        optimise(site, file)


@pytest.mark.parametrize("text", ["[]", "null", "3", '"x"', '{"site": 1, "along": 3}', "{"])
def test_a_file_that_is_not_a_state_is_refused(site, tmp_path, text):
    file = tmp_path / "state.json"
    file.write_text(text)
    for given in (file, tmp_path):
        with pytest.raises(SceneError, match="is not a state of a search"):
            optimise(site, given)


def test_capacities_that_are_the_scene_s_follow_the_design():
    design = read_problem(changed(part=[{"name": "legs", "lines": "*-leg"}], unchecked=["loop-*", "backbone"]))
    value, slope = design.scene_constraints(design.start)
    # 1.1e8 d^2: twice the relative change of the diameter
    np.testing.assert_allclose([value[1], slope[1, 1] * design.start[1], slope[1, 0]], [1.0, 2.0, 0.0], atol=1e-6)
    legs = 2 * 500.0 * 0.04**2 * 60.0
    backbone, loop, floats = 500.0 * 0.036**2 * 6.6, 2 * 8.0 * 8.0, 3 * 80.0 * 0.13
    np.testing.assert_allclose(value[0], legs + backbone + loop + floats, rtol=1e-6)
    np.testing.assert_allclose(slope[0] * design.start, [legs, 2 * legs, floats], rtol=1e-4)


@pytest.mark.check
@pytest.mark.parametrize("characteristic", ["mean", "most_probable"])
def test_derivatives_of_a_constraint_are_the_mean_of_those_of_its_seeds(characteristic, monkeypatch):
    design = read_problem(changed(run={**SITE["run"], "seeds": 4, "characteristic": characteristic}))
    rng = np.random.default_rng(0)
    start = design.starts.at(design.start, design.cases[0].storm)
    count = len(design.quantities["intact"])
    hard = [rng.uniform(1.0, 2.0, count) for _ in design.cases]
    runs = WindowRuns(design.start, [np.ones(count) for _ in hard], [Peaks(peaks, peaks, None) for peaks in hard])
    slopes = [rng.standard_normal((count, start.rest.dr.shape[0])) for _ in hard]
    monkeypatch.setattr(StormRuns, "differentiate_peaks", lambda *_: slopes)
    found = design.values(design.storm_runs.differentiate(runs, silent))
    seeds = [found.by_seed[name] for name in found.names if name in found.by_seed]
    assert [rows.shape for rows in seeds] == [(4, found.slopes.shape[1])]
    np.testing.assert_allclose(seeds[0].mean(axis=0), found.slopes[0], rtol=1e-12)


def test_the_programme_finds_the_corner():
    # min x + y above x + 2 y >= 3, 2 x + y >= 3 from (2, 2): the corner (1, 1)
    values = Values(4.0, np.ones(2), ("a", "b"), np.array([-2.0, -2.0]), np.array([[-1.0, -2.0], [-2.0, -1.0]]))
    found = solve_programme(values, np.full(2, -2.0), np.full(2, 2.0), scale=4.0, limit=1.0)
    np.testing.assert_allclose([*found.step, found.objective, found.violation], [-1.0, -1.0, 2.0, 0.0], atol=1e-9)


#: A leg that breaks in half of the cases.
BROKEN = {
    "cases": {"currents": [0.9], "states": ["intact", "west-leg"], "break_time": 30.0},
    "factors": {"intact": 1.67, "broken": 1.25},
}


@pytest.mark.check
def test_a_link_that_is_gone_pulls_nothing_and_the_others_as_before():
    model, start = build(load_scene("looped-longline").with_values({"parameters.loops": 1, "parameters.loop_links": 2}))
    link = link_of(model, changed(**BROKEN).states[1])
    assert link == 5  # the sixth of the first line's ten
    models = model, with_link_mask(model, None), with_link_mask(model, link)
    plain, whole, gone = (unbalanced(each, start, 0 * start.r)[1] for each in models)
    assert plain[link] > 0.0
    np.testing.assert_array_equal(whole, plain)
    np.testing.assert_array_equal(gone, np.where(np.arange(len(plain)) == link, 0.0, plain))


@pytest.mark.check
@pytest.mark.parametrize("broken", [False, True])
def test_slopes_of_windows_are_those_of_designs_built_and_brought_to_rest_again(broken):
    """Those take steps of their own; at accuracy 0.01 they change slopes by 9 % where ropes snap after a break."""
    run = {**SITE["run"], "accuracy": 1e-4}
    design = read_problem(changed(**BROKEN, run=run, optimise={"window": 18.0, "before": 15.0}))
    case = next(case for case in design.cases if (case.storm.broken is not None) == broken)

    def peaks(x, height=None):
        return design.storm_runs.run_window(
            x, Window(case, 0.0, np.ones(len(design.quantities[case.storm.kind])), height)
        )

    found = peaks(design.start)
    (slopes,) = design.storm_runs.differentiate_peaks([found], silent)
    spans = np.array([variable.span for variable in design.variables])
    by_range = []
    for change in np.diag(WINDOW_DIFFERENCE_STEP * spans):
        ends = [peaks(design.start + sign * change, height=found.hard).soft for sign in (1.0, -1.0)]
        by_range.append((ends[0] - ends[1]) / (2.0 * WINDOW_DIFFERENCE_STEP))
    slopes = slopes[:, : len(spans)] * spans
    np.testing.assert_allclose(np.transpose(by_range), slopes, rtol=0.02, atol=0.01 * np.max(np.abs(slopes)))
