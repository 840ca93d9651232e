"""Forces at the ends of coarse lines against the catenary; what lines weigh in water, and warnings of floating ones."""

import numpy as np
import pytest
from scene_parts import line_of, scene_of
from scipy.optimize import brentq

import dropper_jax as dj
from dropper_jax import report_run
from dropper_jax.cli import main
from dropper_jax.plausibility.line_weights import floating_warnings, line_weights
from dropper_jax.quantities.end_forces import end_forces

SPAN, LENGTH, MASS = 30.0, 40.0, 8.0
WATER = {"weight": {}, "buoyancy": {}, "morison_drag": {}}


def hanging(links=8, mass=MASS, diameter=0.06, name="rope", **more):
    """A line by the metre between two points at one height, in water."""
    kind = {"name": "kind", "mass": mass, "diameter": diameter, "EA": 1e9, "cdn": 1.2, "cdt": 0.0}
    return scene_of(
        {"a": [0.0, 0.0, -2.0], "b": [SPAN, 0.0, -2.0]},
        line_of(name, "a", "b", links, LENGTH, type="kind"),
        run={"dt": 0.05, "duration": 0.2},
        line_type=[kind],
        **{"sea": {"depth": 50.0, "density": 1000.0}, "effects": WATER, **more},
    )


@pytest.fixture(scope="module")
def run():
    return dj.simulate(hanging())


def test_end_forces_of_a_coarse_line_are_those_of_the_catenary_and_link_tensions_are_not(run):
    weight = 9.81 * (MASS - 1000.0 * np.pi / 4 * 0.06**2)
    a = brentq(lambda a: 2.0 * a * np.sinh(SPAN / (2.0 * a)) - LENGTH, 5.0, 1e3)
    force = weight * a * np.cosh(SPAN / (2.0 * a))
    link = run.tension[0]
    found = end_forces(run.scene, run.positions[:1], run.tension[:1])["rope"][0]
    assert found == pytest.approx([force, force], rel=0.005)
    assert link[0] < 0.97 * force
    ends = run.end_forces()["rope"]
    assert ends["first"]["mean"] == pytest.approx(force, rel=0.005)
    assert run.summary()["end_forces_n"]["rope"]["last"]["final"] == pytest.approx(force, rel=0.005)
    (line,) = report_run(run)["tension"]
    assert line["mean_first_force_n"] == pytest.approx(force, rel=0.005)
    assert line["mean_first_link_n"] == pytest.approx(link[0], rel=1e-3)


def test_the_bed_carries_the_half_link_next_to_an_anchor_that_is_not_lifted():
    """A catenary that ends on a smooth bed: its horizontal tension a w is all that the anchor feels."""
    depth, span, length = 20.0, 40.0, 56.0
    scene = hanging(links=16, effects=WATER | {"seabed": {"stiffness": 1e6}}, sea={"depth": depth, "density": 1000.0})
    scene["point"][0]["position"], scene["point"][1]["position"] = [0.0, 0.0, -depth], [span, 0.0, 0.0]
    scene["line"][0]["length"] = length
    weight = 9.81 * (MASS - 1000.0 * np.pi / 4 * 0.06**2)

    def too_long(a):
        return length - np.sqrt(depth**2 + 2.0 * a * depth) + a * np.arccosh(1.0 + depth / a) - span

    a = brentq(too_long, 0.1, 50.0)
    pose = dj.equilibrium(scene)
    first, last = end_forces(dj.load_scene(scene), pose.positions[None], pose.tension[None])["rope"][0]
    assert first == pytest.approx(weight * a, rel=0.03)
    assert last == pytest.approx(weight * (a + depth), rel=0.01)
    assert 0.5 * weight * length / 16 > 0.9 * first  # what the bed carries there


