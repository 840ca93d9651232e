"""SITE.toml: what is read, which cases come of it, and what is refused before anything runs."""

import copy
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError
from fitting.farm.site import read_site
from fitting.farm.site.case import name_waters

SITE = {
    "scene": "dropper-farm",
    "parameters": {"droppers": 2, "depth": 25.0},
    "run": {"duration": 60.0, "seeds": 2, "first_seed": 5, "skip": 20.0, "dt": 0.05},
    "sea_state": [
        {"name": "storm", "hs": 4.2, "tp": 9.5},
        {"name": "swell", "hs": 1.5, "tp": 12.0, "hours": 300.0},
    ],
    "cases": {
        "directions": [0.0, 90.0],
        "currents": [0.0, 0.9],
        "levels": [-1.0, 1.0],
        "months": ["may", "september"],
        "states": ["intact", "*-leg", "backbone:1"],
    },
    "growth": [
        {"month": "may", "lines": "dropper-*", "depth": [0.0, 10.0], "thickness": [0.02, 0.01], "density": 1100.0},
        {"month": "september", "lines": "dropper-1", "depth": [0.0], "thickness": [0.04], "density": 1100.0},
    ],
    "factors": {"intact": 1.67, "broken": 1.25},
    "part": [
        {"name": "loops", "lines": "dropper-*", "capacity": 2e4, "curve": {"k": 1e3, "m": 3.0}},
        {"name": "legs", "lines": ["west-leg", "east-leg"], "capacity": 2e5},
        {"name": "backbone", "lines": "backbone", "capacity": 1e5, "factor": 2.0},
    ],
    "anchor": [{"points": "*-anchor", "capacity": 8e4, "uplift": 10.0}],
    "exclusion": {"excursion": 25.0},
    "variable": [{"anything": 1}],
}


@pytest.fixture(scope="module")
def site():
    return read_site(SITE)


def changed(**sections):
    return {**copy.deepcopy(SITE), **sections}


def test_cases_are_every_combination_with_every_seed(site):
    # 2 seas, 2 directions, 2 currents, 2 levels, 2 months; intact, two legs and the backbone broken
    assert len(site.storms) == 2 * 2 * 2 * 2 * 2 * 4
    assert len(site.cases) == 2 * len(site.storms)
    labels = {storm.name for storm in site.storms}
    assert len(labels) == len(site.storms)
    assert "swell, 90 deg, 0.9 m/s, level -1 m, september, west-leg broken" in labels
    assert {case.seed for case in site.cases} == {5, 6}
    assert site.scene.sea.depth == 25.0  # a parameter of the template reached the scene


def test_equilibria_that_differ_have_different_names(site):
    storms = list({storm.still: storm for storm in site.storms}.values())
    assert len(storms) == 2 * 2 * 2 * 2  # directions of the current with the waves, speeds, levels, months
    names = name_waters(storms)
    assert len(set(names)) == len(names)
    assert "0.9 m/s level -1 m 90 deg september" in names
    assert name_waters(storms[:1]) == ["0 m/s level -1 m"]


def test_a_case_changes_what_it_names_and_nothing_else(site):
    base = site.prepared()
    name = "storm, 90 deg, 0.9 m/s, level +1 m, september, backbone broken"
    case = next(case for case in site.cases if (case.storm.name, case.seed) == (name, 6))
    scene = base.with_values(site.changes(case))
    assert (scene.sea.waves.hs, scene.sea.waves.seed) == (4.2, 6)
    np.testing.assert_allclose([scene.sea.waves.direction, scene.sea.current.direction], np.pi / 2)
    assert (scene.sea.current.speed, scene.sea.current.kind) == (0.9, "power")  # the profile is the scene's
    assert scene.sea.level.offset == 1.0
    growth = {line.name: line.growth for line in scene.lines if line.growth is not None}
    assert growth["dropper-1"].thickness.tolist() == [0.04]
    assert growth["dropper-2"].thickness.tolist() == [0.0]  # no mussels on it in september
    broken = [(f.line, f.link, f.time) for f in scene.failures if f.time < 1e6]
    assert broken == [("backbone-1", 1, 40.0)]  # halfway between the 20 s that do not count and the end
    assert (scene.run.dt, scene.run.duration) == (0.05, 60.0)
    assert scene.sea.ramp == site.ramp == 20.0
    assert read_site(changed(set={"sea.ramp": 7.0})).ramp == 7.0  # the scene's own


