"""What anchors hold, against Coulomb's law, in the report of a run."""

import copy
import math

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError, report_runs
from dropper_jax.report.text import report_markdown
from dropper_jax.scene import AnchorSpec, utilisations
from dropper_jax.study.tide import tidal_cycle

#: A light rope at rest that a submerged float pulls up at an anchor, in a current.
SCENE = {
    "run": {"dt": 0.05, "duration": 1.0},
    "line_type": [{"name": "rope", "mass": 1.0, "diameter": 0.03, "EA": 1e5, "cdn": 1.2, "cdt": 0.0}],
    "point": [
        {"name": "anchor", "position": [0, 0, -20.0]},
        {"name": "float", "kind": "free", "position": [0, 0, -4.0], "mass": 20.0, "volume": 0.2, "drag_area": 0.5},
    ],
    "line": [{"name": "leg", "from": "anchor", "to": "float", "type": "rope", "length": 16.0, "links": 4}],
    "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}},
    "sea": {"depth": 20.0, "current": {"speed": 0.5}},
    "anchor": [{"point": "anchor", "weight": 5000.0, "friction": 0.5}],
}


def test_a_dead_weight_slides_by_coulomb_and_lifts_by_its_weight():
    block = AnchorSpec(point="a", weight=5000.0, friction=0.5)
    assert block.utilisation(2500.0, 0.0) == 1.0
    assert block.utilisation(0.0, 5000.0) == 1.0
    # it slides where H = mu (W - V)
    assert block.utilisation(0.5 * (5000.0 - 1000.0), 1000.0) == 1.0
    assert block.utilisation(1000.0, -3000.0) == 0.4  # a load downwards does not help
    screw = AnchorSpec(point="a", kind="tested", capacity=5000.0)
    assert screw.utilisation(3000.0, 4000.0) == 1.0


def test_an_anchor_behind_another_one_takes_what_that_one_does_not_hold():
    front = AnchorSpec(point="front", kind="tested", capacity=5000.0, behind="rear")
    anchors = (front, AnchorSpec(point="rear", weight=8000.0, friction=0.5))
    none = np.zeros(3)
    used = utilisations(anchors, {"front": (np.array([4000.0, 7000.0, 9000.0]), none), "rear": (none, none)})
    np.testing.assert_allclose(used["front"], [0.8, 1.4, 1.8])
    np.testing.assert_allclose(used["rear"], [0.0, 0.5, 1.0])  # 2 and 4 kN over mu W = 4 kN
    with pytest.raises(SceneError, match=r"anchor\.0\.behind: 'nowhere' .* allowed: none"):
        dj.load_scene({**SCENE, "anchor": [{**SCENE["anchor"][0], "behind": "nowhere"}]})


def test_a_point_has_one_anchor():
    with pytest.raises(SceneError, match=r"anchor\.1\.point: 'anchor' has an anchor already"):
        dj.load_scene({**SCENE, "anchor": 2 * SCENE["anchor"]})


@pytest.mark.check
def test_edulis_anchors_hold_through_the_tide():
    scene = dj.load_scene("edulis-tide").with_values({"sea.current.direction": np.pi / 3})
    rows = tidal_cycle(scene, 5)["rows"]
    west = max(float(np.linalg.norm(row["held_load_n"]["west-danforth"])) for row in rows)
    assert 10e3 < west < 14e3
    assert max(row["anchor_utilisation"]["west-danforth"] for row in rows) == pytest.approx(west / 245e3)


#: Two plates of 0.3 m in clay of 50 kPa.
SCREW = {"point": "anchor", "kind": "screw", "plates": [0.3, 0.3], "depths": [2.0, 3.0], "strength": 50e3}


