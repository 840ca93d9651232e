"""Mooring stiffness: closed forms, MoorPy's numbers, differences of poses solved again, and what is refused."""

import csv
import errno
from dataclasses import replace

import against_moorpy
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax import mooring_stiffness

#: Nearly weightless wire, drawn tight along x.
EA, LENGTH, SPAN = 1e4, 8.0, 8.1
WIRE = system(
    [fixed("a", 0.0, 0.0, 0.0), free("middle", 4.0, 0.0, 0.0, mass=0.0, volume=0.0), fixed("b", SPAN, 0.0, 0.0)],
    [line_of(*ends, 2, LENGTH / 2, type="wire") for ends in (("left", "a", "middle"), ("right", "middle", "b"))],
    line_type=[{"name": "wire", "mass": 1e-4, "diameter": 0.01, "EA": EA}],
)


@pytest.fixture(scope="module")
def wire():
    model = dj.build(WIRE)[0]
    return model, dj.equilibrium(model)


def test_a_tight_wire_is_a_spring_along_itself_and_a_string_across(wire):
    """Ends: EA/L along, T/l across; its middle: twice those of a half."""
    model, pose = wire
    along, across = EA / LENGTH, EA * (SPAN / LENGTH - 1) / SPAN
    ends = mooring_stiffness(model, pose.state, ["a", "b"])
    one = np.diag([along, across, across])
    np.testing.assert_allclose(ends.matrix, np.block([[one, -one], [-one, one]]), rtol=1e-4, atol=1e-4)
    middle = mooring_stiffness(model, pose.state, ["middle"])
    np.testing.assert_allclose(middle.matrix, 4 * one, rtol=1e-4, atol=1e-4)
    assert middle.freedoms == ("middle.x", "middle.y", "middle.z")
    # what is asked for together is the same whichever way round
    turned = mooring_stiffness(model, pose.state, ["b", "middle"]).matrix
    np.testing.assert_allclose(mooring_stiffness(model, pose.state, ["middle", "b"]).matrix[:3, 3:], turned[3:, :3])


def test_the_force_on_a_fixed_point_is_that_of_poses_solved_again(wire):
    model, pose = wire
    found = mooring_stiffness(model, pose.state, ["b"]).matrix
    move, pulls = 1e-4, []
    for sign in (1.0, -1.0):
        points = list(model.points)
        points[2] = replace(points[2], position=points[2].position + np.array([0.0, 0.0, sign * move]))
        at = dj.equilibrium(replace(model, points=tuple(points)))
        last = at.positions[-1] - at.positions[-2]
        pulls.append(-at.tension[-1] * last / np.linalg.norm(last))
    np.testing.assert_allclose(found[:, 2], -(pulls[0] - pulls[1]) / (2 * move), rtol=1e-5, atol=1e-5)


@pytest.mark.check
@pytest.mark.parametrize("name", ["bridles", "floats", "spread"])
def test_sample_systems_have_the_stiffness_of_moorpy(name):
    assert against_moorpy.stiffness(name, against_moorpy.known("stiffness")[name])[0] < 0.01


def test_what_is_no_point_or_not_held_is_named(wire):
    model, pose = wire
    with pytest.raises(dj.SceneError, match="points: 'midle' is not a point of the scene; did you mean 'middle'"):
        mooring_stiffness(model, pose.state, ["midle"])
    with pytest.raises(dj.SceneError, match="points: 'b' is given twice"):
        mooring_stiffness(model, pose.state, ["b", "b"])
    rigid = dj.build("string")[0]
    with pytest.raises(dj.SceneError, match="'rigid' has no axial stiffness.*: elastic, rope, damped_rope, tabulated"):
        mooring_stiffness(rigid, dj.initial_state(rigid, dj.load_scene("string").start), ["right"])


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "wire.toml"
    path.write_text(dj.as_toml(WIRE))
    return str(path)


def test_command_prints_and_writes_the_matrix(file, tmp_path, printed, json_of):
    out = tmp_path / "matrix.csv"
    found = json_of(["stiffness", file, "--points", "b", "--json", "--out", str(out)])
    assert found["status"] == "ok"
    assert found["freedoms"] == ["b.x", "b.y", "b.z"]
    assert found["stiffness"][0][0] == pytest.approx(EA / LENGTH, rel=1e-4)
    head, first, *_ = csv.reader(out.read_text().splitlines())
    assert head == ["freedom", "b.x", "b.y", "b.z"]
    assert [float(x) for x in first[1:]] == found["stiffness"][0]
    assert "middle.x" in printed(["stiffness", file]).out  # all free points


def test_a_matrix_that_cannot_be_written_leaves_the_file_of_before(file, tmp_path, printed, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "matrix.csv"
    out.write_text("before")
    monkeypatch.setattr("os.fsync", fail)
    assert "cannot be written" in printed(["stiffness", file, "--points", "b", "--out", str(out)], 3).err
    assert out.read_text() == "before"


@pytest.mark.check
def test_a_slack_chain_on_a_smooth_bed_leaves_its_buoy_a_stiffness(json_of):
    """It moves freely across the bed, which is nothing to the buoy: that feels its waterplane, and nothing sideways."""
    found = json_of(["stiffness", "paper-case-1", "--json"])
    matrix = np.array(found["stiffness"])
    assert matrix.shape == (3, 3)
    assert matrix[2, 2] > 1e3
    assert np.abs(matrix[:2, :2]).max() < 1e-3 * matrix[2, 2]
