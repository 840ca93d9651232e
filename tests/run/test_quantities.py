"""Quantities by name, against the report's own readings of a pose and of a motion."""

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError
from dropper_jax.quantities.bending import curvature
from dropper_jax.quantities.end_forces import fixed_point_loads
from dropper_jax.quantities.quantity_extremes import quantity_signals
from dropper_jax.quantities.quantity_names import quantity, static_quantity
from dropper_jax.quantities.statistics import NAMES, statistic
from dropper_jax.scene import line_slices
from dropper_jax.stepping.extremes import Extremes
from dropper_jax.study.design import solve_design

SCENE = scene_of(
    {"west": [-8.0, 0.0, -10.0], "east": [8.0, 1.0, -10.0], "buoy": free_at([0.5, 0.0, -4.0], mass=20.0, volume=0.2)},
    line_of("west-leg", "west", "buoy", 3, 10.0, type="rope"),
    line_of("east-leg", "buoy", "east", 3, 10.0, type="rope"),
    run={"dt": 0.02, "duration": 1.0},
    line_type=[{"name": "rope", "mass": 1.2, "diameter": 0.03, "EA": 5e4, "damping_ratio": 0.3}],
    sea={"depth": 10.0},
    effects={"weight": {}, "buoyancy": {}},
)


def _angle(positions, end, inner):
    """Angle of a line above the horizontal as it leaves its end [rad]."""
    along = positions[inner] - positions[end]
    return np.arcsin(along[2] / np.linalg.norm(along))


@pytest.fixture(scope="module")
def posed():
    """The scene, its model, the pose as a state and as the report reads it."""
    scene = dj.load_scene(SCENE)
    model, _ = dj.build(scene)
    pose = dj.equilibrium(scene)
    return scene, model, pose


def test_names_of_lines_ends_and_points_are_those_of_the_pose(posed):
    scene, model, pose = posed
    west, east = line_slices(scene)
    loads = fixed_point_loads(scene, pose.positions, pose.tension)
    buoy = pose.positions[west.nodes.stop - 1]
    expected = {
        "tension.max": pose.tension.max(),
        "tension.2.max": pose.tension[1],
        "tension.west-leg.max": pose.tension[west.links].max(),
        "tension.west-leg.anchor.max": pose.tension[west.links.start],
        "tension.west-leg.fairlead.max": pose.tension[west.links.stop - 1],
        "tension.east-leg.fairlead.max": pose.tension[east.links.start],
        "tension.east-leg.east.max": pose.tension[east.links.stop - 1],
        "tension.east-leg.last.max": pose.tension[east.links.stop - 1],
        "anchor.west.horizontal.max": np.hypot(*loads["west"][:2]),
        "anchor.east.vertical.max": loads["east"][2],
        "anchor.east.total.max": np.linalg.norm(loads["east"]),
        "offset.buoy.max": np.hypot(*(buoy[:2] - [0.5, 0.0])),
        "depth.buoy.mean": -buoy[2],
        "z.west.final": -10.0,
        "anchor.west.uplift.max": np.arctan2(loads["west"][2], np.hypot(*loads["west"][:2])),
        "line.west-leg.fairlead.tension.max": pose.tension[west.links.stop - 1],
        "line.west-leg.anchor.angle.max": _angle(pose.positions, west.nodes.start, west.nodes.start + 1),
        "line.west-leg.buoy.angle.mean": _angle(pose.positions, west.nodes.stop - 1, west.nodes.stop - 2),
        "line.east-leg.fairlead.angle.min": _angle(pose.positions, east.nodes.start, east.nodes.start + 1),
        "curvature.east-leg.max": curvature(scene, pose.positions[None])[0, east.nodes].max(),
    }
    for name, value in expected.items():
        assert float(quantity(name, model).of_pose(model, pose.state)) == pytest.approx(value, rel=1e-9), name


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tensoin.max", "'tensoin' is not a signal; did you mean 'tension'?"),
        ("tension.west-leg.maxi", "'maxi' is not a statistic; did you mean 'max'?"),
        ("tension.west-lag.max", "'west-lag' is not a line; did you mean 'west-leg'?"),
        ("tension.west-leg.farlead.max", "'farlead' is not an end of line 'west-leg'; did you mean 'fairlead'?"),
        ("tension.7.max", "'7' is not a link; allowed: 1 to 6"),
        ("anchor.buoy.total.max", "'buoy' is not a fixed point; known: east, west"),
        ("anchor.west.horizontl.max", "'horizontl' is not a direction; did you mean 'horizontal'?"),
        ("anchor.west.max", "has no direction; allowed: horizontal, vertical, total, uplift"),
        ("offset.buo.max", "'buo' is not a point; did you mean 'buoy'?"),
        ("offset.max", "has no node; allowed: such as offset.buoy.max"),
        ("energy.1.max", "'1' is not a part; allowed: energy.max"),
        ("angle.max", "has no link"),
        ("line.west-leg.angle.max", "has no end and signal; allowed: such as line.leg.fairlead.angle.max"),
        ("line.west-leg.fairlaed.angle.max", "'fairlaed' is not an end of line 'west-leg'; did you mean 'fairlead'?"),
        ("line.max", "has no end; allowed: such as line.leg.first.angle.max"),
        ("curvature.west-leg.first.max", "allowed: a line of two links or more"),
        ("curvature.2.max", "'2' is not a line"),
    ],
)
def test_a_wrong_name_shows_the_near_ones(posed, name, words, refusal):
    message = refusal(quantity, name, posed[1], "to")
    assert words in message
    assert message.startswith(f"to: {name!r}")


