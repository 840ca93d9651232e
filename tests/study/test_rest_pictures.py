"""Pictures of poses, modes, responses, mussels and tides: drawn where they are asked for, from where they show."""

import json

import numpy as np
import pytest
from PIL import Image

from dropper_jax.study import rest_pictures
from dropper_jax.study.mussels_picture import draw_mussels
from dropper_jax.study.response import draw_responses
from dropper_jax.study.tide import draw_tide


@pytest.mark.parametrize(
    ("moved", "seen"), [((0.0, 1.0, 0.0), (0, 1)), ((0.1, 0.0, 1.0), (0, 2)), ((0.0, 1.0, 1.0), (0, 2))]
)
def test_modes_of_a_long_line_are_seen_from_where_they_show(moved, seen):
    # 100 m along x, 20 m high, 2 m wide: moves along y show from above, moves along z from the side
    rest = np.linspace([0.0, 0.0, -20.0], [100.0, 2.0, 0.0], 11)
    assert rest_pictures._plane(rest, np.tile(moved, (11, 1))) == seen
    # one across a short line is seen from the front
    short = np.linspace([0.0, 0.0, -20.0], [1.0, 0.0, 0.0], 11)
    assert rest_pictures._plane(short, np.tile((0.0, 1.0, 0.0), (11, 1))) == (1, 2)


def test_a_pose_leaves_its_picture_and_its_result(tmp_path, json_of):
    out = tmp_path / "pose.json"
    words = ["equilibrium", "dropper-release-a", "--plot", str(tmp_path), "--out", str(out), "--json"]
    reported = json_of(words)
    assert json.loads(out.read_text()) == reported
    assert len(reported["positions_m"]) == 8
    with Image.open(tmp_path / "pose.png") as image:
        assert image.width > 500


@pytest.mark.check
def test_modes_leave_a_picture(tmp_path, json_of):
    reported = json_of(["modes", "paper-case-4", "--count", "2", "--json", "--plot", str(tmp_path / "two.png")])
    assert len(reported["period_s"]) == 2
    assert (tmp_path / "two.png").stat().st_size > 5000


def test_curves_are_drawn_from_plain_rows(tmp_path):
    still = {"mean_rad": 0.0, "amplitude_10_percent_more": 0.1}
    rows = [{"period_s": t, "amplitude_rad": 0.1 * t, "phase_rad": -t, **still} for t in (2.0, 3.0, 4.0)]
    low = {"level_m": 0.0, "held_load_n": {"a": [1.0, 0.0, 2.0]}}
    tide = [{"t_s": 3600.0 * t, "speed_m_per_s": t, "displacement_m": t, **low} for t in range(3)]
    grown = [
        {"lines": ["loop-1", "loop-2"], "month": m, "depth_m": d, "thickness_m": 0.01 * m, "wet_weight_n_per_m": m}
        for m in (0.0, 6.0)
        for d in (2.0, 8.0)
    ]
    for file in (
        draw_responses("pendulum", rows, tmp_path / "response.png"),
        draw_tide("farm", tide, tmp_path / "tide.png"),
        draw_mussels("farm", grown, tmp_path / "growth.png"),
    ):
        with Image.open(file) as image:
            assert image.height > 500