def test_a_break_without_a_link_is_in_the_middle_of_the_line(site):
    west = next(state for state in site.states if state is not None and state.name == "west-leg")
    assert (west.line, west.link) == ("west-leg", 9)  # of 17


def test_states_of_several_links_of_a_line_are_named_by_line_and_link():
    states = read_site(changed(cases={"states": ["intact", "west-leg:3", "west-leg:5", "east-leg:2"]})).states
    assert [state and state.name for state in states] == [None, "west-leg:3", "west-leg:5", "east-leg"]


def test_parts_take_capacity_and_factor_of_their_own_or_of_the_tables(site):
    loops, legs, backbone = site.parts
    assert loops.lines == ("dropper-1", "dropper-2")
    assert loops.factors.by_kind == {"intact": 1.67, "broken": 1.25}
    assert backbone.factors.by_kind == {"intact": 2.0, "broken": 2.0}
    assert (loops.curve.m, legs.curve) == (3.0, None)
    assert site.anchors[0].points == ("west-anchor", "east-anchor")
    assert site.anchors[0].table.utilisation(np.array(3e4), np.array(4e4)) == 5e4 / 8e4
    assert site.raw == {"variable": [{"anything": 1}]}


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        (
            {"sea_state": [{"name": n, "hs": 1.0, "tp": 6.0, "hours": 5000.0} for n in ("calm", "swell")]},
            "sea_state.hours: 10000.0 of all sea states is more than a year; allowed: <= 8766 h",
        ),
        ({"seastate": []}, "seastate: unknown key; did you mean 'sea_state'?"),
        ({"scene": "dropper-fram"}, "is not a packaged scene; did you mean 'dropper-farm'?"),
        ({"parameters": {"dropers": 2}}, "parameters.dropers: unknown parameter; did you mean 'droppers'?"),
        ({"sea_state": []}, "sea_state: missing"),
        (
            {"part": [{"name": "none", "lines": [], "capacity": 1e4}]},
            "part.0.lines: [] is empty; allowed: at least",
        ),
        ({"anchor": [{"points": [], "capacity": 1e4}]}, "anchor.0.points: [] is empty"),
        ({"exclusion": {"excursion": 3.0, "lines": []}}, "exclusion.lines: [] is empty"),
        ({"backbone": {"lines": []}}, "backbone.lines: [] is empty"),
        ({"sea_state": [{"name": "a", "hs": 2.0, "tp": 7.0}] * 2}, "sea_state: 'a' is used twice"),
        ({"sea_state": [{"name": "a", "hs": 16.0, "tp": 19.0}]}, "'a' of 16 m breaks; allowed: at most 14.4 m"),
        ({"sea_state": [{"name": "a", "hs": 4.2, "tp": 5.0}]}, "'a' of 4.2 m breaks; allowed: at most 2"),
        ({"cases": {"states": ["intact", "leg"]}}, "cases.states.1: 'leg' matches no line; "),
        ({"cases": {"states": ["west-leg", "west-*"]}}, "cases.states: 'west-leg' is given twice"),
        ({"cases": {"states": ["west-leg:18"]}}, "is not a link of it; allowed: west-leg:1 to west-leg:17"),
        ({"cases": {"states": ["west-leg"], "break_time": 10.0}}, "cases.break_time: 10.0 is outside the counted part"),
        ({"cases": {"levels": [-30.0]}}, "cases.levels: -30 m is below the seabed"),
        ({"cases": {"directions": []}}, "cases.directions: [] is empty"),
        ({"cases": {"directions": [0.0, 90.0, 360.0]}}, "cases.directions: [0.0, 90.0, 360.0] has a duplicate value"),
        ({"cases": {"directions": [-90.0, 270.0]}}, "cases.directions: [-90.0, 270.0] has a duplicate value"),
        ({"cases": {"currents": [{"speed": 1.0}, 1.0]}}, "cases.currents: ['1 m/s', '1 m/s'] has a duplicate current"),
        ({"cases": {"months": ["june"]}}, "cases.months.0: 'june' is unknown; known: may, september"),
        ({"growth": [], "cases": {"months": ["june"]}}, "growth: missing; needed: june, named in cases.months"),
        ({"crop": {"line_type.sock.mass": [-26.0, 17.0, 21.8]}}, "line_type.sock.mass: -26.0 is out of range"),
        ({"crop": {"line_type.sock.mass": [17.0, 26.0, 21.8]}}, "[17.0, 26.0, 21.8]; allowed: low <= expected <= high"),
        ({"cases": {"currents": [0.5, {"speed": 1.0, "direction": "x"}]}}, "1 m/s: sea.current.direction: 'x' is"),
        ({"part": SITE["part"][:2]}, "part: no part has the lines backbone"),
        ({"part": [*SITE["part"], {"name": "x", "lines": "chain*"}]}, "part.3.lines: 'chain*' matches no line"),
        ({"part": [*SITE["part"], {"name": "x", "lines": "*-2", "capacity": 1.0}]}, "'dropper-2' already belongs to"),
        ({"part": [{"name": "all", "lines": "*"}]}, "part.0.capacity: missing; needed: the breaking load [N] of 'all'"),
        ({"part": [{"name": "all", "lines": "*", "capacity": -1.0}]}, "part.0.capacity: -1.0 is out of range"),
        ({"factors": {"intact": 1.67}}, "missing; needed: a number, or `broken` in [factors]"),
        ({"anchor": [{"points": "anchor", "capacity": 1e4}]}, "anchor.0.points: 'anchor' matches no fixed point"),
        ({"anchor": [{"points": "*-anchor"}]}, "anchor.0.capacity: missing; kind 'tested' takes capacity"),
        ({"growth": [SITE["growth"][0]] * 2 + SITE["growth"][1:]}, "already has mussels in this month"),
        ({"run": {"duration": 30.0, "skip": 30.0}}, "run.skip: 30.0 covers the whole run"),
        ({"run": {"duration": 600.0, "dt": 0.0}}, "run.dt: 0.0 is out of range"),
        ({"backbone": {"lines": "backbone", "shallowest": 5.0, "deepest": 2.0}}, "backbone.deepest: 2.0 is not below"),
        ({"season": {"points": "buoy-*", "volume": 0.1}}, "season.points: 'buoy-*' matches no free point"),
    ],
)
def test_invalid_input_is_named_before_anything_runs(sections, message, refusal):
    assert message in refusal(read_site, changed(**sections))


