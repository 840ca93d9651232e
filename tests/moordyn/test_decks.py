"""MoorDyn decks as they are found: names of the depth, headers with more words, bodies, what results lack."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dropper_jax import SceneError, equilibrium, load_scene, read_moordyn, simulate, write_moordyn
from dropper_jax.decks.writing.outputs import Numbers, channel_values, numbers_of
from dropper_jax.quantities.end_forces import end_forces
from dropper_jax.scene import LineSlice

FOLDER = Path(__file__).parent
DECK = (FOLDER / "chain.txt").read_text()


def test_depth_of_the_caller_where_the_file_has_none(read):
    without = "\n".join(line for line in DECK.splitlines() if "WtrDpth" not in line)
    with pytest.raises(SceneError, match="WtrDpth: missing; needed: > 0 m, in the file or as --depth"):
        read(without)
    assert read(without, 40.0)["sea"]["depth"] == 40.0
    with pytest.raises(SceneError, match="--depth: -1 is out of range"):
        read(without, -1.0)
    with pytest.raises(SceneError, match="the file gives its own"):
        read(DECK, 40.0)


def test_a_step_for_stability_is_not_ours(read):
    found = read(DECK.replace("0.002         dtM", "5e-5          dtM"))
    assert found["run"]["dt"] == 0.01
    assert any("dtM of 5e-05 s" in note for note in found["notes"])


BODIES = """---------------------- BODIES ---------------------------------------
ID   Attachment  X0  Y0  Z0  r0  p0  y0  Mass  CG  I  Volume  CdA  Ca
(#)  (-)  (m) (m) (m) (deg) (deg) (deg) (kg) (m) (kg-m^2) (m^3) (m^2) (-)
1    KIND     10.0 2.0 -1.0 0 0 0 1e5 0 1e6 100 0 0
---------------------- POINTS"""


def test_points_on_a_coupled_body_are_held(read):
    text = DECK.replace("---------------------- POINTS", BODIES).replace("2     Coupled ", "2     Body1 ")
    found = read(text.replace("KIND", "Coupled"))
    top = next(point for point in found["point"] if point["name"] == "fairlead")
    assert top.get("kind", "fixed") == "fixed"
    assert top["position"] == [10.0, 2.0, -6.0]
    assert any("on coupled body 1" in note for note in found["notes"])
    body = read(text.replace("KIND", "Free"))["body"][0]
    assert body["attachments"] == {"fairlead": [0.0, 0.0, -5.0]}
    assert body["position"] == [10.0, 2.0, -1.0]
    assert body["spheres"][0]["diameter"] == pytest.approx((600.0 / math.pi) ** (1 / 3))
    assert read(text.replace("KIND", "Pinned"))["body"] == [{**body, "pinned": True}]
    with pytest.raises(SceneError, match="on body 1, 'Turned': is not supported; allowed: free, pinned, coupled or"):
        read(text.replace("KIND", "Turned"))


FLOATING = (FOLDER / "floating.txt").read_text()


def test_a_free_body_takes_mass_and_inertia_of_the_rods_on_it(read):
    found = read(FLOATING)
    (body,) = found["body"]
    assert body["mass"] == 4900.0
    centre = (4000.0 * 1.0 + 900.0 * 4.5) / 4900.0
    assert body["centre_of_mass"] == pytest.approx([0.0, 0.0, centre])
    across = 900.0 * (1.0 / 16 + 81.0 / 12) + 900.0 * (4.5 - centre) ** 2 + 3000.0 + 4000.0 * (centre - 1.0) ** 2
    assert body["inertia"] == pytest.approx([across, across, 900.0 / 8 + 3000.0])
    assert body["attitude"] == pytest.approx([0.0, math.radians(6.0), 0.0])
    assert body["attachments"] == {"eye": [0.0, 0.0, 0.5]}
    assert [point["name"] for point in found["point"]] == ["point-1"]
    with pytest.raises(SceneError, match="body 1: is rotated about several axes"):
        read(FLOATING.replace("-6.0 0 6.0 0 ", "-6.0 1 6.0 0 "))
    with pytest.raises(SceneError, match="Mass: -4 is out of range"):
        read(FLOATING.replace("0.0 0.0 -6.0 0 6.0 0    4000 ", "0.0 0.0 -6.0 0 6.0 0 -4 "))


def test_a_free_rod_is_a_body_and_a_coupled_one_holds_its_ends(read):
    alone = FLOATING.replace("1  hull    Body1      0 0 0   0 0 9 ", "1  hull    Free      0 0 -6   0 3 -2 ")
    found = read(alone.replace("1  chain    1       2  ", "1  chain    1       R1A "))
    (body,) = found["body"]  # the free body itself carries no line
    assert body["mass"] == pytest.approx(500.0)
    assert body["position"] == [0.0, 0.0, -6.0]
    assert body["attachments"] == {"point-R1A": [0.0, 0.0, 0.0]}
    assert found["line"][0]["to"] == "point-R1A"
    coupled = alone.replace("Free      0 0 -6", "Coupled   0 0 -6")
    found = read(coupled.replace("1  chain    1       2  ", "1  chain    1       R1A "))
    assert {"name": "point-R1A", "position": [0.0, 0.0, -6.0]} in found["point"]
    assert any("rod 1 is coupled: its ends are fixed" in note for note in found["notes"])


#: The rod of `FLOATING`, pinned 10 m deep at its end A, the chain at its end B.
PINNED = FLOATING.replace("1  hull    Body1      0 0 0   0 0 9 ", "1  hull    KIND      0 0 -10   3 0 -2 ").replace(
    "1  chain    1       2  ", "1  chain    1       R1B "
)


def test_a_pinned_rod_is_a_pinned_body(read):
    (body,) = read(PINNED.replace("KIND", "Pinned"))["body"]
    assert body["pinned"] is True
    assert body["position"] == [0.0, 0.0, -10.0]
    assert body["attachments"] == {"point-R1B": [3.0, 0.0, 8.0]}
    found = read(PINNED.replace("KIND", "CoupledPinned"))
    assert found["body"] == [body]
    assert any("rod 1 is coupled and pinned: it is pinned at its position" in note for note in found["notes"])


PEER = """
import json, sys, moordyn
system = moordyn.Create(sys.argv[1])
moordyn.Init(system, [], [])
body, found = moordyn.GetBody(system, 1), []
for i in range(500):
    moordyn.Step(system, [], [], 0.02 * i, 0.02)
    found.append(list(moordyn.GetBodyState(body)[0]))
moordyn.Close(system)
print(json.dumps(found))
"""


@pytest.mark.check
def test_a_float_that_pitches_goes_as_in_moordyn(tmp_path, monkeypatch, deck):
    pytest.importorskip("moordyn")
    file = deck(FLOATING)
    monkeypatch.chdir(tmp_path)
    ours = simulate(read_moordyn(file), dt=0.02, duration=10.0)
    # MoorDyn 2.7.2 in this process, after a hundred other tests, ends in `Create` with a segmentation fault
    done = subprocess.run([sys.executable, "-c", PEER, str(file)], capture_output=True, text=True, check=True)
    theirs = json.loads(done.stdout.splitlines()[-1])
    moved = ours.body("body-1")
    mine, theirs = np.concatenate([moved["body_position"], moved["body_attitude"]], axis=1)[1:], np.array(theirs)
    for axis, share in ((0, 0.005), (2, 0.005), (4, 0.03)):  # surge, heave, pitch: parts of the range
        assert np.max(np.abs(mine[:, axis] - theirs[:, axis])) < share * np.ptp(theirs[:, axis])
    assert np.max(np.abs(mine[:, [1, 3, 5]])) < 1e-9


#: A cable of 10 m with EI on the end B of a rod along x.
CANTILEVER = (FOLDER / "cantilever.txt").read_text()


@pytest.mark.check
@pytest.mark.parametrize(
    ("pairs", "root"),
    [
        ((), 0.0),
        ((("1 cable R1B 1 ", "1 cable 1 R1B "),), 0.0),  # the line's other end
        ((("1 cable R1B 1 ", "1 cable R1A 1 "), ("1 Free 10 ", "1 Free -11 ")), -1.0),  # the rod's other end
        ((("0 0 0 4 -", "0 0 0 0 -"), ("1 Free 10 ", "1 Free 9 ")), -1.0),  # a connector: its length is 0
    ],
)
def test_a_line_with_bending_stiffness_is_clamped_along_the_rod_that_it_ends_at(pairs, root, read):
    text = CANTILEVER
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    nodes = equilibrium(load_scene(read(text))).positions
    held = nodes[np.argmax(nodes[:, 2])]
    assert held[0] == root
    sag = 9.81 * 1.0 * 10.0**4 / (8.0 * 1e5)  # a beam of Euler and Bernoulli
    assert np.ptp(nodes[:, 2]) == pytest.approx(sag, rel=0.01)


def test_a_line_that_cannot_be_clamped_as_in_moordyn_is_reported(read):
    assert any(
        "line 'line-1' is pinned on R1B, which moves" in note
        for note in read(CANTILEVER.replace("con Fixed", "con Pinned"))["notes"]
    )
    second = "1 cable R1B 1 10.0 40 -\n2 cable R1B 1 10.0 40 -"
    assert any(
        "line 'line-2' is pinned on R1B, where others end" in note
        for note in read(CANTILEVER.replace("1 cable R1B 1 10.0 40 -", second))["notes"]
    )


def test_a_connector_on_a_body_has_no_mass_and_no_length(read):
    rod = next(line for line in FLOATING.splitlines() if "Body1      0 0 0   0 0 9" in line)
    pin = "2  hull    Body1      0 0 0.5   0 0 1.5   0   -"
    deck = FLOATING.replace(rod, f"{rod}\n{pin}").replace("1  chain    1       2  ", "1  chain    1       R2B ")
    (body,) = read(deck)["body"]
    assert body["mass"] == 4900.0
    assert len(body["cylinders"]) == 1
    assert body["attachments"] == {"point-R2B": [0.0, 0.0, 0.5]}


def test_a_deck_with_a_float_has_the_note_on_its_volume_that_writing_gives(tmp_path, deck):
    fairlead = next(line for line in DECK.splitlines() if line.split()[:1] == ["2"] and len(line.split()) > 4)
    words = fairlead.split()
    afloat = " ".join([words[0], "Free", *words[2:5], "30", "0.5", "0.3", "0.5"])
    scene = load_scene(deck(DECK.replace(fairlead, afloat)))
    written = write_moordyn(scene, tmp_path / "again.txt")
    (note,) = [text for text in written if "full volume" in text]
    assert f"mooring.txt: {note}" in scene.notes
    assert not any("full volume" in text for text in load_scene(JOINED).notes)


JOINED = FOLDER / "decks" / "joined_by_rods.txt"


def test_lines_joined_by_massless_rods_are_one_line_of_sections():
    found = load_scene(JOINED)
    one = {"mass": 40.0, "diameter": 0.15, "EA": 2e7, "damping_ratio": 0.9, "cdn": 1.6, "can": 1.0, "cdt": 0.1}
    parts = [("cable", 54.0, 12), ("floats", 27.0, 6), ("cable", 70.0, 14)]
    sections = [{"type": kind, "length": length, "links": links} for kind, length, links in parts]
    table = {
        "run": {"dt": 0.01, "duration": 60.0},
        "line_type": [{"name": "cable"} | one, {"name": "floats"} | one | {"mass": 44.0, "diameter": 0.3}],
        "point": [{"name": "a", "position": [0.0, 0.0, -8.0]}, {"name": "b", "position": [112.0, 0.0, -60.0]}],
        "line": [{"name": "c", "from": "a", "to": "b", "sections": sections}],
        "sea": {"depth": 60.0},
        "effects": {"weight": {}, "buoyancy": {}, "morison_drag": {}, "morison_inertia": {}},
    }
    (line,), (same,) = found.lines, load_scene(table).lines
    for key in ("length", "mass", "diameter", "EA"):
        np.testing.assert_allclose(getattr(line, key), getattr(same, key), rtol=1e-12)
    assert [p.name for p in found.points] == ["point-1", "point-2"]
    assert any("are the sections of line 'line-1'" in note for note in found.notes)


def test_a_joint_of_three_lines_is_a_free_point(deck):
    text = JOINED.read_text().replace("2   Fixed  112.0", "3   Fixed  35.0 20.0 -60.0 0 0 0 0\n2   Fixed  112.0")
    more = "4   cable    3       R1B     60.0     10      -\n3   cable    R2B "
    found = load_scene(deck(text.replace("3   cable    R2B ", more)))
    assert {line.name: line.links for line in found.lines} == {"line-1": 12, "line-2": 20, "line-4": 10}
    assert found.point("point-R1").is_free


def test_outputs_and_failures_of_a_joined_line_are_those_of_its_part(made, deck):
    failure = "--------- FAILURE ---------\nID Point Lines Time Ten\n- - - - -\n1 R1B 2 4.0 0\n"
    options = "---------------------- OPTIONS"
    file = deck(JOINED.read_text().replace(options, f"{failure}{options}"))
    scene = load_scene(file)
    assert [(f.line, f.link) for f in scene.failures] == [("line-1", 13)]  # the first link after the joint
    rng = np.random.default_rng(0)
    solution = made(scene, rng.normal(size=(3, 33, 3)), rng.uniform(1e3, 2e3, size=(3, 32)))
    numbers = numbers_of(file)
    for channel, node in (("L1N12px", 12), ("L2N0px", 18), ("L2N6px", 12), ("L3N14px", 32)):
        np.testing.assert_array_equal(channel_values(solution, channel, numbers)[0], solution.positions[:, node, 0])
    whole = Numbers.of_scene(solution)
    pairs = (("L2N1T", "L1N17T"), ("AnchTen1", "AnchTen1"), ("FairTen3", "FairTen1"), ("L1NAT", "L1N0T"))
    for part, same in pairs:
        np.testing.assert_array_equal(
            channel_values(solution, part, numbers)[0], channel_values(solution, same, whole)[0]
        )
    floats = LineSlice("floats", slice(12, 19), slice(12, 18))
    (both,) = end_forces(scene, solution.positions, solution.tension, [floats], solution.t).values()
    np.testing.assert_array_equal(channel_values(solution, "FairTen2", numbers)[0], both[:, 0])
    np.testing.assert_array_equal(channel_values(solution, "AnchTen2", numbers)[0], both[:, 1])


def test_friction_of_a_deck_is_moordyns_law(tmp_path, deck):
    more = "0.4 FrictionCoefficient\n350 FricDamp\n1.5 StatDynFricScale"
    scene = load_scene(deck(DECK.replace("50            WtrDpth", f"50            WtrDpth\n{more}")))
    friction = scene.effects["seabed_friction"]
    assert {key: friction[key] for key in ("law", "kinetic", "damping")} == {
        "law": "moordyn",
        "kinetic": 0.4,
        "damping": 350.0,
    }
    assert friction["static"] == pytest.approx(0.6)
    assert not any("FricDamp" in note for note in scene.notes)
    again = tmp_path / "again.txt"
    assert not any("friction" in lost for lost in write_moordyn(scene, again))
    assert load_scene(again).effects["seabed_friction"] == friction
    sticking = scene.with_values({"effects.seabed_friction.law": "coulomb"})
    assert any("creeps" in lost for lost in write_moordyn(sticking, again))


def test_components_of_a_series_that_hardly_count_are_left_out(tmp_path, deck):
    # nearly whole periods: one wave, and what the Fourier series makes of half a sample; broken ones: a jump at the end
    t = np.arange(0.0, 288.05, 0.1)
    height, period = 5.0, 8.33
    rows = "\n".join(f"{a:.6f} {b:.9f}" for a, b in zip(t, height * np.cos(2 * np.pi * t / period), strict=True))
    for series, most in ((t[: round(24 * period / 0.1)], 3), (t, 1300)):
        (tmp_path / "wave_elevation.txt").write_text("\n".join(rows.splitlines()[: len(series)]))
        scene = load_scene(deck(DECK.replace("50            WtrDpth", "50            WtrDpth\n3 WaveKin\n0.1 dtWave")))
        waves = scene.sea.waves
        assert len(waves.amplitude) <= most
        assert any("components are omitted, 0.01% of the variance" in note for note in scene.notes)
        phase = np.asarray(waves.phase) - np.outer(series, 2 * np.pi / np.asarray(waves.period))
        difference = np.cos(phase) @ np.asarray(waves.amplitude) - height * np.cos(2 * np.pi * series / period)
        assert np.sqrt(np.mean(difference**2)) < 0.011 * height / np.sqrt(2.0)
