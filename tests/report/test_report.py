"""The report of saved runs: every number against a motion or a signal whose answer is known without it."""

import dataclasses
import sys
from collections import Counter

import numpy as np
import pytest

from dropper_jax import report_run
from dropper_jax.evaluation.fatigue import NO_CURVE, NO_LOAD, cycles, damage, turning_points
from dropper_jax.evaluation.settings import Settings
from dropper_jax.evaluation.snaps import snap_events
from dropper_jax.report import sections
from dropper_jax.report.distance import segment_distance

rainflow = pytest.importorskip("rainflow")


def rope(points, links, effects=None, sea=None, length=10.0, **line):
    """A scene of one elastic line from the first to the second of `points`: name, position, kind."""
    line = {"from": points[0][0], "to": points[1][0], "links": links, "length": length / links, "mass": 1.0} | line
    table = {
        "run": {"dt": 0.1, "duration": 1.0},
        "point": [{"name": n, "position": list(map(float, p)), "kind": k} for n, p, k in points],
        "line": [{"name": "rope", "nodes": "shared", "axial": {"law": "rope", "EA": 1e6}} | line],
        "effects": {"weight": {}} if effects is None else effects,
    }
    return table if sea is None else {**table, "sea": sea}


HANGING = [("top", (0, 0, 0), "fixed"), ("end", (0, 0, -10), "free")]


# --- fatigue --------------------------------------------------------------------------------------------------------


def test_rainflow_counts_the_example_of_astm_e1049():
    found = Counter()
    for size, _, count in cycles(np.array([-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0])):
        found[size] += count
    # ASTM E1049-85, figure 6: cycles by range
    assert found == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}


def test_turning_points_leave_nothing_out_that_rainflow_counts():
    signal = np.round(np.cumsum(np.random.default_rng(0).standard_normal(400)), 1)  # rounding makes plateaus
    whole = np.array([c[:3] for c in rainflow.extract_cycles(signal.tolist())])
    ours = cycles(signal)
    assert len(whole) > 100
    np.testing.assert_array_equal(ours[np.lexsort(ours.T)], whole[np.lexsort(whole.T)])
    assert len(turning_points(np.full(5, 3.0))) == 1


def test_damage_of_equal_cycles_is_their_number_over_those_of_the_curve():
    triangle = np.array([100.0, 300.0] * 10 + [100.0])
    counted = cycles(triangle)
    assert counted[:, 2].sum() == pytest.approx(10.0)
    # range 200 N of a breaking load of 1000 N: N = 316 * 0.2^-3 = 39500 cycles
    assert damage(counted, 1000.0, 316.0, 3.0) == pytest.approx(10.0 / 39500.0, rel=1e-12)


def test_yearly_damage_scales_the_record_and_lines_without_breaking_load_say_so(made):
    t = 0.1 * np.arange(101)
    tension = 500.0 + 100.0 * np.where(np.arange(101) % 2, -1.0, 1.0)[:, None] * np.ones(2)
    nodes = np.tile(np.array([[0.0, 0, 0], [0, 0, -5], [0, 0, -10]]), (len(t), 1, 1))
    solution = made(rope(HANGING, 2), nodes, tension)
    (line,) = report_run(solution)["fatigue"]
    assert line["damage"] is None
    assert "breaking" in line["why_no_damage"]
    (line,) = report_run(solution, Settings(breaking_load=2000.0))["fatigue"]
    assert line["damage"] is None
    assert "--curve-k" in line["why_no_damage"]
    (line,) = report_run(solution, Settings(breaking_load=2000.0, curve_k=316.0))["fatigue"]
    # the first sample belongs to no step: 99 half cycles of 200 N in the 10 s of the record
    ten_seconds = 99 * 0.5 * (200.0 / 2000.0) ** 3 / 316.0
    assert line["largest_damage"] == pytest.approx(ten_seconds, rel=1e-12)
    assert line["damage_per_year"] == pytest.approx(ten_seconds * 365.25 * 86400 / 10.0, rel=1e-12)
    assert line["life_years"] == pytest.approx(1 / line["damage_per_year"])


def test_without_the_package_the_rest_of_the_report_is_written(longline, monkeypatch):
    monkeypatch.setitem(sys.modules, "rainflow", None)
    found = report_run(longline())
    assert "dropper-jax[fatigue]" in found["fatigue"]["skipped"]
    assert len(found["tension"]) == 4


