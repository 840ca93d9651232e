"""Files of channels: what they say is read, and what cannot be is refused in one line."""

from dataclasses import replace

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import SceneError
from fitting import read_data

SCENE = {
    "run": {"dt": 0.01, "duration": 1.0},
    "line_type": [{"name": "rope", "mass": 1.0, "diameter": 0.03, "EA": 1e6}],
    "point": [
        {"name": "anchor", "position": [0.0, 0.0, -10.0]},
        {"name": "float", "kind": "free", "position": [8.0, 0.0, -4.0], "mass": 5.0, "volume": 0.05},
        {"name": "ship", "position": [16.0, 0.0, -2.0]},
    ],
    "line": [
        {"name": "leg", "from": "anchor", "to": "float", "type": "rope", "length": 10.0, "links": 4},
        {
            "name": "arm", "from": "float", "to": "ship", "type": "rope", "length": 9.0, "links": 3,
            "attach": [{"point": "knot", "at": 6.0}],
        },
    ],
    "sea": {"depth": 20.0},
    "effects": {"weight": {}, "buoyancy": {}},
}  # fmt: skip
T = np.linspace(0.0, 1.0, 11)
FILE = {"t": T, "F": T + 1, "d": T + 2, "u": T, "v": T, "x": T}
TENSION = {"name": "pull", "kind": "tension", "column": "F", "unit": "kN", "line": "leg", "end": "from"}
DEPTH = {"name": "deep", "kind": "depth", "column": "d", "unit": "cm", "line": "arm", "at": 4.5}
CAMERA = {"name": "left", "position": [0, -9, 0], "look_at": [0, 0, 0], "focal": 1000.0, "centre": [0, 0]}
PIXEL = {"name": "dot", "kind": "pixel", "columns": ["u", "v"], "unit": "px", "camera": "left", "point": "float"}
GOOD = {"run": [{"file": FILE}], "channel": [TENSION, DEPTH, PIXEL], "camera": [CAMERA]}


@pytest.fixture(scope="module")
def scene():
    return dj.load_scene(SCENE)


def test_values_are_in_si_and_places_on_the_whole_line(scene):
    data = read_data(GOOD, scene)
    assert np.allclose(data.runs[0].values[0][:, 0], 1e3 * (T + 1))
    assert np.allclose(data.runs[0].values[1][:, 0], 1e-2 * (T + 2))
    assert data.sensors[0].channel.link == 0
    # nodes: 5 of the leg; the arm's two pieces have 3 and 2; 4.5 m is the middle of its second link of 3 m
    assert data.sensors[1].channel.node == (6, 7, 0.5)
    assert data.sensors[2].channel.node.first == 4


def test_an_accelerometer_at_a_node_is_at_the_end_of_the_link_before_it(scene):
    axes = {"kind": "accelerometer", "columns": ["u", "v"], "unit": "m/s^2", "line": "leg"}
    channels = [axes | {"name": f"a{i}", "at": at} for i, at in enumerate((0.0, 1.0, 2.5, 5.0, 10.0))]
    found = [sensor.channel for sensor in read_data({**GOOD, "channel": channels}, scene).sensors]
    assert [(c.first, c.second) for c in found] == [(0, 1), (0, 1), (0, 1), (1, 2), (3, 4)]
    assert [c.position for c in found] == pytest.approx([0.0, 1.0, 2.5, 2.5, 2.5])


@pytest.mark.parametrize("links", [43, 300])
def test_the_end_of_a_line_is_on_its_last_link_with_any_rounding(links):
    line = {**SCENE["line"][0], "length": 1000.0, "links": links}
    long = dj.load_scene({**SCENE, "line": [line, SCENE["line"][1]]})
    cell = {key: value for key, value in TENSION.items() if key != "end"}
    data = read_data({"run": [{"file": FILE}], "channel": [{**cell, "at": 1000.0}]}, long)
    assert data.sensors[0].channel.link == links - 1


