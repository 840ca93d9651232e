"""Remarks on poses at rest, and warnings of ends that start at once."""

import json

import numpy as np
import pytest
from hard_scenes import hung_line
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax import SceneError, load_scene
from dropper_jax.load.system_warnings import motion_warnings
from dropper_jax.plausibility.pose_remarks import pose_remarks
from dropper_jax.quantities.end_forces import end_forces


def moored(**motion):
    """A spar on a rope from the bed, 30 m below, and friction there."""
    kind = {"name": "rope", "mass": 1.0, "diameter": 0.02, "EA": 1e5}
    spar = {"name": "spar", "point": "buoy", "mass": 1200.0, "diameter": 0.79, "height": 8.0, "attachment": 1.0}
    effects = {"weight": {}, "seabed": {}, "seabed_friction": {"kinetic": 0.5}}
    return scene_of(
        {"anchor": [0.0, 0.0, -30.0], "buoy": free_at([0.0, 0.0, -2.5])},
        line_of("rope", "anchor", "buoy", 4, 40.0, type="rope"),
        line_type=[kind],
        buoy=[spar],
        sea={"depth": 30.0},
        effects=effects | ({"end_motion": {"point": "anchor", **motion}} if motion else {}),
    )


@pytest.mark.parametrize(
    ("z", "level", "expected"),
    [
        (-2.5, 0.0, []),
        (-7.5, 0.0, ["under water"]),
        (-29.0, 0.0, ["under water", "on the seabed"]),
        (-12.5, -10.0, []),
        (-2.5, 6.0, ["under water"]),
    ],
)
def test_buoys_under_water_or_on_the_bed_are_remarked(z, level, expected):
    scene = load_scene({**moored(), "sea": {"depth": 30.0, "level": {"offset": level}}})
    positions = np.zeros((5, 3))
    positions[-1, 2] = z
    found = [text for text in pose_remarks(scene, positions, np.zeros(4)) if text.startswith("spar")]
    assert len(found) == len(expected)
    assert all(words in remark for words, remark in zip(expected, found, strict=True))
    if "under water" in expected:
        assert f"{level - (z - 1.0 + 8.0):.3g} m under water" in found[0]


def rope(breaking_load):
    line = hung_line(2, 5.0, 10.0, breaking_load=breaking_load, axial={"law": "rope", "EA": 1e5})
    return line | {"run": {"dt": 0.01, "duration": 0.02}}


def test_a_line_beyond_its_breaking_load_at_rest_is_remarked(printed, file_of):
    """It carries 196.2 N."""
    weak = load_scene(rope(190.0))
    assert any("196.2 N at rest, above its breaking load of 190 N" in w for w in dj.simulate(weak).warnings)
    assert not any("breaking load" in w for w in dj.simulate(rope(200.0)).warnings)
    shown = printed(["equilibrium", file_of(weak), "--json"])
    assert "above its breaking load" in json.loads(shown.out)["warnings"][0]
    assert "warning: rope" in shown.err


RISING = {"time": [0.0, 0.5, 1.0], "displacement": [[0.0, 0.0, 0.0], [0.4, 0.3, 0.0], [0.8, 0.6, 0.0]]}
SINE = {"amplitude": [0.5, 0.0, 0.0], "period": 5.0}


def creeping(speed):
    return {"time": [0.0, 1.0, 2.0], "displacement": [[0.0, 0.0, 0.0], [speed, 0.0, 0.0], [2 * speed, 0.0, 0.0]]}


@pytest.mark.parametrize(
    ("motion", "speed"),
    [
        (SINE, "0.628 m/s"),
        (RISING, "1 m/s"),
        (SINE | {"ramp": 5.0}, None),
        (RISING | {"displacement": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.8, 0.6, 0.0]]}, None),
        (RISING | {"ramp": 1.0}, None),
        # friction of the line is 0.5 * 9.81 * 40 = 196 N; the shock sqrt(1e5 * 1) = 316 N per m/s: 0.16, 1.6 and 16 N
        (creeping(5e-4), None),
        (creeping(5e-3), None),
        (creeping(0.05), "0.05 m/s"),
    ],
)
def test_an_end_that_starts_with_a_shock_over_a_bed_with_friction_is_warned_of(motion, speed):
    scene = moored(**motion)
    found = tuple(motion_warnings(load_scene(scene)))
    assert len(found) == (speed is not None)
    if speed is not None:
        assert f"anchor starts abruptly at {speed}" in found[0]
    del scene["effects"]["seabed_friction"]
    assert not list(motion_warnings(load_scene(scene)))