# --- snaps ----------------------------------------------------------------------------------------------------------


def signal(*corners):
    """Piecewise linear signal through (time, value) corners, sampled every 0.01 s."""
    t = np.arange(0, corners[-1][0] + 1e-9, 0.01)
    return t, np.interp(t, *np.array(corners).T)


def test_a_snap_is_slack_for_long_enough_and_then_a_rise():
    # below 10 from t = 0.9 (on 1 s from 100 to 0) to 2.1, then 50 at t = 2.5 and a peak of 100 at t = 3
    t, tension = signal((0, 100), (1, 0), (2, 0), (3, 100), (4, 50))
    (event,) = snap_events(t, tension, slack=10.0, shortest=1.0, snap=50.0)
    assert event == pytest.approx((0.9, 2.1, 2.5, 100.0, 3.0))
    assert snap_events(t, tension, slack=10.0, shortest=1.25, snap=50.0) == []
    assert snap_events(t, tension, slack=10.0, shortest=1.0, snap=101.0) == []


def test_a_rise_counts_until_the_line_is_slack_again_and_open_ends_are_right():
    # slack at the start, up to 40 only, slack again, then 80, and slack at the end
    t, tension = signal((0, 0), (1, 0), (2, 40), (3, 0), (4, 0), (5, 80), (6, 0), (7, 0))
    (event,) = snap_events(t, tension, slack=4.0, shortest=0.5, snap=50.0)
    assert (event.slack_from_s, event.peak_n) == pytest.approx((2.9, 80.0))
    (first, _) = snap_events(t, tension, slack=4.0, shortest=0.5, snap=30.0)
    assert (first.slack_from_s, first.peak_n) == pytest.approx((0.0, 40.0))


def test_snap_thresholds_are_relative_to_the_mean_unless_given(made):
    t, tension = signal((0, 100), (1, 0), (2, 0), (3, 100), (4, 100))
    nodes = np.tile(np.array([[0.0, 0, 0], [0, 0, -10]]), (len(t), 1, 1))
    solution = made(rope(HANGING, 1), nodes, tension[:, None], dt=0.01, t_tension=t)
    (line,) = report_run(solution)["snap"]
    assert line["events"] == [0]  # the mean is 50: a snap would need more than 100
    (line,) = report_run(solution, Settings(slack=10.0, slack_time=1.0, snap=99.0))["snap"]
    assert line["events"] == [1]
    assert line["shown"][0]["snap_n"] == 99.0


# --- loads ----------------------------------------------------------------------------------------------------------


def test_anchor_of_a_catenary_takes_its_horizontal_force_and_the_weight_above_it(made):
    a, level, links, start = 20.0, 1000.0, 400, 0.3
    x = a * np.linspace(start, 1.5, links + 1)
    nodes = np.stack([x, np.zeros_like(x), a * np.cosh(x / a)], axis=1)
    chord = np.diff(nodes, axis=0)
    tension = level * np.linalg.norm(chord, axis=1) / chord[:, 0]  # the horizontal force is the same everywhere
    mass = level * np.diff(np.sinh(x / a)) / 9.81
    scene = rope([("anchor", nodes[0], "fixed"), ("top", nodes[-1], "fixed")], links, length=100.0, mass=mass.tolist())
    found = report_run(made(scene, np.tile(nodes, (4, 1, 1)), np.tile(tension, (4, 1))))["anchors"]
    anchor, top = found
    # catenary: V = H sinh(x/a)
    assert anchor["horizontal_n"]["mean"] == pytest.approx(level, rel=1e-12)
    assert anchor["vertical_n"]["max"] == pytest.approx(level * np.sinh(start), rel=1e-5)
    assert anchor["uplift_rad"]["mean"] == pytest.approx(np.arctan(np.sinh(start)), rel=1e-5)
    assert top["vertical_n"]["mean"] == pytest.approx(-level * np.sinh(1.5), rel=1e-5)


