"""Scenes that are valid but cannot be meant are warned of once, by their cause; scenes that work are not."""

import json

import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

from dropper_jax import SceneError, load_scene, packaged_scene, scene_names
from dropper_jax.cli import main
from dropper_jax.plausibility.plausibility import plausibility_warnings, with_cause
from dropper_jax.plausibility.pose_remarks import check_stretch, pose_remarks

DEPTH = 20.0


def longline(anchors=("west", "east"), **values):
    """A backbone of 40 m with two floats and three hanging ropes, on legs of 60 m to fixed points on the bed."""
    given = {
        "z": -DEPTH,
        "depth": DEPTH,
        "leg": 60.0,
        "volume": 0.3,
        "speed": 0.5,
        "reference": 0.0,
        "hang": 8.0,
    } | values
    west, east = anchors
    points = {west: [-50.0, 0.0, given["z"]], east: [90.0, 0.0, given["z"]]}
    for k in (0, 1):
        points[f"b{k + 1}"] = {"float": given["volume"], "position": [40.0 * k, 0.0, -0.5]}
    lines = [
        line_of(name, one, end, 6, given["leg"], type="library:chain-studless-0.022")
        for name, one, end in (("west-leg", west, "b1"), ("east-leg", east, "b2"))
    ]
    attached = [{"point": f"t{k}", "at": 10.0 * k} for k in (1, 2, 3)]
    lines.append(line_of("backbone", "b1", "b2", 4, 40.0, type="library:rope-polypropylene-0.03", attach=attached))
    for k in (1, 2, 3):
        points[f"e{k}"] = free_at([10.0 * k, 0.0, -9.0], mass=1.0)
        lines.append(line_of(f"rope-{k}", f"t{k}", f"e{k}", 2, given["hang"], type="library:mussel-dropper-7.53"))
    current = {"kind": "power", "speed": given["speed"], "reference": given["reference"], "exponent": 0.25}
    sea = {"depth": given["depth"], "current": current}
    effects = {name: {} for name in ("weight", "buoyancy", "morison_drag", "morison_inertia", "seabed")}
    return scene_of(points, *lines, sea=sea, effects=effects)


def hanging(length, mass, apart=0.28, **line):
    """A chain of rigid links between two hooks."""
    ends = {"left": [0.0, 0.0, 0.0], "right": [apart, 0.0, 0.0]}
    return scene_of(ends, line_of("lab", "left", "right", 5, length, mass=mass, **line))


LENGTH, MASS = [0.12, 0.09, 0.15, 0.07, 0.11], [0.04, 0.03, 0.05, 0.024, 0.037]


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (longline(z=DEPTH), "west, east: fixed 20 m above the surface of water 20 m deep"),
        (longline(z=12.0, anchors=("a", "b")), "a, b: fixed 12 m above the surface"),
        (longline(depth=32.0, anchors=("a", "b")), "a, b: fixed 12 m above the seabed"),
        (longline(depth=23.0, anchors=("anchor-1", "x")), "anchor-1, x: fixed 3 m above the seabed"),
        (longline(leg=30.0), "west-leg, east-leg: 30 m between points 53.67 m apart: about"),
        (longline(leg=42.0), "west-leg, east-leg: 42 m between points 53.67 m apart: about"),
        (longline(volume=0.001), "floats: their net lift with all masses is -10.89 N, and lines of"),
        (longline(volume=0.02, hang=12.0), "floats: their net lift"),
        (longline(speed=30.0), "sea.current: 30 m/s, more than 5 m/s"),
        (longline(speed=4.0, reference=-0.75 * DEPTH), "sea.current: 5.657 m/s"),  # 4^(1/4) times as fast above
        (hanging([1e3 * x for x in LENGTH], MASS), "lab: 540 m long, with links of up to 150 m, between points 0.28 m"),
        (hanging([1e2 * x for x in LENGTH], MASS, apart=0.45), "lab: 54 m long"),
        (
            hanging(LENGTH, [1e3 * x for x in MASS]),
            "lab: 50 kg in a link of 0.15 m, 333.3 kg/m: as much as a bar of steel 0.23 m thick",
        ),
        (hanging(LENGTH, [1e3 * x for x in MASS], diameter=0.01), "denser than any metal"),
        (hanging(0.3, 100.0, apart=1.0), "lab: 100 kg in a link of 0.3 m, 333.3 kg/m"),
    ],
)
def test_a_scene_that_cannot_be_meant_is_warned_of_once_by_its_cause(scene, words):
    (warning,) = plausibility_warnings(load_scene(scene))
    assert words in warning
    assert "\n" not in warning