def test_the_anchor_of_a_single_line_is_its_fixed_end_also_if_the_free_end_is_listed_first():
    line = line_of("chain-1", "top", "low", 4, 0.3, mass=0.1)
    model = dj.build_model(scene_of({"low": free_at([0.0, 0.0, -1.2]), "top": [0.0, 0.0, 0.0]}, line))
    assert quantity("tension.chain-1.anchor.max", model).members == (0,)
    assert quantity("tension.chain-1.fairlead.max", model).members == (3,)
    with pytest.raises(SceneError, match="'chain' is not a line"):  # the number in a name is not that of a piece
        quantity("tension.chain.max", model)


def test_a_line_named_as_a_piece_of_another_one_is_a_line_of_its_own():
    points = {"west": [-2.0, 0.0, 0.0], "low": free_at([0.0, 0.0, -1.0], mass=1.0), "east": [2.0, 0.0, 0.0]}
    lines = (line_of("leg", "west", "low", 2, 1.2, mass=0.1), line_of("leg-1", "low", "east", 3, 0.8, mass=0.1))
    model = dj.build_model(scene_of(points, *lines))
    assert quantity("tension.leg.max", model).members == (0, 1)
    assert quantity("tension.leg-1.max", model).members == (2, 3, 4)


@pytest.mark.parametrize("name", NAMES)
def test_every_statistic_of_one_sample_is_that_sample_or_no_variation(name):
    found = statistic(name, jnp.full((1, 2), 3.0), 0.1)
    assert found == pytest.approx(0.0 if name in ("std", "fatigue", "peak") else 3.0)


def test_a_static_target_needs_no_statistic(posed):
    _, model, pose = posed
    for name in ("tension.west-leg.fairlead", "depth.buoy", "anchor.west.horizontal", "tension.west-leg.max"):
        value = float(static_quantity(name, model, "target").of_pose(model, pose.state))
        full = name if name.endswith(".max") else f"{name}.start"
        assert value == pytest.approx(float(quantity(full, model).of_pose(model, pose.state)))


TWO = (["point.buoy.volume", "line.west-leg.length"], [0.1, 9.0], [0.3, 11.0], ["anchor.west.uplift", "depth.buoy"])


def test_design_reaches_two_targets_with_two_unknowns():
    found = solve_design(SCENE, *TWO, [0.65, 3.6])
    assert found.status == "ok"
    assert found.solves <= 12  # exact derivatives: Newton's steps, not a search
    assert list(found.values) == TWO[0]
    pose = dj.equilibrium(found.scene)
    load = fixed_point_loads(found.scene, pose.positions, pose.tension)["west"]
    assert np.arctan2(load[2], np.hypot(*load[:2])) == pytest.approx(0.65, rel=1e-6)
    west, _ = line_slices(found.scene)
    assert -pose.positions[west.nodes.stop - 1, 2] == pytest.approx(3.6, rel=1e-6)


def test_design_reports_targets_that_are_out_of_reach():
    found = solve_design(SCENE, *TWO, [0.65, 1.0])
    assert found.status == "not_reached"
    assert "reaches" in found.message
    assert "at a bound" in found.message
    assert all(low <= x <= high for x, low, high in zip(found.values.values(), *TWO[1:3], strict=True))


@pytest.mark.parametrize(
    ("paths", "targets", "words"),
    [
        (TWO[0], ["depth.buoy", "z.buoy"], "the system is singular"),
        (TWO[0], ["depth.buoy"], "2 values for 1 targets with 1 goals; allowed: as many"),
        (2 * TWO[0][:1], ["depth.buoy", "x.buoy"], "vary: .*: the same twice"),
    ],
)
def test_design_refuses_systems_without_a_unique_solution(paths, targets, words):
    with pytest.raises(SceneError, match=words):
        solve_design(SCENE, paths, [0.1, 9.0], [0.3, 11.0], targets, [-4.5 if t == "z.buoy" else 4.5 for t in targets])


def test_the_command_prints_values_targets_and_angles(printed, json_of, file_of):
    file = file_of(SCENE)
    vary = [f"--vary={path}={low}:{high}" for path, low, high in zip(*TWO[:3], strict=True)]
    wanted = [f"--target={TWO[3][0]}", "--value=0.65", f"--target={TWO[3][1]}", "--value=3.6"]
    found = json_of(["design", file, *vary, *wanted, "--json"])
    assert [row["path"] for row in found["values"]] == TWO[0]
    assert [row["reached"] for row in found["targets"]] == pytest.approx([0.65, 3.6], rel=1e-6)
    assert (found["path"], found["target"]) == (TWO[0][0], TWO[3][0])
    one = [vary[0], "--target=line.west-leg.anchor.angle", "--value=0.65"]
    assert "angles of the line there, upwards" in printed(["design", file, *one]).out


def test_extremes_over_steps_are_those_of_the_members_of_each_quantity():
    model, start = dj.build(SCENE)
    names = ("tension.west-leg.max", "tension.min", "tension.mean", "z.buoy.max")
    watch = quantity_signals([quantity(name, model) for name in names], start.r)
    found, t = watch(model, start, start)
    tension = np.asarray(start.tension)
    np.testing.assert_allclose(found[: len(tension)], tension)
    np.testing.assert_allclose(found[len(tension) :], [tension[:3].max(), tension.min(), start.r[-1, 2]])
    assert float(t) == float(start.t)
    rows = Extremes(*(np.stack([found - 1.0, found - 2.0]), np.stack([found + 1.0, found + 2.0]), None, None))
    by_name = {one.name: np.asarray(values) for one, values in watch.over_steps(rows).items()}
    assert by_name.keys() == set(names) - {"tension.mean"}  # a mean has no extremes
    np.testing.assert_allclose(by_name["tension.west-leg.max"], tension[:3].max() + [1.0, 2.0])
    np.testing.assert_allclose(by_name["tension.min"], tension.min() - [1.0, 2.0])
