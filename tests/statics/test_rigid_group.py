"""The 6x6 stiffness of points that move as one rigid body: MoorPy, forces that turn, another reference."""

import json
from pathlib import Path

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.modelling.build import build_model, equilibrium
from dropper_jax.modelling.fixed_points import without_body
from dropper_jax.statics.rigid_group import moved_to, stiffness_of_group

#: Six moorings with the matrices that MoorPy gives: chains on the bed, polyester, six lines, uneven lengths, two lines.
KNOWN = json.loads((Path(__file__).parent / "moorpy_group.json").read_text())["rows"]
#: The mooring without contact with the bed, which few links resolve.
TAUT = 2


def scene_of(mooring, links):
    points, lines = [], []
    for i, (fairlead, anchor, length) in enumerate(zip(mooring["fair"], mooring["anchor"], mooring["L"], strict=True)):
        points += [{"name": f"anchor-{i}", "position": anchor}, {"name": f"fairlead-{i}", "position": fairlead}]
        line = {"name": f"line-{i}", "from": f"anchor-{i}", "to": f"fairlead-{i}", "links": links}
        line |= {"length": length / links, "mass": mooring["m"] * length / links, "diameter": mooring["d"]}
        lines.append(line | {"axial": {"law": "rope", "EA": mooring["EA"]}})
    effects = {"weight": {}, "buoyancy": {}, "seabed": {"stiffness": 1e5}}
    return dj.load_scene(
        {
            "run": {"duration": 1.0},
            "point": points,
            "line": lines,
            "sea": {"depth": mooring["depth"]},
            "effects": effects,
        }
    )


def matrix_of(mooring, links, about=(0.0, 0.0, 0.0)):
    scene = scene_of(mooring, links)
    names = [f"fairlead-{i}" for i in range(len(mooring["L"]))]
    return stiffness_of_group(build_model(scene), equilibrium(scene).state, names, about).matrix


def difference(matrix, known):
    """The largest difference of an element, over the geometric mean of the diagonal elements of its row and column."""
    size = np.sqrt(np.abs(np.diag(known)))
    return np.max(np.abs(matrix - known) / np.outer(size, size))


@pytest.mark.check
@pytest.mark.parametrize(
    ("row", "links", "within"),
    # lines on the bed need many links: the touchdown lies on one of them
    [(KNOWN[TAUT], 40, 1e-3), *((row, 600, 5e-3) for row in KNOWN)],
)
def test_moorings_have_the_stiffness_of_moorpy(row, links, within):
    assert difference(matrix_of(row["mooring"], links), np.array(row["stiffness"])) < within


@pytest.mark.check
def test_a_mooring_of_equal_sectors_is_as_stiff_along_y_as_along_x():
    matrix = matrix_of(KNOWN[TAUT]["mooring"], links=40)
    assert matrix[0, 0] == pytest.approx(matrix[1, 1], rel=1e-9)


def test_forces_turn_with_the_arms():
    """Two springs in line on a bar: turned by w they pull back by `2 T a w`, besides what stretches them."""
    pull, arm = 1000.0, 2.0
    stiffness = 5e4
    points = [{"name": "a", "position": [-12.0, 0, 0]}, {"name": "b", "position": [-arm, 0, 0]}]
    points += [{"name": "c", "position": [arm, 0, 0]}, {"name": "d", "position": [12.0, 0, 0]}]
    line = {"links": 2, "length": 5.0 / (1.0 + pull / (10.0 * stiffness)), "mass": 1e-6}
    line["axial"] = {"law": "elastic", "EA": 10.0 * stiffness}
    lines = [{**line, "name": "left", "from": "a", "to": "b"}, {**line, "name": "right", "from": "c", "to": "d"}]
    scene = dj.load_scene({"run": {"duration": 1.0}, "point": points, "line": lines, "effects": {"weight": {}}})
    matrix = stiffness_of_group(build_model(scene), equilibrium(scene).state, ["b", "c"], [0, 0, 0]).matrix
    across = 2.0 * pull / 10.0
    assert matrix[1, 1] == pytest.approx(across, rel=1e-3)
    assert matrix[4, 4] == pytest.approx(across * arm**2 + 2.0 * pull * arm, rel=1e-3)
    assert matrix[5, 5] == pytest.approx(across * arm**2 + 2.0 * pull * arm, rel=1e-3)


def test_a_group_without_points_is_refused(refusal):
    message = refusal(stiffness_of_group, build_model(dj.load_scene("paper-case-4")), None, [], [0, 0, 0])
    assert message == "points: 'group' has none; allowed: one or more fixed points"


@pytest.mark.check
def test_another_reference_and_back_is_the_same_matrix():
    scene = dj.load_scene("ballasted-spar")
    model = build_model(scene)
    pose = equilibrium(scene).state
    whole = dj.mooring_stiffness(model, pose, ["spar"]).matrix
    arm = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(moved_to(moved_to(whole, arm), -arm), whole, atol=1e-6 * np.abs(whole).max())
    # the lines alone have neither the waterline nor the righting moment of the spar
    held, names = without_body(scene, "spar", model, pose)
    lines = stiffness_of_group(build_model(held), equilibrium(held).state, names, [0, 0, 0]).matrix
    assert names == ["base"]
    assert abs(lines[2, 2]) < 1e-3 * whole[2, 2]