@pytest.mark.parametrize(("unit", "noise"), [("N", 10.0), ("%", 0.01)])
def test_noise_without_a_size_is_that_of_samples_of_a_smooth_motion(scene, unit, noise):
    """In per cent it is a fraction of the values."""
    t = np.linspace(0.0, 10.0, 1001)
    force = 1000.0 + 50.0 * np.sin(6.0 * t) + 10.0 * np.random.default_rng(0).standard_normal(len(t))
    cell = {**TENSION, "unit": "N", "noise_unit": unit}
    data = read_data({"run": [{"file": {"t": t, "F": force}}], "channel": [cell]}, scene)
    assert data.first_noise()[0] == pytest.approx(noise, rel=0.15)


def test_an_anchor_is_pulled_by_its_one_line_and_a_knot_by_two(scene):
    tension = {key: value for key, value in TENSION.items() if key not in ("line", "end")}
    channels = [{**tension, "point": "anchor"}, {**tension, "point": "knot", "name": "k"}]
    one, two = (sensor.channel for sensor in read_data({**GOOD, "channel": channels}, scene).sensors)
    assert (one.link, one.ends) == (0, ())
    assert len(two.ends) == 2


def test_a_file_of_its_own_clock_and_missing_samples_are_read(scene, tmp_path):
    (tmp_path / "a.csv").write_text("# load cell\nt,F\n0,1\n0.5,\n1,3\n1.5,4\n")
    (tmp_path / "b.csv").write_text("t,d\n0,1\n1,2\n2,3\n")
    cell = {"name": "pull", "kind": "tension", "column": "F", "unit": "N", "line": "leg", "link": 2}
    deep = {"name": "deep", "kind": "depth", "column": "d", "unit": "m", "point": "float"}
    run, file = {"file": ["a.csv", "b.csv"], "until": 1.6}, tmp_path / "data.toml"
    table = {"run": [run], "channel": [{**cell, "noise": 1.0, "noise_unit": "%"}, deep]}
    file.write_text(dj.as_toml(table))
    with pytest.raises(SceneError, match="channel 'deep' has fewer than 3 samples"):
        read_data(file, scene)
    file.write_text(dj.as_toml({**table, "run": [{**run, "until": 9}]}))
    data = read_data(file, scene)
    assert [len(t) for t in data.runs[0].t] == [4, 3]
    assert np.isnan(data.runs[0].values[0][1, 0])
    assert (data.sensors[0].noise, data.sensors[0].relative, data.runs[0].name) == (0.01, True, "a")
    for deep, words in (
        ([1.0, np.nan, np.nan], "run.0: channel 'deep' has fewer than 3 samples"),
        ([1.0, 2.0, np.inf], "run.0: channel 'deep' has an infinite sample"),
        ([0.0, 0.0, 0.0], "channel 'deep': is constant in all samples"),
        ([0.1, np.nan, 0.1, 0.1], "channel 'deep': is constant in all samples"),
    ):
        run = replace(data.runs[0], values=(data.runs[0].values[0], np.array(deep)[:, None]))
        with pytest.raises(SceneError, match=words):
            replace(data, runs=(run,)).first_noise()