@pytest.mark.parametrize(
    "scene",
    [
        longline(),
        longline(z=-DEPTH + 0.8, anchors=("anchor-1", "anchor-2")),  # blocks on the bed
        longline(z=-3.0, anchors=("pile-1", "pile-2")),  # tied to piles in mid-water
        longline(speed=2.5),
        hanging(LENGTH, MASS),
        hanging(LENGTH, MASS, diameter=0.008),
        hanging(0.3, 5.0, apart=1.0),  # with heavy bobs
    ],
)
def test_a_scene_that_works_is_not(scene):
    assert plausibility_warnings(load_scene(scene)) == ()


@pytest.mark.parametrize("name", [name for name in scene_names() if not name.endswith("-undamped")])
def test_no_packaged_scene_is_doubtful(name):
    scene = load_scene(name)
    if scene.season is None and all(line.growth is None for line in scene.lines):  # growth needs an equilibrium
        assert plausibility_warnings(scene) == ()


def test_the_tension_of_a_line_that_is_too_short_is_that_of_springs_in_series():
    """A rope of 10 m and one of 20 m between points 36 m apart: T = 6 m/(10 m/EA + 20 m/(2 EA))."""
    scene = scene_of(
        {"a": [0.0, 0.0, 0.0], "m": free_at([10.0, 0.0, 0.0]), "b": [36.0, 0.0, 0.0]},
        line_of("one", "a", "m", 2, 5.0, mass=1.0, axial={"EA": 1e4}),
        line_of("two", "m", "b", 2, 10.0, mass=1.0, axial={"EA": 2e4}),
    )
    (warning,) = plausibility_warnings(load_scene(scene))
    assert warning.startswith("two: 20 m between points 26 m apart: about 3e+03 N at rest, stretched by more than 10%")
    scene["line"][0]["breaking_load"] = 4e3  # stronger, but the strain counts too
    assert "stretched by more than 10%" in plausibility_warnings(load_scene(scene))[0]
    scene["line"][0]["breaking_load"] = 900.0
    assert "above the breaking load of 900 N" in plausibility_warnings(load_scene(scene))[0]


def test_a_start_that_fails_names_the_doubtful_value_first():
    scene = load_scene(longline(speed=30.0))
    torn = np.cumsum(np.full((scene.line.links + len(scene.lines), 3), 10.0), axis=0)
    with pytest.raises(SceneError, match=r"^sea.current: 30 m/s.*; line 'west-leg': is stretched by .* current"):
        check_stretch(scene, torn)
    usual = SceneError("start: no equilibrium")
    assert with_cause(usual, load_scene(longline())) is usual


def test_many_lines_above_their_breaking_load_are_one_remark():
    scene = load_scene(longline())
    tension = np.full(scene.line.links, 1e6)
    positions = np.zeros((scene.line.links + len(scene.lines), 3))
    (remark,) = [text for text in pose_remarks(scene, positions, tension) if "breaking" in text]
    assert "more: 1e+06 N at rest, above its breaking load" in remark


DECK = """MoorDyn v2: a winch shortens a line during the run
---- LINE TYPES ----
Name   Diam   Mass/m   EA      BA/-zeta  EI   Cd   Ca   CdAx  CaAx
(-)    (m)    (kg/m)   (N)     (N-s/-)   (Nm2) (-) (-)  (-)   (-)
chain  0.10   70.0     3.0E8   -0.8      0    1.3  1.0  0.2   0.0
---- POINTS ----
ID  Type     X      Y     Z      Mass  Volume  CdA  Ca
(#) (-)      (m)    (m)   (m)    (kg)  (m3)    (m2) (-)
1   Fixed   160.0   0.0  -80.0   0     0       0    0
2   Coupled  0.0    0.0  -10.0   0     0       0    0
---- LINES ----
ID  LineType AttachA AttachB UnstrLen NumSegs Outputs
(#) (-)      (#)     (#)     (m)      (-)     (-)
1   chain    1       2       185.0    6      -
---- CONTROL ----
ChannelID  Line(s)
()         (,)
1          1
---- OPTIONS ----
80.0    WtrDpth
0.02    dtM
---- OUTPUTS ----
FairTen1
END
"""


@pytest.mark.parametrize("command", ["check", "equilibrium", "stiffness"])
def test_commands_give_the_notes_of_an_import(tmp_path, capsys, command):
    file = tmp_path / "winch.txt"
    file.write_text(DECK)
    more = ["--points", "point-2"] if command == "stiffness" else []
    main([command, str(file), *more, "--json"])
    shown = capsys.readouterr()
    words = "section CONTROL is not represented"
    assert shown.err.count(words) == 1
    if command != "stiffness":
        found = json.loads(shown.out)["warnings"]
        assert [words in text for text in found].count(True) == 1
        assert found[: len(load_scene(file).notes)] == list(load_scene(file).notes)


def test_every_note_of_a_packaged_scene_is_one_line():
    assert all("\n" not in note for name in scene_names() for note in packaged_scene(name).get("notes", []))
