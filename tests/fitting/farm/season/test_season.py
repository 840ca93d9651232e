"""The season: what floats must carry against a hand calculation, and the schedule against every other one."""

import itertools
import math
import re

import numpy as np
import pytest

from dropper_jax import SceneError
from fitting.farm.season import float_schedule, plan_season, write_season
from fitting.farm.season.equilibria import list_waters, scene_at_rest
from fitting.farm.season.schedule import distribute_floats
from fitting.farm.season.season import double_crops
from fitting.farm.site import read_site

RHO, G = 1025.0, 9.81
#: Spacing of the floats [m], loops between them [m], wet ropes: mass [kg/m], diameter [m].
SPACING, LOOP = 5.0, 12.0
BACKBONE, SOCK = (1.0, 0.03), (0.8, 0.02)
THICKNESS, DENSITY = {"april": 0.01, "june": 0.03, "august": 0.05, "october": 0.02}, 1150.0
VOLUME, FOAM = 0.01, 80.0


def scene():
    """Five floats on a rope between two held ends, a loop from each to the next."""
    points = [{"name": name, "position": [x, 0.0, -4.0]} for name, x in (("west", 0.0), ("east", 6 * SPACING))]
    points += [
        {"name": f"f{k}", "kind": "free", "position": [k * SPACING, 0.0, -4.0], "mass": 5.0, "volume": 0.05}
        for k in range(1, 6)
    ]
    ends = ["west", *(f"f{k}" for k in range(1, 6)), "east"]
    lines = [
        {"name": f"back-{i}", "from": a, "to": b, "type": "backbone", "length": 1.01 * SPACING, "links": 2}
        for i, (a, b) in enumerate(itertools.pairwise(ends))
    ]
    lines += [
        {"name": f"loop-{k}", "from": f"f{k}", "to": f"f{k + 1}", "type": "sock", "length": LOOP, "links": 6}
        for k in range(1, 5)
    ]
    types = [
        {"name": n, "mass": m, "diameter": d, "EA": 1e5, "cdn": 1.2, "cdt": 0.02}
        for n, (m, d) in (("backbone", BACKBONE), ("sock", SOCK))
    ]
    return {
        "name": "row",
        "run": {"dt": 0.02, "duration": 1.0},
        "line_type": types,
        "point": points,
        "line": lines,
        "sea": {"depth": 20.0},
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
    }


def table(**season_values):
    growth = [
        {"month": month, "lines": "loop-*", "depth": [0.0], "thickness": [t], "density": DENSITY}
        for month, t in THICKNESS.items()
    ]
    return {
        "scene": scene(),
        "run": {"duration": 60.0},
        "sea_state": [{"name": "calm", "hs": 0.0, "tp": 5.0}],
        "factors": {"intact": 1.5},
        "part": [{"name": "all", "lines": "*", "capacity": 1e5}],
        "growth": growth,
        "backbone": {"lines": "back-*", "shallowest": 0.5, "deepest": 6.0},
        "season": {
            **{"points": "f*", "volume": VOLUME, "density": FOAM, "reserve": 1.2, "least_share": 0.5},
            **{"levels": [-1.0, 1.0], "currents": [0.0, 0.4], "start": 5},
            **season_values,
        },
    }


@pytest.fixture(scope="module")
def found():
    return plan_season(read_site(table()))


def wet(rope, thickness=0.0):
    """Weight in water per metre of a rope with a layer of mussels [N/m]."""
    mass, bare = rope
    whole = bare + 2 * thickness
    return G * (mass + DENSITY * math.pi / 4 * (whole**2 - bare**2) - RHO * math.pi / 4 * whole**2)


@pytest.mark.check
def test_floats_of_each_month_are_those_of_the_tributary_hand_calculation(found):
    """Each float carries a spacing of backbone and half a loop on either side; the outer ones half a loop in all."""
    lift = G * VOLUME * (RHO - FOAM)
    for row in found["months"]:
        loop = LOOP * wet(SOCK, THICKNESS[row["month"]])
        by_hand = np.full(5, 1.01 * SPACING * wet(BACKBONE)) + loop * np.array([0.5, 1.0, 1.0, 1.0, 0.5])
        still = by_hand.sum()
        np.testing.assert_allclose(row["need_n"], still, rtol=0.05)
        np.testing.assert_allclose(row["need_by_point_n"], by_hand, rtol=0.05)
        assert abs(row["least"] - 1.2 * still / lift) <= max(1.0, 0.05 * row["least"])
        np.testing.assert_allclose(row["mussels_wet_n"], 4 * loop, rtol=1e-9)