def changed(section, index, **values):
    rows = list(GOOD[section])
    rows[index] = {key: value for key, value in (rows[index] | values).items() if value is not None}
    return {**GOOD, section: rows}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (changed("channel", 0, kind="smell"), "channel.0.kind: 'smell' is unknown"),
        (changed("channel", 0, unit="mm"), "channel.0.unit: 'mm' is not a unit of this quantity; allowed: N, kN"),
        (changed("channel", 0, unit=None), "channel.0.unit: missing; needed: N, kN"),
        (changed("channel", 0, line="log"), "channel.0.line: 'log' is not a line of the scene"),
        (changed("channel", 0, end=None, link=5), "channel.0.link: 5 is outside line 'leg'; allowed: 1 to 4"),
        (changed("channel", 0, link=2), "channel.0: position given twice, by link and end"),
        (changed("channel", 0, end="top"), "channel.0.end: 'top' is not an end of a line; allowed: from, to"),
        (changed("channel", 1, at=9.5), "channel.1.at: 9.5 m is outside line 'arm'; allowed: 0 to 9 m"),
        (changed("channel", 1, at=None, node=4), "channel.1.node: 4 is outside line 'arm'"),
        (changed("channel", 1, at=None), "channel.1: position missing; allowed: one of node, end, at, point"),
        (changed("channel", 1, noise=0.0), "channel.1.noise: 0.0 is out of range; allowed: a number > 0"),
        (changed("channel", 1, name="pull"), "channel.1: duplicate name 'pull'"),
        (changed("channel", 1, name="a.b"), "channel.1.name: 'a.b' cannot be used in the path of a parameter"),
        (changed("channel", 2, camera="right"), "channel.2.camera: 'right' is not a camera"),
        (changed("channel", 2, columns=["u"]), "channel.2.columns: 1 columns; allowed: 2, u and v"),
        (changed("channel", 2, point="buoy"), "channel.2.point: 'buoy' is not a point of the scene"),
        (changed("channel", 0, column="G"), "run.0: channel 'pull': column 'G' is in no file"),
        (changed("camera", 0, look_at=[0, -9, 5]), "camera.0.look_at: directly above or below the camera"),
        (changed("camera", 0, focal=None), "camera.0.focal: missing"),
        (changed("run", 0, name="../a"), "run.0.name: '../a' cannot be used"),
        (changed("run", 0, name="a/b"), "run.0.name: 'a/b' cannot be used in the name of a file"),
        (changed("run", 0, file={**FILE, "t": T[::-1]}), "t: decreases from row to row. Reverse the rows"),
        (changed("run", 0, file={**FILE, "t": T - 0.5}), "run.0: t: -0.5 s is before the scene starts"),
        (changed("run", 0, file={**FILE, "F": ["a"] * 11}), "run.0.file: F is not a list of numbers"),
        ({**GOOD, "channel": []}, "channel: missing"),
        ({**GOOD, "chanel": []}, "chanel: unknown key"),
        ({**GOOD, "motion": [{"point": "float", "columns": ["u", "v", "x"], "unit": "m"}]}, "is not a fixed point"),
    ],
)
def test_what_cannot_be_is_refused_by_name(scene, table, message, refusal):
    assert message in refusal(read_data, table, scene)


def two_files(folder, *channels):
    for name, shift in (("A", 0.0), ("B", 10.0)):
        rows = "\n".join(f"{t};{t + shift};{t - shift}" for t in T)
        (folder / f"{name}.csv").write_text(f"t;x;y\n{rows}\n")
    where = {"kind": "position", "axes": ["x", "z"], "unit": "m", "line": "leg"}
    tables = [where | {"name": f"c{i}", "node": i + 1, "columns": names} for i, names in enumerate(channels)]
    return {"run": [{"file": ["A.csv", "B.csv"]}], "channel": tables}


@pytest.mark.parametrize(
    ("channels", "firsts"),
    [
        ((["x", "y"], ["x", "y"]), (0.0, 10.0)),
        ((["B.x", "B.y"], ["A.x", "A.y"]), (10.0, 0.0)),
        ((["x", "y"], ["A.x", "y"]), None),
        ((["x", "y"],), None),
        ((["B.x", "A.y"],), None),
    ],
)
def test_columns_of_one_name_in_two_files_are_named_per_file_or_taken_in_order(scene, tmp_path, channels, firsts):
    source = two_files(tmp_path, *channels)
    if firsts is None:
        with pytest.raises(SceneError, match=r"occurs in 2 files.*\"A\.x\", \"A\.y\"|in no file with the others"):
            read_data(source, scene, tmp_path)
        return
    values = read_data(source, scene, tmp_path).runs[0].values
    assert tuple(y[0, 0] for y in values) == firsts
    np.testing.assert_allclose([y[3, 1] for y in values], [T[3] - shift for shift in firsts])
