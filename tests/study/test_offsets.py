"""Restoring force over offset: closed form of the catenary, MoorPy's curves, the command, and rejected input."""

import json

import against_moorpy
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.optimize import brentq

import dropper_jax as dj
from dropper_jax.cli import offset as command
from dropper_jax.study.offsets import offset_curves

#: Two hanging chains on either side of a fixed point: length, span [m] and weight [N/m].
LENGTH, SPAN, WEIGHT = 40.0, 30.0, 2.0 * 9.81
CHAINS = system(
    [
        *(fixed(name, x, 0.0, 0.0) for name, x in (("west", -SPAN), ("middle", 0.0), ("east", SPAN))),
        free("end", 0.0, 0.0, -5.0, mass=1.0, volume=0.0),
    ],
    [
        line_of("left", "west", "middle", 100, LENGTH, type="chain"),
        line_of("right", "middle", "east", 100, LENGTH, type="chain"),
        line_of("plumb", "middle", "end", 2, 5.0, type="chain"),
    ],
    line_type=[{"name": "chain", "mass": 2.0, "diameter": 0.02, "EA": 1e8}],
    effects={"weight": {"gravity": 9.81}},
)


def horizontal_force(span: float) -> float:
    """Horizontal tension [N] of an inextensible catenary with its ends at equal height: L = 2 a sinh(X / 2 a)."""
    scale = brentq(lambda a: 2.0 * a * np.sinh(span / (2.0 * a)) - LENGTH, 0.1 * span, 100.0 * span)
    return WEIGHT * scale


@pytest.fixture(scope="module")
def curves():
    return offset_curves(dj.load_scene(CHAINS), ["middle"], [0.0, 90.0], [0.0, 2.0, 4.0])


@pytest.mark.check
def test_forces_of_two_chains_are_those_of_the_catenary(curves):
    for row in curves:
        assert row["status"] == "ok"
        angle = np.radians(row["direction_deg"])
        at = row["distance_m"] * np.array([np.cos(angle), np.sin(angle)])
        force = np.zeros(2)
        for anchor in ([-SPAN, 0.0], [SPAN, 0.0]):
            towards = np.array(anchor) - at
            span = float(np.linalg.norm(towards))
            force += horizontal_force(span) * towards / span
        scale = horizontal_force(SPAN)
        np.testing.assert_allclose(row["force_n"][:2], force, atol=1e-3 * scale)
        assert row["restoring_n"] == pytest.approx(-force @ at / max(row["distance_m"], 1e-9), abs=1e-3 * scale)
        # half of each chain, the plumb line and its mass hang on the point
        assert row["force_n"][2] == pytest.approx(-(WEIGHT * (LENGTH + 5.0) + 9.81), rel=1e-5)
        longest = max(np.hypot(SPAN + at[0], at[1]), np.hypot(SPAN - at[0], at[1]))
        tension = np.hypot(horizontal_force(longest), WEIGHT * LENGTH / 2.0)
        assert row["max_tension_n"] == pytest.approx(tension, rel=0.01)
        assert row["end_tension_n"] == pytest.approx(tension, rel=1e-3)


def test_a_point_at_which_no_line_ends_is_refused():
    vessel = {"name": "boat", "position": [0.0, 0.0, 9.0], "time": [0.0, 1.0], "motion": [[0.0] * 6] * 2}
    scene = dj.load_scene({**CHAINS, "vessel": [{**vessel, "attachments": {"bow": [1.0, 0.0, 0.0]}}]})
    with pytest.raises(dj.SceneError, match="points: no line ends at 'bow'"):
        offset_curves(scene, ["bow"], [0.0], [1.0])


def test_points_displaced_together_keep_the_force_between_them():
    """All three fixed points displaced: the configuration is carried along, and no force changes."""
    rows = offset_curves(dj.load_scene(CHAINS), ["west", "middle", "east"], [30.0], [0.0, 3.0])
    np.testing.assert_allclose(rows[1]["force_n"], rows[0]["force_n"], atol=1e-5 * WEIGHT * LENGTH)


@pytest.mark.check
@pytest.mark.parametrize("name", ["spread", "bridles", "edulis"])
def test_restoring_forces_are_moorpys_within_a_percent(name):
    assert against_moorpy.offsets(name, against_moorpy.known("offsets")[name])[0] < 0.01


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("chains") / "chains.toml"
    path.write_text(dj.as_toml(CHAINS))
    return str(path)


@pytest.mark.check
def test_command_prints_writes_and_draws_the_curves(file, tmp_path, printed, json_of, curves):
    words = ["offset", file, "--quiet", "--points", "middle", "--distance", "0:4:2"]
    kept = ["--out", str(tmp_path / "o.json"), "--plot", str(tmp_path / "o.png")]
    found = json_of([*words, "--direction", "0:360:90", "--json", *kept])
    assert found == json.loads((tmp_path / "o.json").read_text())
    assert (tmp_path / "o.png").stat().st_size > 1000
    # 360 deg is 0 deg
    assert [row["direction_deg"] for row in found["rows"][::3]] == [0.0, 90.0, 180.0, 270.0]
    assert found["rows"][2]["restoring_n"] == pytest.approx(curves[2]["restoring_n"])
    assert "restoring [N]" in printed(words).out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--points midle --distance 1", "points: 'midle' is not a point of the scene; did you mean 'middle'"),
        ("--points end --distance 1", "points: 'end' is free"),
        ("--points east,east --distance 1", "points: 'east' is given twice"),
        ("--points east --distance 5:0:1", "--distance: '5:0:1' is an empty range"),
        ("--points east --distance 0:5:0", "--distance: '0:5:0' is an empty range"),
        ("--points east --distance nan", "--distance: 'nan' is an empty range"),
        ("--points east --distance 0:5", "--distance: '0:5' is not LO:HI:STEP"),
        ("--points east --distance=-1:5:1", "--distance: '-1:5:1' is below 0"),
        ("--points east --distance 0:5:1e-9", "--distance: '0:5:1e-9' has too many values"),
        ("--points east --distance 1 --direction x", "--direction: 'x' is not LO:HI:STEP"),
    ],
)
def test_wrong_input_is_rejected_in_one_line(file, words, message, refused):
    assert message in refused(["offset", file, "--quiet", *words.split()])


def test_range_includes_its_end_in_spite_of_rounding():
    np.testing.assert_allclose(command._values("0:0.3:0.1", "--distance"), [0.0, 0.1, 0.2, 0.3])