def test_the_packaged_site_and_the_one_of_the_documentation_can_be_read():
    example = read_site("exposed-bay")
    assert (len(example.storms), len(example.cases)) == (8, 24)
    page = (Path(__file__).parents[4] / "docs" / "farms.md").read_text()
    example = tomllib.loads(re.search(r"^```toml\n(.*?)^```", page, re.M | re.S)[1])
    site = read_site({**example, "scene": "dropper-farm"})
    # two directions, currents and levels; intact, a leg and six droppers that break
    assert len(site.storms) == 2 * 2 * 2 * (1 + 1 + 6)
    assert (site.scene.sea.density, site.parts[0].curve.m) == (1027.0, 5.2)


def test_a_site_that_was_made_portable_is_the_same_site(site):
    again = read_site(json.loads(json.dumps(site.portable())))
    assert [storm.name for storm in again.storms] == [storm.name for storm in site.storms]
    here, there = (s.prepared().with_values(s.changes(s.cases[-1])).to_dict() for s in (site, again))
    assert here == there


def test_a_scene_is_found_next_to_its_site(tmp_path):
    (tmp_path / "farm.toml").write_text(
        'name = "bay"\n[run]\ndt = 0.02\nduration = 1.0\n'
        '[[line_type]]\nname = "rope"\nmass = 1.0\ndiameter = 0.03\nEA = 1e5\n'
        "cdn = 1.2\ncdt = 0.02\nbreaking_load = 3e4\n"
        '[[point]]\nname = "a"\nposition = [0.0, 0.0, -9.0]\n[[point]]\nname = "b"\nposition = [0.0, 0.0, 0.0]\n'
        '[[line]]\nname = "leg"\nfrom = "a"\nto = "b"\ntype = "rope"\nlength = 10.0\nlinks = 4\n'
        "[sea]\ndepth = 9.0\n[effects.weight]\n[effects.buoyancy]\n[effects.morison_drag]\n"
    )
    (tmp_path / "SITE.toml").write_text(
        'scene = "farm.toml"\n[set]\nsea.depth = 10.0\n[run]\nduration = 100.0\n[factors]\nintact = 2.0\n'
        '[[sea_state]]\nname = "calm"\nhs = 0.0\ntp = 5.0\n[[part]]\nname = "leg"\nlines = "leg"\n'
    )
    site = read_site(tmp_path / "SITE.toml")
    assert (site.name, site.scene.name, site.scene.sea.depth) == ("SITE", "bay", 10.0)
    assert site.parts[0].capacity.tolist() == [3e4]  # the scene's own
    with pytest.raises(SceneError, match="cannot read"):
        read_site(tmp_path / "sight.toml")