def test_opposite_lines_at_one_anchor_cancel_and_leave_their_lift(made):
    table = rope([("left", (-8, 0, 6), "free"), ("anchor", (0, 0, 0), "fixed")], 1)
    table["point"].append({"name": "right", "position": [8.0, 0.0, 6.0], "kind": "free"})
    table["line"].append({**table["line"][0], "name": "other", "from": "anchor", "to": "right"})
    nodes = np.tile(np.array([[-8.0, 0, 6], [0, 0, 0], [0, 0, 0], [8, 0, 6]]), (4, 1, 1))
    (anchor,) = report_run(made(table, nodes, np.full((4, 2), 50.0)))["anchors"]
    # less half a link of 1 kg of either line
    assert anchor["vertical_n"]["mean"] == pytest.approx(2 * (50.0 * 0.6 - 0.5 * 9.81))
    assert anchor["horizontal_n"]["max"] == pytest.approx(0.0, abs=1e-12)
    assert anchor["uplift_rad"]["mean"] == pytest.approx(np.pi / 2)


def test_an_anchor_without_load_has_no_angle_rather_than_a_wrong_one(made):
    nodes = np.tile(np.array([[0.0, 0, 0], [0, 0, -10]]), (4, 1, 1))
    (anchor,) = report_run(made(rope(HANGING, 1, effects={}), nodes, np.zeros((4, 1))))["anchors"]
    assert anchor["uplift_rad"] is None
    assert anchor["share_without_angle"] == 1.0


def test_statistics_and_utilisation_are_those_of_the_tensions_without_the_start(longline):
    solution = longline(tension=10000.0)
    found = report_run(solution)["tension"][3]
    own = solution.tension[1:, solution.lines[3].links]
    assert found["largest"]["n"] == own.max()
    assert found["largest"]["at_m"] == pytest.approx(40.0 * 5.5 / 6)
    assert found["utilisation"]["largest"] == pytest.approx(own.max() / 5e4)
    np.testing.assert_allclose(found["percentiles_n"]["50"], np.median(own, axis=0))
    skipped = report_run(solution, Settings(skip=3.0))
    assert skipped["from_s"] == pytest.approx(3.0)
    # sin(2 pi t/6) is negative from 3 s on
    assert skipped["tension"][0]["largest"]["n"] < 10000.0 * 1.1


# --- motion, water, bed ---------------------------------------------------------------------------------------------


def test_watch_circle_of_a_circling_point_is_its_radius(made):
    angle = np.linspace(0, 4 * np.pi, 201)[:-1]
    end = np.stack([3 + 2 * np.cos(angle), 1 + 2 * np.sin(angle), np.full_like(angle, -9.0)], axis=1)
    nodes = np.stack([np.zeros_like(end), end], axis=1)
    solution = made(rope(HANGING, 1), nodes, np.ones((200, 1)))
    (point,) = report_run(solution)["watch_circle"]
    assert point["point"] == "end"
    np.testing.assert_allclose(point["mean_m"], [3, 1, -9], atol=1e-12)
    assert point["radius_max_m"] == pytest.approx(2.0)
    # the run starts in its static pose, here at the circle's edge: the other side is a diameter away
    assert point["radius_from_static_max_m"] == pytest.approx(4.0)
    later = dataclasses.replace(solution, continues={"origin_s": 0.0, "saves": 200})
    assert report_run(later)["watch_circle"][0]["static_m"] is None


def test_acceleration_of_a_swinging_node_is_amplitude_times_frequency_squared(made):
    t = 0.01 * np.arange(1001)
    nodes = np.zeros((len(t), 2, 3))
    nodes[:, 1] = [0, 0, -10]
    nodes[:, 1, 0] = 0.5 * np.sin(3 * t)
    velocities = np.zeros_like(nodes)
    velocities[:, 1, 0] = 1.5 * np.cos(3 * t)
    solution = made(rope(HANGING, 1), nodes, np.ones((len(t), 1)), dt=0.01, velocities=velocities)
    (line,) = report_run(solution)["acceleration"]
    assert line["largest_m_per_s2"] == pytest.approx(0.5 * 9, rel=1e-3)
    assert line["rms_m_per_s2"][1] == pytest.approx(0.5 * 9 / np.sqrt(2), rel=2e-2)
    assert line["at_m"] == 10.0