def test_ends_of_a_line_by_the_link_have_the_weight_that_its_nodes_carry():
    weight = 9.81 * MASS * 5.0
    link = line_of("rope", "a", "b", 8, 5.0, mass=MASS * 5.0, axial={"law": "rope", "EA": 1e9})
    for nodes in ("far", "shared"):
        scene = scene_of({"a": [0.0, 0.0, -2.0], "b": [SPAN, 0.0, -2.0]}, link | {"nodes": nodes})
        pose = dj.equilibrium(scene)
        across = pose.tension[0] * (pose.positions[1, 0] - pose.positions[0, 0]) / 5.0
        first, last = end_forces(dj.load_scene(scene), pose.positions[None], pose.tension[None])["rope"][0]
        up = [np.sqrt(f**2 - across**2) for f in (first, last)]
        assert sum(up) == pytest.approx(8 * weight, rel=1e-6)  # both ends carry the whole line


def test_commands_print_forces_on_end_points_and_link_tensions(tmp_path, capsys, json_of, file_of):
    file = file_of(hanging())
    found = json_of(["equilibrium", file, "--json"])
    assert found["end_forces_n"]["rope"]["first"] > 1.02 * found["tension_n"][0]
    nodes = np.array(found["positions_m"])
    along = nodes[1] - nodes[0]
    angle = np.degrees(np.arctan2(along[2], np.hypot(*along[:2])))
    assert found["end_angles_deg"]["rope"]["first"] == pytest.approx(angle)
    assert len(found["curvature_per_m"]) == len(nodes)
    assert main(["equilibrium", file, "--plot", str(tmp_path / "pictures")]) == 0
    assert (tmp_path / "pictures" / "along.png").stat().st_size > 5000
    text = capsys.readouterr().out
    assert "angle up [deg]" in text
    assert "force on first point [N]" in text
    assert "weight in water [N/m]" in text
    vary = ["--vary", "line.rope.length=38:45", "--target", "tension.rope.first", "--value", "1075"]
    found = json_of(["design", file, *vary, "--json"])
    assert found["end_forces_n"][0] > 1.01 * found["reached"]
    assert len(found["end_angles_deg"]) == 2


def test_what_lines_weigh_in_water_is_reported(run):
    (row,) = line_weights(run.scene)
    displaced = 1000.0 * np.pi / 4 * 0.06**2
    assert row["lines"] == ["rope"]
    assert row["mass_kg_per_m"] == pytest.approx(MASS)
    assert row["displaced_kg_per_m"] == pytest.approx(displaced)
    assert row["wet_weight_n_per_m"] == pytest.approx(9.81 * (MASS - displaced))
    assert row["density_kg_per_m3"] == pytest.approx(1000.0 * MASS / displaced)
    assert run.summary()["line_weights"][0]["lines"] == ["rope"]


@pytest.mark.parametrize(
    ("mass", "diameter", "name", "warned"),
    [
        (0.884e3 * np.pi / 4 * 0.15**2, 0.15, "line", True),  # as thick as mussels are
        (0.884e3 * np.pi / 4 * 0.06**2, 0.06, "mussels", True),
        (0.884e3 * np.pi / 4 * 0.06**2, 0.06, "anchor-chain", True),
        (0.92e3 * np.pi / 4 * 0.06**2, 0.06, "backbone", False),  # a rope of polypropylene does float
        (1.2e3 * np.pi / 4 * 0.15**2, 0.15, "mussels", False),
    ],
)
def test_a_line_that_is_not_meant_to_float_and_does_is_a_warning(mass, diameter, name, warned):
    scene = dj.load_scene(hanging(mass=float(mass), diameter=diameter, name=name))
    found = floating_warnings(scene)
    assert bool(found) == warned
    assert not warned or found[0].startswith(f"{name}: floats: ")


def test_every_run_warns_of_a_floating_line():
    light = hanging(mass=0.884e3 * np.pi / 4 * 0.06**2, name="mussels")
    light["start"] = {"kind": "points"}
    assert any(text.startswith("mussels: floats: ") for text in dj.simulate(light).warnings)
