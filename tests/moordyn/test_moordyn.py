"""MoorDyn files: there and back, the same statics as MoorDyn itself, result tables, and what is refused or noted."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError, Solution, equilibrium, load_scene, read_moordyn, simulate, write_moordyn
from dropper_jax.cli import main
from dropper_jax.decks.writing.outputs import channel_values, numbers_of, write_out

OTHERS = runpy.run_path(str(Path(__file__).with_name("others.py")))
#: Inputs written for these tests: version 2, version 1, and a current beside it.
FOLDER = Path(__file__).parent
INPUTS = ("chain", "float", "current")
CHAIN, FLOAT = ((FOLDER / f"{name}.txt").read_text() for name in ("chain", "float"))


def statics_of_moordyn(path: Path) -> list[np.ndarray]:
    """Tensions [N] at the nodes of each line at rest."""
    pytest.importorskip("moordyn", reason="the moordyn wheel is not installed (extra `moordyn`)")
    return [np.array(line) for line in OTHERS["at_rest"](path)]


@pytest.mark.check
@pytest.mark.slow
@pytest.mark.parametrize("name", INPUTS)
def test_static_tensions_are_those_of_moordyn_within_one_percent(name, deck):
    path = deck(name)
    scene = load_scene(path)
    pose = equilibrium(scene)
    if name == "float":  # the wheel reads version 2 only
        path = path.with_name("second.txt")
        write_moordyn(scene, path, dt=0.0004, options={"TmaxIC": 60, "ICgenDynamic": 1})
    theirs = statics_of_moordyn(path)
    assert pose.status == "ok"
    first = 0
    for line, tension in zip(scene.lines, theirs, strict=True):
        ours = pose.tension[first : first + line.links]
        first += line.links
        np.testing.assert_allclose(ours[0], tension[0], rtol=0.01)
        np.testing.assert_allclose(ours[-1], tension[-1], rtol=0.01)
        np.testing.assert_allclose(0.5 * (ours[1:] + ours[:-1]), tension[1:-1], rtol=0.01)


@pytest.mark.parametrize("name", ["paper-case-1", "paper-case-2", "paper-case-3"])
def test_a_scene_survives_the_way_to_a_file_and_back(name, tmp_path):
    scene = load_scene(name).with_values({"start.kind": "points"})
    if "seabed_friction" in scene.effects:  # Coulomb's, which decks do not have
        (text,) = write_moordyn(scene, tmp_path / "mooring.txt")
        assert "seabed_friction.law" in text
        scene = scene.with_values({"effects.seabed_friction.law": "moordyn"})
    assert write_moordyn(scene, tmp_path / "mooring.txt") == []
    back = load_scene(tmp_path / "mooring.txt")
    assert back.to_dict() == scene.to_dict()


@pytest.mark.parametrize("name", INPUTS)
def test_an_imported_scene_survives_the_way_to_a_file_and_back(name, deck, tmp_path):
    scene = load_scene(deck(name))
    (tmp_path / "again").mkdir()
    lost = write_moordyn(scene, tmp_path / "again" / "mooring.txt")
    assert [note.split(" (")[0] for note in lost] == ["points that float"] * (name in ("float", "current"))
    back = load_scene(tmp_path / "again" / "mooring.txt").to_dict()
    assert {**back, "notes": list(scene.notes)} == scene.to_dict()


def test_what_each_part_of_a_file_becomes(deck):
    scene = load_scene(deck(FLOAT))
    rope, steel = scene.lines
    # BA of a ratio: zeta * l * sqrt(EA m), l the length of a segment
    assert rope.axial_damping[0] == pytest.approx(1.0 * 4.0 * np.sqrt(2.0e6 * 2.5), rel=1e-12)
    assert steel.axial_damping[0] == 2000.0
    assert (rope.links, rope.total, rope.mass[0]) == (10, pytest.approx(40.0), pytest.approx(10.0))
    # version 1 orders its coefficients Can Cat Cdn Cdt
    assert scene.effects["morison_drag"]["cdn"].tolist() == [1.6] * 10 + [1.2] * 8
    assert scene.effects["morison_inertia"]["can"].tolist() == [1.0] * 18
    joint = scene.point("point-2")
    assert (joint.kind, joint.mass, joint.volume, joint.drag_area, joint.added_mass) == ("free", 60.0, 0.3, 0.2, 0.5)
    assert scene.effects["seabed"]["stiffness"] == 3e6
    assert scene.sea.depth == 50.0
    assert scene.run.dt == 0.001


def test_components_of_a_wave_file_have_the_elevation_that_moordyn_gives_them(deck, tmp_path):
    rows = np.array([[0.5, 0.3, -0.4, 0.2], [0.9, -0.2, 0.1, 0.2], [1.3, 0.0, 0.25, 0.2]])
    lines = ["0 0 0 0", *(" ".join(map(str, row)) for row in rows)]
    (tmp_path / "wave_frequencies.txt").write_text("\n".join(lines))
    path = deck(CHAIN.replace("50            WtrDpth", "7 WaveKin\n50            WtrDpth"))
    from dropper_jax.sea.make import make_sea

    sea = make_sea(load_scene(path).sea)
    x, y, t = 7.0, -3.0, 11.0
    total = 0.0
    for omega, real, imaginary, course in rows:
        k = omega**2 / 9.81
        for _ in range(200):  # the wave number by fixed point, on deep enough water
            k = omega**2 / (9.81 * np.tanh(50.0 * k))
        away = x * np.cos(course) + y * np.sin(course)
        # their convention: eta = sum |A| sin(w t - k . x + arg A)
        total += np.hypot(real, imaginary) * np.sin(omega * t - k * away + np.arctan2(imaginary, real))
    assert float(sea.elevation(np.array([[x, y, 0.0]]), t)[0]) == pytest.approx(total, rel=1e-6)


@pytest.mark.parametrize("law", ["rope", "damped_rope"])
def test_unequal_links_become_lines_joined_at_points(tmp_path, law):
    scene = {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [
            {"name": "chain", "law": law, "mass": 20.0, "diameter": 0.05, "EA": 1e8},
            {"name": "rope", "law": law, "mass": 3.0, "diameter": 0.04, "EA": 1e7, "damping": 300.0},
        ],
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [20.0, 0.0, 0.0]}],
        "line": [
            {
                "name": "mixed",
                "from": "a",
                "to": "b",
                "sections": [
                    {"type": "chain", "length": 10.0, "links": 5},
                    {"type": "rope", "length": 14.0, "links": 7},
                ],
            }
        ],
        "effects": {"weight": {}},
    }
    notes = write_moordyn(scene, tmp_path / "mooring.txt")
    assert any("bed" in note for note in notes)
    back = load_scene(tmp_path / "mooring.txt")
    assert [line.name for line in back.lines] == ["mixed-1", "mixed-2"]
    assert {line.axial_law for line in back.lines} == {law}
    assert back.sea is None
    (before,) = load_scene(scene).lines
    for key in ("length", "mass", "diameter", "EA", "axial_damping"):
        after = np.concatenate([getattr(line, key) for line in back.lines])
        np.testing.assert_allclose(after, getattr(before, key), rtol=1e-11)
    np.testing.assert_allclose(back.point("mixed-1").position, [20.0 * 10.0 / 24.0, 0.0, 0.0], rtol=1e-12)


def test_tables_go_to_moordyn_and_back_and_hang_there_as_here(tmp_path):
    strain = np.linspace(0.0, 0.2, 21)
    kind = {"law": "tabulated", "strain": strain.tolist(), "tension": (2e4 * strain + 4e5 * strain**3).tolist()}
    scene = {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [{"name": "rope", "mass": 5.0, "diameter": 0.03, "damping": 2000.0, **kind}],
        "point": [{"name": "a", "position": [0.0, 0.0, 0.0]}, {"name": "b", "position": [10.0, 0.0, -4.0]}],
        "line": [{"name": "line", "from": "a", "to": "b", "type": "rope", "length": 9.5, "links": 10}],
        "sea": {"depth": 20.0},
        "effects": {"weight": {}, "seabed": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.2, "cdt": 0.1}},
    }
    notes = write_moordyn(scene, tmp_path / "mooring.txt", dt=0.001)
    assert any("straight lines" in note for note in notes)
    back = load_scene(tmp_path / "mooring.txt")
    assert back.lines[0].tables == load_scene(scene).lines[0].tables
    here = equilibrium(scene).tension
    there = statics_of_moordyn(tmp_path / "mooring.txt")[0]
    np.testing.assert_allclose(0.5 * (there[1:] + there[:-1]), here, rtol=0.01)
    (tmp_path / "mooring-type1-axial.txt").write_text("a\nb\nc\n0 0\n0.1 5\n0.05 7")
    with pytest.raises(SceneError, match=r"mooring.txt:\d+: EA: mooring-type1-axial.txt.strain: .* does not rise"):
        load_scene(tmp_path / "mooring.txt")


def test_failures_become_breaks_of_the_links_at_the_point(deck):
    table = "--- FAILURE ---\nID Point Lines FailTime FailTen\n() () () (s) (N)\n1 2 1 12.5 0\n2 1 1 0 5e4\n"
    text = FLOAT.replace("---------------------- OUTPUTS", table + "---------------------- OUTPUTS")
    assert text != FLOAT
    by_time, by_load = load_scene(deck(text)).failures
    name = load_scene(deck(FLOAT)).lines[0].name
    assert (by_time.line, by_time.link, by_time.time, by_time.load) == (name, 10, 12.5, None)
    assert (by_load.line, by_load.link, by_load.time, by_load.load) == (name, 1, None, 5e4)
    with pytest.raises(SceneError, match="line 2 does not end at point 1"):
        load_scene(deck(text.replace("1 2 1 12.5 0", "1 1 2 12.5 0")))


def test_failures_go_to_a_file_and_back_where_a_line_comes_off_a_point(tmp_path):
    table = load_scene("paper-case-4").as_written()
    del table["line"][0]["type"], table["line"][0]["length"], table["line"][0]["links"]
    table["line_type"].append({**table["line_type"][0], "name": "thin", "mass": 8.0, "breaking_load": 2e5})
    table["line"][0]["sections"] = [
        {"type": "chain", "length": 20.0, "links": 4},
        {"type": "thin", "length": 30.0, "links": 6},
    ]
    ends = [{"line": "chain", "link": 1, "time": 12.5}, {"line": "chain", "link": 10, "load": 1e5, "time": 3.0}]
    joint = [{"line": "chain", "link": 4, "load": 4e4}, {"line": "chain", "link": 5, "load": 5e4}]
    inner = [{"line": "chain", "link": 7, "load": 1e5}, {"line": "chain", "load": 1e5}]
    notes = write_moordyn({**table, "failure": [*ends, *joint, *inner]}, tmp_path / "mooring.txt")
    lost = [note for note in notes if note.startswith("failure")]
    assert ["link 7" in lost[0], "most loaded link" in lost[1], len(lost)] == [True, True, 2]
    rows = (tmp_path / "mooring.txt").read_text().split("FAILURE")[1].splitlines()[3:7]
    # point 1 is the anchor, R1A the buoy, point 2 the joint; line 1 has 4 links, line 2 has 6
    assert rows == ["1 1 1 12.5 0.0", "2 R1A 2 3.0 100000.0", "3 2 1 0.0 40000.0", "4 2 2 0.0 50000.0"]
    back = load_scene(tmp_path / "mooring.txt")
    assert [(f.line, f.link, f.time, f.load) for f in back.failures] == [
        ("chain-1", 1, 12.5, None),
        ("chain-2", 6, 3.0, 1e5),
        ("chain-1", 4, None, 4e4),
        ("chain-2", 1, None, 5e4),
    ]
    assert [line.piece_of for line in back.lines] == ["chain", "chain"]
    assert write_moordyn(back, tmp_path / "again.txt") == []
    assert load_scene(tmp_path / "again.txt").failures == back.failures


def test_a_failure_at_the_breaking_load_is_written_with_that_load(tmp_path):
    table = load_scene("paper-case-4").as_written()
    table["line_type"][0]["breaking_load"] = 3e5
    write_moordyn({**table, "failure": [{"line": "chain", "link": 12}]}, tmp_path / "mooring.txt")
    (failure,) = load_scene(tmp_path / "mooring.txt").failures
    assert (failure.link, failure.time, failure.load) == (12, None, 3e5)


def test_bending_stiffness_goes_to_a_file_and_back(tmp_path):
    table = load_scene("paper-case-4").as_written()
    table["line_type"][0]["EI"] = 250.0
    with pytest.raises(SceneError, match=r"line_type.chain.EI: needs \[effects.bending\], which is missing"):
        load_scene(table)
    scene = load_scene({**table, "effects": {**table["effects"], "bending": {}}})
    np.testing.assert_array_equal(scene.effects["bending"]["EI"], [250.0] * 12)
    notes = write_moordyn(scene, tmp_path / "mooring.txt")
    assert not any("bending" in note for note in notes)
    row = next(row for row in (tmp_path / "mooring.txt").read_text().splitlines() if row.startswith("type1"))
    assert row.split()[5] == "250.0"  # TypeName Diam Mass/m EA BA EI
    np.testing.assert_array_equal(load_scene(tmp_path / "mooring.txt").effects["bending"]["EI"], [250.0] * 12)
    assert scene.with_values({"line_type.chain.EI": 100.0}).effects["bending"]["EI"].tolist() == [100.0] * 12


def test_lines_cut_by_attached_points_come_back_as_pieces_of_their_line(tmp_path):
    scene = load_scene("edulis-longline")
    write_moordyn(scene, tmp_path / "mooring.txt")
    back = load_scene(tmp_path / "mooring.txt")
    assert [line.piece_of for line in back.lines] == [line.piece_of for line in scene.lines]


def test_what_a_scene_has_no_place_for_stays_a_warning_of_its_runs(deck):
    text = CHAIN.replace("-0.8         0 ", "-0.8|50      m.txt ").replace("1e8 ", "1e8|2e8 ")
    text = text.replace("1e-4          threshIC", "rk4 tScheme\n5 Currents\n0 fileIC\n1e-4          threshIC")
    scene = load_scene(deck(text))
    for word in ("EI", "EA 1e8|2e8", "BA -0.8|50", "coupled", "tScheme", "Currents 5", "fileIC", "no duration"):
        assert any(word in note for note in scene.notes), word
    assert all(note.startswith("mooring.txt: ") for note in scene.notes)
    assert load_scene(scene.to_dict()).notes == scene.notes


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("0.002         dtM", "0.002         dtMM", 17, "option 'dtMM' is unknown; did you mean 'dtm'?"),
        ("- POINTS -", "- PIONTS -", 7, "section 'PIONTS' is unknown; did you mean 'POINTS'?"),
        ("1     Chain       1  ", "1     Chian       1  ", 15, "line type 'Chian' is not in the file"),
        ("        2        100 ", "        7        100 ", 15, "'7' is not a point of the file"),
        ("  100       20 ", "  1OO       20 ", 15, "UnstrLen: '1OO' is not a number"),
        ("  100       20 ", "  100       2.5 ", 15, "NumSegs"),
        ("0.1     30.0", "0.1     thirty", 6, "Mass/m: 'thirty' is not a number"),
        ("  100       20 ", "  -100       20 ", 15, "UnstrLen: -100 is out of range"),
        ("0.1     30.0      1e8", "0.1     30.0      0", 6, "EA: 0 is out of range"),
        ("0.1     30.0      1e8", "0.1     30.0      missing.txt", 6, "neither a number nor a readable file"),
        ("1     Fixed ", "1     Fixd ", 10, "'Fixd' is unknown"),
        ("1     Fixed ", "1     Body1 ", 10, "is not in the file"),
        ("50            WtrDpth", "! WtrDpth", 16, "WtrDpth: missing"),
        ("3000000       kbot", "much          kbot", 18, "kbot: 'much' is not a number"),
        ("- LINES -", "- POINTS -", 12, "is given twice"),
    ],
)
def test_a_mistake_is_named_with_file_and_line(old, new, line, words, deck, printed):
    assert CHAIN.count(old) == 1
    path = deck(CHAIN.replace(old, new))
    with pytest.raises(SceneError) as caught:
        read_moordyn(path)
    assert str(caught.value).startswith(f"{path}:")
    assert words in str(caught.value)
    numbers = [i for i, text in enumerate(path.read_text().splitlines(), 1) if new in text]
    assert str(caught.value).startswith(f"{path}:{line}:")
    assert line in numbers or "missing" in words
    assert printed(["run", str(path)], 2).err.startswith("error: ")


def end_force(path, pose, link, end, inner):
    """What MoorDyn calls the tension at an end: the pull of the link there and half of its weight in water."""
    line = load_scene(path).line
    weight = 9.81 * (line.mass[link] - 1025.0 * np.pi / 4 * line.diameter[link] ** 2 * line.length[link])
    along = pose.positions[inner] - pose.positions[end]
    return np.linalg.norm(pose.tension[link] * along / np.linalg.norm(along) - [0.0, 0.0, 0.5 * weight])


@pytest.mark.slow
def test_dropper_run_takes_a_moordyn_file_and_writes_its_channels(deck, tmp_path, printed):
    path = deck(FLOAT.replace("FairTen1", "FairTen1\nAnchTen2\nL1N3T\nCon2px\nBody1px"))
    argv = ["run", str(path), "--dt", "0.05", "--duration", "0.5", "--tables", str(tmp_path / "tables"), "--quiet"]
    argv += ["--out", str(tmp_path / "run.npz")]
    out, err = printed([*argv, "--json"])
    assert "Body1px" in err
    assert any("duration" in w for w in json.loads(out)["warnings"])
    lines = (tmp_path / "tables" / "moordyn.out").read_text().splitlines()
    assert lines[0].split() == ["Time", "FairTen1", "AnchTen2", "L1N3T", "Con2px"]
    assert lines[1].split() == ["(s)", "(N)", "(N)", "(N)", "(m)"]
    table = np.array([[float(x) for x in line.split()] for line in lines[2:]])
    assert table[-1, 0] == pytest.approx(0.5)
    # from the static pose nothing moves: the float is where statics puts it, and pulls as statics says
    pose = equilibrium(load_scene(path))
    np.testing.assert_allclose(table[:, 1], end_force(path, pose, 9, 10, 9), rtol=1e-6)
    np.testing.assert_allclose(table[:, 2], end_force(path, pose, 10, 11, 12), rtol=1e-6)
    np.testing.assert_allclose(table[:, 4], pose.positions[10, 0], rtol=1e-6)

    # what a run does not have is refused by name
    solution = Solution.load(tmp_path / "run.npz")
    assert solution.warnings == tuple(json.loads(out)["warnings"])
    for channel in ("FairTen3", "L1N11T", "Point9px", "Nonsense"):
        with pytest.raises(SceneError, match=channel):
            write_out(solution, tmp_path / "x.out", [channel])
    inner, _ = channel_values(solution, "L1N3T")
    ends = solution.tension[0, 2:4]
    assert min(ends) <= inner[0] <= max(ends)


@pytest.mark.check
def test_channels_name_points_and_lines_by_the_ids_of_the_file(deck, tmp_path):
    """Point 2 of the file, the float, comes last in it, and line 7 first."""
    rows = FLOAT.splitlines(keepends=True)
    second = next(i for i, row in enumerate(rows) if row.startswith("2    Connect"))
    rows.insert(second + 1, rows.pop(second))
    text = (
        "".join(rows).replace("1     rope      40.0", "7     rope      40.0").replace("FairTen1", "Point2pz\nFairTen7")
    )
    path = deck(text)
    argv = ["run", str(path), "--dt", "0.05", "--duration", "0.1", "--tables", str(tmp_path), "--quiet"]
    assert main(argv) == 0
    lines = (tmp_path / "moordyn.out").read_text().splitlines()
    assert lines[0].split() == ["Time", "Point2pz", "FairTen7"]
    pose = equilibrium(load_scene(path))
    first = [float(x) for x in lines[2].split()]
    assert first[1:] == pytest.approx([pose.positions[10, 2], end_force(path, pose, 9, 10, 9)], rel=1e-6)
    assert numbers_of(path).lines == {7: "line-7", 2: "line-2"}


@pytest.mark.check
def test_a_written_body_rests_as_in_moordyn(tmp_path):
    scene = load_scene("ballasted-spar").with_values({"sea.waves.amplitude": 1e-9})
    write_moordyn(scene, tmp_path / "spar.txt", dt=0.001, options={"TmaxIC": 0})
    theirs = statics_of_moordyn(tmp_path / "spar.txt")[0]
    ours = equilibrium(scene).tension
    # the chain lies on the bed up to its anchor: what MoorDyn's has left there is the rest of its motion
    np.testing.assert_allclose([ours[0], ours[-1]], [theirs[0], theirs[-1]], atol=0.01 * theirs[-1])


def test_outputs_of_a_line_of_one_segment_between_fixed_points_are_those_of_its_ends(deck):
    """Such a line has two links here, so that a node is free; its end B stays the end of the line."""
    text = CHAIN.replace("  100       20 ", "  100       1 ")
    path = deck(text)
    solution = simulate(path, dt=0.01, duration=0.02)
    assert solution.scene.lines[0].links == 2
    end = solution.scene.point(solution.scene.lines[0].end).position
    x, _ = channel_values(solution, "L1NBPx", numbers_of(path))
    np.testing.assert_array_equal(x, end[0])


def test_any_name_goes_to_a_file_and_back(tmp_path):
    scene = load_scene("edulis-longline").with_values({"name": "ostrón \U0001f9aa"})
    write_moordyn(scene, tmp_path / "mooring.txt")
    assert load_scene(tmp_path / "mooring.txt").name == "ostrón \U0001f9aa"