def test_node_at_half_the_amplitude_below_the_surface_is_wet_two_thirds_of_the_time(made):
    sea = {"depth": 30.0, "waves": {"kind": "regular", "amplitude": 1.0, "period": 6.0}}
    points = [("top", (0, 0, -0.5), "fixed"), ("end", (0, 0, -10.5), "free")]
    nodes = np.tile(np.array([[0.0, 0, -0.5], [0, 0, -10.5]]), (1201, 1, 1))
    found = report_run(made(rope(points, 1, sea=sea, diameter=0.1), nodes, np.ones((1201, 1)), dt=0.01))
    (line,) = found["submergence"]["lines"]
    # cos(w t) > -1/2 for two thirds of a period; two periods here
    np.testing.assert_allclose(line["share_under_water"], [2 / 3, 1.0], atol=2e-3)
    np.testing.assert_allclose(line["largest_depth_m"], [1.5, 11.5], atol=1e-3)
    assert found["seabed"] == {"skipped": "the scene has no [effects.seabed]"}


def test_draught_of_a_buoy_is_that_of_its_motion_in_calm_water(longline):
    solution = longline(samples=601)
    calm = {"sea.waves.amplitude": 0.0, "buoy.spar-a.height": 1.5}
    solution = dataclasses.replace(solution, scene=solution.scene.with_values(calm))
    found = report_run(solution)["submergence"]["buoys"][0]
    # the base is at -1 + 0.8 cos(w t): draughts of 1 +- 0.8 m, above 1.5 m while cos(w t) < -0.625, of ten periods
    assert found["draught_m"] == pytest.approx({"min": 0.2, "mean": 1.0, "max": 1.8}, abs=2e-3)
    assert found["share_under_water"] == pytest.approx(np.arccos(0.625) / np.pi, abs=0.02)
    assert found["longest_under_water_s"] == pytest.approx(6 * np.arccos(0.625) / np.pi, abs=0.2)
    assert found["share_out_of_water"] == 0.0


def test_length_on_the_bed_is_that_of_the_links_that_lie_on_it(made):
    nodes = np.zeros((10, 6, 3))
    nodes[..., 0] = np.arange(6)
    nodes[:5, :, 2] = [-20, -20, -20.001, -19.995, -19.9, -10]  # three links within 1 cm of the bed
    nodes[5:, :, 2] = [-20, -19, -18, -17, -16, -10]  # none: the anchor alone is on it
    points = [("anchor", (0, 0, -20), "fixed"), ("end", (5, 0, -10), "free")]
    effects = {"weight": {}, "seabed": {"depth": 20.0}}
    scene = rope(points, 5, effects, {"depth": 20.0}, length=5.0, diameter=0.05)
    (line,) = report_run(made(scene, nodes, np.ones((10, 5))))["seabed"]
    assert line["length_m"] == {"min": 0.0, "mean": 1.5, "max": 3.0}
    assert line["share_with_contact"] == 0.5
    np.testing.assert_allclose(line["share_of_time"], [1, 0.5, 0.5, 0.5, 0, 0])


def test_distance_of_segments_is_the_least_over_their_points():
    ends = np.random.default_rng(2).standard_normal((4, 40, 3))
    ends[3, :10] = ends[2, :10] + 2 * (ends[1, :10] - ends[0, :10])  # parallel ones
    found = segment_distance(*ends)
    s = np.linspace(0, 1, 201)
    p = ends[0][:, None] + s[:, None] * (ends[1] - ends[0])[:, None]
    q = ends[2][:, None] + s[:, None] * (ends[3] - ends[2])[:, None]
    brute = np.linalg.norm(p[:, :, None] - q[:, None], axis=-1).min(axis=(1, 2))
    assert np.all(found <= brute + 1e-12)
    np.testing.assert_allclose(found, brute, atol=0.02)
    crossing = segment_distance(*np.array([[[-1, 0, 0]], [[1, 0, 0]], [[0, -1, 0.3]], [[0, 1, 0.3]]], float))
    assert crossing[0] == pytest.approx(0.3)