@pytest.mark.check
def test_the_schedule_holds_and_its_margins_are_those_of_its_poses(found):
    assert found["holds"]
    for row in found["months"]:
        assert row["least"] <= row["floats"] <= row["most"]
        assert sum(row["by_point"].values()) == row["floats"]
        assert len(row["poses"]) == 4  # two levels, two currents
        assert row["sinking_m"] == 6.0 - max(pose["deepest_m"] for pose in row["poses"])
        assert row["lifting_m"] == min(pose["shallowest_m"] for pose in row["poses"]) - 0.5
    floats = [5, *(row["floats"] for row in found["months"])]
    assert found["visits"] == sum(a != b for a, b in itertools.pairwise(floats))


@pytest.mark.check
def test_the_season_is_written_as_a_page_with_every_month(found, tmp_path):
    files = write_season(found, tmp_path)
    text = files["page"].read_text()
    assert all(f"| {month} |" in text for month in THICKNESS)
    assert len(files["csv"].read_text().splitlines()) == 1 + len(THICKNESS)


def cost(plan, start):
    steps = itertools.pairwise([*([] if start is None else [start]), *plan])
    moved = [abs(a - b) for a, b in steps]
    return sum(m > 0 for m in moved), sum(moved)


def test_no_other_schedule_has_fewer_visits_or_moves_fewer_floats():
    draw = np.random.default_rng(3)
    for _ in range(60):
        low = draw.integers(0, 5, 4)
        high = low + draw.integers(0, 4, 4)
        start = None if draw.random() < 0.3 else int(draw.integers(0, 8))
        plan = float_schedule(low.tolist(), high.tolist(), start)
        spans = [range(a, b + 1) for a, b in zip(low, high, strict=True)]
        assert all(n in span for n, span in zip(plan, spans, strict=True))
        assert cost(plan, start) == min(cost(p, start) for p in itertools.product(*spans))


@pytest.mark.parametrize(
    ("cases", "expected"),
    [
        ({"currents": [0.4], "directions": [0.0, 90.0]}, {(0.4, 0.0), (0.4, 90.0)}),  # with the waves
        ({"currents": [0.4], "current_direction": 30.0, "directions": [0.0, 90.0]}, {(0.4, 30.0)}),
        ({"currents": [0.4, {"speed": 0.2, "direction": np.pi / 4}]}, {(0.4, 0.0), (0.2, 45.0)}),
    ],
)
def test_currents_of_the_season_are_those_of_the_load_cases_with_their_directions(cases, expected):
    season = {key: value for key, value in table()["season"].items() if key != "currents"}
    site = read_site({**table(), "cases": cases, "season": season})
    currents = [scene_at_rest(site, "june", water, {}).sea.current for water in list_waters(site, site.season)]
    assert len(currents) == 2 * len(expected)  # two levels
    assert {(own.speed, round(np.degrees(own.direction), 9)) for own in currents} == expected


def test_mussels_on_lines_that_carry_a_crop_of_the_library_are_reported():
    assert double_crops(read_site(table())) == []
    own = scene()
    own["line"][-1]["type"], own["line"][0]["type"] = "library:mussel-sock-6", "library:mussel-sock-6"  # one has growth
    (flag,) = double_crops(read_site({**table(), "scene": own}))
    assert flag.startswith("loop-4: mussels of [[growth]] are added to a crop of the library, so floats carry both")


def test_floats_are_spread_in_proportion_to_what_points_need():
    assert distribute_floats(8, [1.0, 2.0, 1.0]) == [2, 4, 2]
    assert sum(distribute_floats(7, [1.0, 2.0, 1.0])) == 7
    assert max(abs(n - x) for n, x in zip(distribute_floats(7, [1.0, 2.0, 1.0]), [1.75, 3.5, 1.75], strict=True)) < 1.0


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ({"season": None}, "season: missing"),
        ({"growth": None}, "growth: missing"),
        ({"season": {"points": "f*", "volume": 0.1, "density": 1100.0}}, "season.density: 1100 kg/m^3 does not lift"),
        ({"season": {"points": "f*", "volume": 0.1, "levels": []}}, "season.levels: [] is empty; allowed: at"),
        ({"season": {"points": "f*", "volume": 0.1, "currents": []}}, "season.currents: [] is empty; allowed: at"),
    ],
)
def test_a_season_that_cannot_be_is_refused(sections, message):
    given = {key: value for key, value in {**table(), **sections}.items() if value is not None}
    with pytest.raises(SceneError, match=re.escape(message)):
        plan_season(read_site(given))