@pytest.mark.parametrize(("reach", "words"), [(20.5, None), (23.0, "stretched by 15%"), (41.0, "torn")])
def test_a_line_that_is_much_too_short_is_warned_of_or_refused(reach, words):
    line = line_of("rope", "a", "b", 2, 10.0, mass=10.0, nodes="shared", axial={"law": "rope", "EA": 1e6})
    scene = scene_of({"a": [0.0, 0.0, 0.0], "b": [reach, 0.0, 0.0]}, line)
    if words == "torn":
        with pytest.raises(SceneError, match=r"line 'rope': is stretched by 105% at rest, more than 50%"):
            dj.simulate(scene)
    else:
        found = [text for text in dj.simulate(scene).warnings if "stretched" in text]
        assert found == ([] if words is None else ["rope: is stretched by 15% at rest; check its length and EA"])


def sock(links, length=30.0):
    """A mussel sock between two points 10 m apart, in a current across it."""
    table = scene_of(
        {"a": [0.0, 0.0, -5.0], "b": [10.0, 0.0, -5.0]},
        line_of("sock", "a", "b", links, length, type="sock"),
        line_type=[{"name": "sock", "mass": 19.1, "diameter": 0.15, "EA": 1e6, "cdn": 1.3, "cdt": 0.05}],
        sea={"depth": 50.0, "current": {"kind": "uniform", "speed": 0.5, "direction": 1.5}},
        effects={"weight": {}, "buoyancy": {}, "morison_drag": {}},
    )
    return load_scene(table)


def test_links_that_are_too_few_for_the_forces_at_the_ends_are_warned_of():
    force, warned = {}, {}
    for links in (4, 24):
        scene = sock(links)
        pose = dj.equilibrium(scene)
        force[links] = end_forces(scene, pose.positions[None], pose.tension[None])["sock"][0]
        warned[links] = [text for text in pose_remarks(scene, pose.positions, pose.tension) if "too few links" in text]
    assert np.max(np.abs(force[4] / force[24] - 1.0)) > 0.05
    assert len(warned[4]) == 1
    assert warned[24] == []


@pytest.mark.parametrize(("links", "sag", "warned"), [(3, 1.0, True), (3, 0.1, False), (6, 1.0, False)])
def test_a_sag_of_three_links_is_warned_of(links, sag, warned):
    """A taut line of three links turns by 11 and 1 degrees; tensions of six are off by 1/(2 6^2) = 1.4 %."""
    x = np.linspace(0.0, 10.0, links + 1)
    positions = np.stack([x, 0.0 * x, -5.0 - sag * 4.0 * x / 10.0 * (1.0 - x / 10.0)], axis=1)
    found = pose_remarks(sock(links, 10.3), positions, np.full(links, 1e3))
    assert any("too few links" in text for text in found) == warned


def bent_rope(law):
    """A line with bending stiffness that stands on a clamp."""
    bending = {"EI": 20.0, "clamped": ["wall"], "directions": [[0.0, 0.0, 1.0]]}
    return scene_of(
        {"wall": [0.0, 0.0, 0.0], "tip": free_at([0.5, 0.0, 0.5])},
        line_of("rod", "wall", "tip", 4, 0.2, mass=0.1, axial={"law": law, "EA": 1e5, "damping": 100.0}),
        run={"accuracy": 0.01, "duration": 0.3},
        start={"kind": "angles", "polar": [3.0] * 4},
        effects={"weight": {}, "linear_damping": {"b_l": 0.1}, "bending": bending},
    )


@pytest.mark.check
@pytest.mark.parametrize(("law", "warned"), [("rope", True), ("elastic", False)])
def test_links_that_collapse_under_compression_are_warned_of(law, warned):
    """A rod stands on its clamp: it carries its weight by compression, which a rope does not."""
    solution = dj.simulate(bent_rope(law))
    found = [text for text in solution.warnings if text.startswith("rod: link 1 is compressed to")]
    assert bool(found) == warned
    assert all("Use axial law 'elastic'" in text for text in found)


@pytest.mark.check
def test_a_start_that_collapses_under_compression_is_refused_and_the_law_that_holds_is_named():
    """A rod between points that are closer together than its length: it buckles, a rope collapses."""
    points = [{"name": "wall", "position": [0.0, 0.0, 0.0]}, {"name": "tip", "position": [0.6, 0.0, 0.0]}]
    rope = {**bent_rope("rope"), "start": {"kind": "static"}, "point": points}
    rope["effects"]["bending"]["directions"] = [[1.0, 0.0, 0.0]]
    with pytest.raises(SceneError, match="is compressed to .* of its length: use axial law 'elastic' with bending"):
        dj.simulate(rope)
    rope["line"][0]["axial"]["law"] = "elastic"
    assert dj.simulate(rope).status == "ok"
