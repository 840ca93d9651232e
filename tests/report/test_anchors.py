"""What anchors hold, against Coulomb's law, in the report of a run."""

from __future__ import annotations

import copy

import pytest

import dropper_jax as dj
from dropper_jax.report.build import report_runs
from dropper_jax.report.text import markdown
from dropper_jax.scene import AnchorSpec

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
    assert "| anchor | dead weight |" in markdown(found, [{}])
    heavy = scene.with_values({"anchor.0.weight": 50000.0})
    assert heavy.anchors[0].weight == 50000.0


@pytest.mark.parametrize(
    ("anchor", "start"),
    [
        (
            {"point": "float", "weight": 1.0, "friction": 0.5},
            "anchor.0.point: 'float' is no held point",
        ),
        (
            {"point": "anchor", "weight": 1.0},
            "anchor.0.friction: missing; kind 'dead_weight' takes weight",
        ),
        ({"point": "anchor", "kind": "tested", "weight": 1.0}, "anchor.0.weight: is not used; kind 'tested' takes"),
        ({"point": "anchor", "kind": "tested", "capacity": -1.0}, "anchor.0.capacity: -1.0 is out of range"),
        ({"point": "anchor", "kind": "screw"}, "anchor.0.kind: 'screw' is unknown"),
    ],
)
def test_anchors_that_cannot_be_are_refused(anchor, start):
    table = copy.deepcopy(SCENE)
    table["anchor"] = [anchor]
    with pytest.raises(dj.SceneError) as caught:
        dj.load_scene(table)
    assert str(caught.value).startswith(start)