def test_a_standard_by_name_gives_factors_with_edition_and_clause():
    own = {"standard": "dnv-os-e301-class-2"}
    site = read_site(changed(factors=own))
    loops, _, backbone = (part.factors for part in site.parts)
    # 2.10 and 1.25 on the tension, 0.95 of the breaking load as strength
    assert loops.intact == pytest.approx(2.10 / 0.95, abs=5e-4)
    assert loops.broken == pytest.approx(1.25 / 0.95, abs=5e-4)
    assert loops.edition == "October 2008"
    assert "Table D1" in loops.clause
    assert "to be checked by you" in loops.checked
    assert (backbone.intact, backbone.source) == (2.0, "not given: check against your standard")
    parts = copy.deepcopy(SITE["part"])
    parts[0]["factor"] = "ns-9415-rope"
    rope = read_site(changed(factors={**own, "broken": 2.0}, part=parts)).parts
    assert rope[0].factors.by_kind == {"intact": 3.45, "broken": 1.5}
    assert "broken: given for this site" in rope[1].factors.source


def test_a_number_that_a_standard_lacks_is_asked_for_or_named_with_its_own_source():
    with pytest.raises(SceneError, match="factors.standard: 'api' is unknown.*api-rp-2sk"):
        read_site(changed(factors={"standard": "api"}))
    with pytest.raises(SceneError, match="factor: missing; needed: a number"):
        read_site(changed(factors={"standard": "scottish-technical-standard"}))
    parts = copy.deepcopy(SITE["part"])
    parts[1]["factor"] = "ns-9415-chain"
    legs = read_site(changed(factors={"standard": "api-rp-2sk"}, part=parts)).parts[1].factors
    assert (legs.intact, legs.broken) == (2.3, 1.25)
    assert "broken: API RP 2SK" in legs.source


def rare(hs, tp, speed, years):
    """A sea state and a current of a return period."""
    sea = {"name": f"{years} years", "hs": hs, "tp": tp, "return_period": years}
    return sea, {"name": f"{speed} m/s", "speed": speed, "return_period": years}


SEAS, CURRENTS = map(list, zip(rare(2.5, 8.0, 0.5, 10), rare(3.5, 9.5, 0.9, 50), strict=True))