def test_a_screw_anchor_holds_the_bearing_of_its_plates():
    clay = dj.load_scene({**SCENE, "anchor": [SCREW]}).anchors[0]
    # nine times the strength on each plate of 0.070686 m2
    assert clay.screw_capacity == pytest.approx(2 * 0.0706858 * 9 * 50e3, rel=1e-5)
    assert clay.utilisation(0.6 * clay.screw_capacity, 0.8 * clay.screw_capacity) == pytest.approx(1.0)
    upright = dj.load_scene({**SCENE, "anchor": [{**SCREW, "lateral": 4000.0}]}).anchors[0]
    assert upright.utilisation(2000.0, 0.25 * clay.screw_capacity) == pytest.approx(0.75)
    # N_q of tables of bearing capacity: 10.66, 18.40, 33.30, 64.20 at 25, 30, 35, 40 degrees
    for degrees, factor in ((25, 10.66), (30, 18.40), (35, 33.30), (40, 64.20)):
        ground = {"friction_angle": math.radians(degrees), "soil_weight": 9000.0, "plates": [0.4], "depths": [2.5]}
        table = {**SCENE, "anchor": [{"point": "anchor", "kind": "screw", **ground}]}
        sand = dj.load_scene(table).anchors[0]
        assert sand.screw_capacity == pytest.approx(0.125664 * 9000.0 * 2.5 * factor, rel=1e-3)
        assert dj.load_scene(dj.load_scene(table).to_dict()) == dj.load_scene(table)


@pytest.mark.check
def test_the_report_has_utilisation_and_factor():
    scene = dj.load_scene(SCENE)
    assert dj.Scene.from_dict(scene.to_dict()) == scene
    run = dj.simulate(scene)
    found = report_runs({"run": run})
    held = found["runs"][0]["anchors"][0]
    across, up = held["horizontal_n"], held["vertical_n"]
    used = held["holding"]["utilisation"]
    # at rest: the loads hardly change
    assert used["mean"] == pytest.approx((across["mean"] / 0.5 + up["mean"]) / 5000.0, rel=1e-3)
    assert held["holding"]["factor"] == pytest.approx(1.0 / used["max"])
    assert held["holding"]["holds"] == (used["max"] * 1.5 <= 1.0)
    assert "| anchor | dead weight |" in report_markdown(found, [{}])
    heavy = scene.with_values({"anchor.0.weight": 50000.0})
    assert heavy.anchors[0].weight == 50000.0


@pytest.mark.parametrize(
    ("anchor", "start"),
    [
        ({"point": "float", "weight": 1.0, "friction": 0.5}, "anchor.0.point: 'float' is not a fixed point"),
        ({"point": "anchor", "weight": 1.0}, "anchor.0.friction: missing; kind 'dead_weight' takes weight"),
        ({"point": "anchor", "kind": "tested", "weight": 1.0}, "anchor.0.weight: is not used; kind 'tested' takes"),
        ({"point": "anchor", "kind": "tested", "capacity": -1.0}, "anchor.0.capacity: -1.0 is out of range"),
        ({"point": "anchor", "kind": "scew"}, "anchor.0.kind: 'scew' is unknown"),
        ({"point": "anchor", "kind": "screw", "weight": 1.0}, "anchor.0.weight: is not used; kind 'screw' takes"),
        ({"point": "anchor", "kind": "tested", "capacity": 1.0, "strength": 1.0}, "anchor.0.strength: is not used"),
        ({**SCREW, "depths": [1.0, 3.0]}, "anchor.0.depths.0: 1 m is too shallow"),
        ({**SCREW, "depths": [2.0, 2.5]}, "anchor.0.depths.1: 2.5 m is less than 3 diameters below"),
        ({**SCREW, "depths": [2.0]}, "anchor.0.depths: has 1 entries"),
        ({**SCREW, "friction_angle": 0.5}, "anchor.0: kind 'screw' takes `strength` (clay) or `friction_angle`"),
        ({**SCREW, "soil_weight": 9000.0}, "anchor.0.soil_weight: is not used in clay"),
        (
            {"point": "anchor", "kind": "screw", "plates": [0.3], "depths": [2.0], "friction_angle": 0.5},
            "anchor.0.soil_weight: missing",
        ),
        ({**SCREW, "friction_angle": 30.0}, "anchor.0.friction_angle: 30.0 is out of range"),
    ],
)
def test_anchors_that_cannot_be_are_refused(anchor, start, refusal):
    table = copy.deepcopy(SCENE)
    table["anchor"] = [anchor]
    assert refusal(dj.load_scene, table).startswith(start)