def test_lines_that_swing_together_are_named_with_place_and_time(made):
    table = rope(HANGING, 2)
    table["point"] += [
        {"name": "top2", "position": [4.0, 0, 0]},
        {"name": "end2", "position": [4.0, 0, -10.0], "kind": "free"},
    ]
    table["line"].append({**table["line"][0], "name": "other", "from": "top2", "to": "end2"})
    still = np.array([[0.0, 0, 0], [0, 0, -5], [0, 0, -10], [4, 0, 0], [4, 0, -5], [4, 0, -10]])
    nodes = np.tile(still, (21, 1, 1))
    nodes[:, 5, 0] -= 3.5 * np.exp(-((np.arange(21) - 12) ** 2))
    first, other = report_run(made(table, nodes, np.ones((21, 4))))["distance"]
    assert (first["nearest"], other["nearest"]) == ("other", "rope")
    assert first["t_s"] == pytest.approx(1.2)
    # the lower end of the other line comes to 0.5 m beside the lower end of this one
    assert first["least_distance_m"] == pytest.approx(0.5, abs=0.01)
    assert (first["at_m"], first["nearest_at_m"]) == (7.5, 7.5)


def test_lines_that_share_a_point_are_compared_without_the_links_at_it(longline):
    by_name = {line["line"]: line for line in report_run(longline())["distance"]}
    assert by_name["sock"]["least_distance_m"] > 1.0


@pytest.fixture
def pieced(made):
    """A backbone of two ropes, cut where a drop of the first one hangs on it; only this one has a breaking load."""
    table = rope([("a", (0, 0, 0), "fixed"), ("b", (8, 0, 0), "fixed")], 4, length=8.0)
    kind = {"name": "weak", "mass": 1.0, "diameter": 0.1, "EA": 1e6, "breaking_load": 10.0}
    other = {"name": "other", "mass": 1.0, "diameter": 0.1, "EA": 1e6}
    table["point"].append({"name": "under", "kind": "fixed", "position": [4.0, 0.0, -6.0]})
    halves = [{"type": name, "length": 4.0, "links": 2} for name in ("weak", "other")]
    line = {"name": "backbone", "from": "a", "to": "b", "sections": halves, "attach": [{"point": "mid", "at": 4.0}]}
    drop = {"name": "drop", "from": "mid", "to": "under", "type": "weak", "length": 6.0, "links": 2}
    table |= {"line_type": [kind, other], "line": [line, drop]}
    pose = [[0, 0, 0], [2, 0, 0], [4, 0, 0], [4, 0, 0], [6, 0, 0], [8, 0, 0], [4, 0, 0], [4, 0, -3], [4, 0, -6]]
    return made(table, np.tile(np.array(pose, float), (5, 1, 1)), np.tile([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], (5, 1)))


def test_pieces_between_attached_points_are_reported_as_the_line_they_were_cut_from(pieced):
    found = report_run(pieced)
    whole, other = found["tension"]
    assert (whole["line"], other["line"]) == ("backbone", "drop")
    np.testing.assert_allclose(whole["arc_length_m"], [1, 3, 5, 7])
    np.testing.assert_allclose(whole["mean_n"], [1, 2, 3, 4])
    np.testing.assert_allclose(found["acceleration"][0]["arc_length_m"], [0, 2, 4, 6, 8])
    # links at the shared point are left out: the outer links of the backbone and the lower one of the drop
    near = found["distance"][0]
    assert near["least_distance_m"] == pytest.approx(np.hypot(2.0, 3.0))
    assert (near["nearest"], near["nearest_at_m"]) == ("drop", 4.5)


def test_a_piece_without_a_breaking_load_leaves_those_of_the_other_pieces(pieced):
    assert report_run(pieced)["tension"][0]["utilisation"] is None
    strong = report_run(pieced, Settings(breaking_load=100.0))["tension"][0]["utilisation"]
    np.testing.assert_allclose(strong["along"], [0.1, 0.2, 0.03, 0.04])
    assert (strong["breaking_load_n"], strong["from"]) == (10.0, "the line")
    weak = report_run(pieced, Settings(breaking_load=4.0))["tension"][0]["utilisation"]
    assert (weak["largest"], weak["breaking_load_n"], weak["from"]) == (1.0, 4.0, "--breaking-load")


def test_lines_with_a_breaking_load_report_what_fatigue_lacks():
    line = {"line": "leg", "cycles": [3.0], "equivalent_range_n": [10.0], "largest_range_n": [20.0], "damage": None}
    with_load = line | {"why_no_damage": NO_CURVE}
    text = sections.fatigue([with_load])
    assert "No breaking load" not in text
    assert "No damage of any line: no curve of the part: give --curve-k" in text
    text = sections.fatigue([with_load, line | {"line": "tail", "why_no_damage": NO_LOAD}])
    assert "No damage of tail: no breaking load" in text