def test_a_standard_takes_its_pairs_of_return_periods_and_leaves_the_others_out():
    cases = {"standard": "ns-9415", "currents": CURRENTS, "states": ["intact", "west-leg"]}
    found = read_site(changed(sea_state=SEAS, cases=cases))
    assert [(s.sea_state.name, s.current_name, s.state) for s in found.storms] == [
        ("10 years", "0.9 m/s", "intact"),
        ("10 years", "0.9 m/s", "west-leg"),
        ("50 years", "0.5 m/s", "intact"),
        ("50 years", "0.5 m/s", "west-leg"),
    ]
    assert [s.number for s in found.storms] == [0, 1, 2, 3]
    assert found.lists.standard["edition"] == "2009"
    assert "return_period" not in found.storms[0].current
    own = read_site(changed(sea_state=SEAS, cases={**cases, "pairs": [[50, 50]]}))
    assert [s.periods for s in own.storms] == 2 * [("50", "50")]
    assert own.lists.standard["source"].endswith("pairs: given for this site")


def test_what_occurs_together_with_the_other_of_a_pair_is_associated():
    seas = [{**SEAS[0], "return_period": "associated"}, {**SEAS[1], "return_period": 100}]
    currents = [{**CURRENTS[0], "return_period": "associated"}, {**CURRENTS[1], "return_period": 100}]
    found = read_site(changed(sea_state=seas, cases={"standard": "api-rp-2sk", "currents": currents}))
    assert [s.periods for s in found.storms] == [("associated", "100"), ("100", "associated")]


@pytest.mark.parametrize(
    ("cases", "message"),
    [
        ({"standard": "ns-9415", "currents": CURRENTS[:1]}, "cases.pairs: waves of 10, current of 50 years: missing"),
        ({"standard": "ns-9416", "currents": CURRENTS}, "'ns-9416' is unknown; did you mean 'ns-9415'"),
        ({"standard": "scottish-technical-standard"}, "are not known here. Use `pairs`"),
        ({"pairs": []}, r"cases.pairs: \[\] is empty; allowed: pairs of return periods"),
        ({"pairs": [[50]]}, "cases.pairs.0: .* has 1 entries"),
        ({"pairs": [[50, -1.0]]}, "cases.pairs.0: -1.0 is out of range; allowed: years"),
    ],
)
def test_return_periods_that_are_missing_or_wrong_are_named(cases, message):
    with pytest.raises(SceneError, match=message):
        read_site(changed(sea_state=SEAS, cases=cases))


def test_load_cases_carry_a_crop_with_its_spread():
    crop = {"line_type": {"sock": {"cdn": [1.0, 1.4, 3.9]}}, "growth": [0.8, 1.0, 1.25]}
    cases = {"months": ["may"], "currents": [0.9]}
    found = read_site(changed(crop=crop, cases=cases))
    assert [s.crop for s in found.storms] == 2 * ["low", "expected", "high"]
    assert len({s.still for s in found.storms}) == 3
    for storm, drag, share in zip(found.storms, 2 * [1.0, 1.4, 3.9], 2 * [0.8, 1.0, 1.25], strict=True):
        changes = found.still_changes(storm)
        assert changes["line_type.sock.cdn"] == drag
        assert changes["line.dropper-1.growth.thickness"] == [0.02 * share, 0.01 * share]
        assert storm.name.endswith(f"may, crop {storm.crop}")
    heavy = read_site(changed(crop=crop, cases={**cases, "crops": ["high"]}))
    assert [s.crop for s in heavy.storms] == 2 * ["high"]
    with pytest.raises(SceneError, match="cases.crops.0: 'heavy' is unknown"):
        read_site(changed(crop=crop, cases={**cases, "crops": ["heavy"]}))
    with pytest.raises(SceneError, match=r"crop.growth: \[1.0\] has 1 entries; allowed: three numbers"):
        read_site(changed(crop={"growth": [1.0]}))
