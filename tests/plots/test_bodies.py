"""Rigid bodies in pictures, on the page and in the report: where they are and how they lie."""

import base64
import dataclasses
import json
import re

import numpy as np
import pytest
from PIL import Image

import dropper_jax as dj
from dropper_jax import plots, report_run
from dropper_jax.plots.run import readable
from dropper_jax.report import sections
from dropper_jax.report.page import view_page

CYLINDER = {"from": [0.0, 0.0, 0.0], "to": [0.0, 0.0, 4.0], "diameter": 0.8, "slices": 2}
SCENE = {
    "run": {"dt": 0.05, "duration": 0.5},
    "line_type": [{"name": "rope", "mass": 1.0, "diameter": 0.03, "EA": 1e5}],
    "point": [{"name": "anchor", "position": [0.0, 0.0, -20.0]}],
    "line": [{"name": "leg", "from": "anchor", "to": "base", "type": "rope", "length": 18.0, "links": 3}],
    "body": [
        {
            "name": "spar",
            "position": [0.0, 0.0, -2.0],
            "mass": 1000.0,
            "centre_of_mass": [0.0, 0.0, 1.0],
            "inertia": [1500.0, 1500.0, 80.0],
            "cylinders": [CYLINDER],
            "spheres": [{"centre": [0.0, 0.0, 5.0], "diameter": 2.0}],
            "attachments": {"base": [0.0, 0.0, 0.0]},
        }
    ],
    "effects": {"weight": {}, "buoyancy": {}},
    "sea": {"depth": 20.0},
    "start": {"kind": "points"},
}


@pytest.fixture(scope="module")
def solution():
    """A short run whose poses are then set by hand: pitched by 0.5 rad, 3 m out and 1 m down."""
    ran = dj.simulate(SCENE, halvings=0)
    shape = ran.body_position.shape
    place, turn = np.broadcast_to([3.0, 0.0, -1.0], shape), np.broadcast_to([0.0, 0.5, 0.0], shape)
    return dataclasses.replace(ran, body_position=place.copy(), body_attitude=turn.copy())


@pytest.mark.check
def test_outlines_are_those_of_the_turned_shapes(solution):
    bodies = readable(solution).bodies
    cylinder, sphere = bodies.outlines(-1, lambda places: places[:, [0, 2]])
    along, across = np.array([np.sin(0.5), np.cos(0.5)]), np.array([np.cos(0.5), -np.sin(0.5)])
    away = cylinder - [3.0, -1.0]
    assert [np.min(away @ along), np.max(away @ along)] == pytest.approx([0.0, 4.0], abs=1e-9)
    assert np.max(np.abs(away @ across)) == pytest.approx(0.4, rel=1e-2)
    ball = sphere - [3.0, -1.0] - 5.0 * along
    assert np.linalg.norm(ball, axis=1) == pytest.approx(1.0, rel=1e-2)


def test_the_page_has_the_bodies_at_their_attitude(solution):
    page = view_page(solution)
    found = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page, re.S)[1])
    bodies = found["bodies"]
    poses = np.frombuffer(base64.b64decode(bodies["poses"]), "<f4").reshape(found["frames"], 1, 12)
    top = poses[-1, 0, :3] + poses[-1, 0, 3:].reshape(3, 3) @ [0.0, 0.0, 4.0]
    assert top == pytest.approx([3.0 + 4.0 * np.sin(0.5), 0.0, -1.0 + 4.0 * np.cos(0.5)], abs=1e-5)
    ring = np.array(bodies["shapes"][0]["rings"][1])
    assert np.mean(ring, axis=0) == pytest.approx([0.0, 0.0, 4.0], abs=1e-5)
    assert np.hypot(*ring[:, :2].T) == pytest.approx(0.4, abs=1e-4)
    assert found["buoys"] == []


@pytest.mark.parametrize("name", ["snapshot", "body_motion"])
def test_pictures_show_the_bodies(solution, tmp_path, name):
    file = getattr(plots, name)(solution, tmp_path / f"{name}.png")
    colours = np.asarray(Image.open(file).convert("RGB")).reshape(-1, 3).astype(int)
    assert len(np.unique(colours, axis=0)) > 10
    if name == "snapshot":  # the bodies' colour, E69F00
        assert np.sum(np.abs(colours - [0xE6, 0x9F, 0x00]).sum(axis=1) < 12) > 500


def test_the_report_has_the_motion_in_degrees(solution):
    rows = report_run(solution)["bodies"]
    assert rows[0]["body"] == "spar"
    assert rows[0]["pitch_deg"]["mean"] == pytest.approx(np.degrees(0.5))
    assert rows[0]["tilt_deg"]["max"] == pytest.approx(np.degrees(0.5))
    assert rows[0]["heave_m"]["mean"] == pytest.approx(-1.0)
    assert rows[0]["surge_m"]["std"] == pytest.approx(0.0, abs=1e-12)
    assert r"| spar | pitch \[deg\] | 28.648 | 0.000 |" in sections.bodies(rows)
