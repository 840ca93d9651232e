"""Level and current over time: constituents, tables, the water under another level, poses through a cycle."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.scene import line_slices
from dropper_jax.sea.make import make_sea
from dropper_jax.sea.spec import SeaSpec
from dropper_jax.statics import equilibrium, nodal_loads
from dropper_jax.study.tide import tidal_cycle

M2, S2 = 44714.16, 43200.0
LEVEL = {"amplitude": [1.5, 0.5], "period": [M2, S2], "phase": [0.3, 1.0]}
WAVES = {"kind": "regular", "amplitude": 0.5, "period": 6.0}
R = jnp.asarray([[3.0, 1.0, -4.0], [0.0, 2.0, -9.0], [-7.0, 0.0, -0.2]])


def sea_of(**more):
    return make_sea(SeaSpec.read({"depth": 20.0, **more}, "sea"))


def test_constituents_add_up_with_their_lags():
    sea = sea_of(level=LEVEL, current={"speed": 0.8, "amplitude": [1.0], "period": [M2], "phase": [0.5]})
    t = 10000.0
    expected = 1.5 * np.cos(2 * np.pi * t / M2 - 0.3) + 0.5 * np.cos(2 * np.pi * t / S2 - 1.0)
    assert float(sea.elevation(R, jnp.asarray(t))[0]) == pytest.approx(expected, abs=1e-12)
    speed = 0.8 * np.cos(2 * np.pi * t / M2 - 0.5)
    motion = sea.at(R, jnp.asarray(t))
    np.testing.assert_allclose(motion.velocity[:, 0], speed, atol=1e-12)
    rate = -0.8 * 2 * np.pi / M2 * np.sin(2 * np.pi * t / M2 - 0.5)
    np.testing.assert_allclose(motion.acceleration[:, 0], rate, atol=1e-12)


def test_under_another_level_the_water_is_that_of_another_depth():
    current = {"kind": "power", "speed": 0.8, "exponent": 0.14}
    t = jnp.asarray(1.3)
    for theory in ("linear", "stream"):
        waves = {**WAVES, "theory": theory}
        tidal = sea_of(level={"offset": 2.0}, waves=waves, current=current)
        plain = sea_of(waves=waves, current=current)
        deeper = replace(plain, depth=plain.depth + 2.0)  # its waves keep their wave numbers
        down = R.at[:, 2].add(-2.0)
        a, b = tidal.at(R, t), deeper.at(down, t)
        np.testing.assert_allclose(a.elevation, b.elevation + 2.0, atol=1e-12)
        np.testing.assert_allclose(a.velocity, b.velocity, atol=1e-12)
        np.testing.assert_allclose(tidal.convective(R, t, a), deeper.convective(down, t, b), atol=1e-12)
        np.testing.assert_allclose(tidal.at(R.at[:, 2].set(-20.0), t).velocity[:, 2], 0.0, atol=1e-12)


def test_a_table_of_levels_is_linear_between_its_times_and_held_outside():
    sea = sea_of(level={"time": [0.0, 100.0], "height": [0.0, 3.0]})
    for t, expected in ((-5.0, 0.0), (40.0, 1.2), (500.0, 3.0)):
        assert float(sea.elevation(R, jnp.asarray(t))[0]) == pytest.approx(expected)
    np.testing.assert_array_equal(sea.corners[0], [0.0, 100.0])


def test_a_veering_current_turns_with_depth():
    sea = sea_of(current={"speed": 0.6, "direction": 0.2, "veer": 0.05})
    u = sea.at(R, jnp.asarray(0.0)).velocity
    course = 0.2 + 0.05 * np.array([4.0, 9.0, 0.2])
    np.testing.assert_allclose(u[:, :2], 0.6 * np.stack([np.cos(course), np.sin(course)], axis=1), atol=1e-12)


BAD = [
    ({"level": {"offset": -30.0}}, "sea.level: falls to -30 m, below the seabed; allowed: above -20 m"),
    ({"level": {"amplitude": [1.0]}}, "sea.level.period: missing; constituents need"),
    ({"level": {"amplitude": [1.0], "period": [1.0, 2.0]}}, "sea.level.period: has 2 entries; allowed: 1"),
    ({"level": {"amplitude": [1.0], "period": [-1.0]}}, "sea.level.period: -1 is out of range"),
    ({"level": {"time": [0.0, 1.0]}}, "sea.level: `time` and `height` belong together"),
    ({"level": {"heigth": [0.0]}}, "sea.level.heigth: unknown key; did you mean 'height'?"),
    (
        {"current": {"speed": 1.0, "time": [0, 1], "factor": [0, 1], "amplitude": [1.0], "period": [9.0]}},
        "sea.current.amplitude: cannot be combined with `time`",
    ),
    (
        {"current": {"kind": "table", "heights": [-9, 0], "velocities": [[0, 0, 0]] * 2, "veer": 0.1}},
        "sea.current.veer: given with kind 'table'",
    ),
    (
        {"current": {"speed": 1.0, "exponent": 0.2}},
        "sea.current.exponent: not used by kind 'uniform'; allowed: with power",
    ),
    (
        {"current": {"kind": "table", "heights": [-9, 0], "velocities": [[0, 0, 0]] * 2, "direction": 0.5}},
        "sea.current.direction: not used by kind 'table'; allowed: with uniform, power",
    ),
    (
        {"current": {"kind": "power", "speed": 1.0, "reference": -30.0}},
        "sea.current.reference: -30.0 is not above the seabed; allowed: above -20 m",
    ),
]


@pytest.mark.parametrize(("sea", "start"), BAD, ids=[start[:30] for _, start in BAD])
def test_tides_that_cannot_be_are_refused_in_one_line(sea, start, refusal):
    assert refusal(sea_of, **sea).startswith(start)


FLOAT = system(
    [fixed("anchor", 0, 0, -20.0), free("float", 0, 0, -4.0, mass=20.0, volume=0.2)],
    [line_of("leg", "anchor", "float", 4, 16.0, type="rope")],
    dt=1.0,
    duration=10.0,
    line_type=[{"name": "rope", "mass": 1.0, "diameter": 0.03, "EA": 1e5, "cdn": 1.2, "cdt": 0.0}],
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {}},
    start={"kind": "points"},
    sea={"depth": 20.0, "current": {"speed": 0.7, "amplitude": [1.0], "period": [M2]}, "level": LEVEL},
)


@pytest.mark.check
def test_a_float_goes_through_the_cycle_and_scenes_keep_their_tides():
    scene = dj.load_scene(FLOAT)
    assert dj.Scene.from_dict(scene.to_dict()) == scene
    assert scene.with_values({"sea.level.amplitude.0": 1.0}).sea.level.amplitude[0] == 1.0
    rows = tidal_cycle(scene, 5)["rows"]
    assert all(row["status"] == "ok" for row in rows)
    moved = [row["displacement_m"] for row in rows]
    # strongest at both ends and in the middle, where it has turned; next to slack in between
    assert min(moved[0], moved[2], moved[4]) > 20 * max(moved[1], moved[3])
    assert rows[2]["speed_m_per_s"] == pytest.approx(-0.7, rel=1e-6)
    with pytest.raises(dj.SceneError, match="neither sea.current nor sea.level changes"):
        tidal_cycle(scene.with_values({"sea.current": {"speed": 0.1}, "sea.level": {"offset": 0.0}}))


def test_gradients_through_level_and_current_agree_with_differences(slopes_of):
    sea = sea_of(level=LEVEL, waves=WAVES, current={"speed": 0.8, "amplitude": [1.0], "period": [60.0], "veer": 0.01})

    def value(p):
        level = replace(sea.level, amplitude=p[0] * sea.level.amplitude)
        current = replace(sea.current, veer=p[1], phase=p[2:3])
        motion = replace(sea, level=level, current=current).at(R, jnp.asarray(7.0))
        return jnp.sum(motion.velocity * jnp.array([1.0, 0.3, -0.5])) + jnp.sum(motion.elevation)

    slopes_of(value, jnp.array([1.0, 0.02, 0.4]), modes=1e-12)


@pytest.mark.check
def test_the_edulis_longline_in_currents_along_oblique_and_across():
    # at 0.9 m/s, horizontal way of the backbone from its place without current; docs/longlines.md has the same numbers
    scene = dj.load_scene("edulis-tide")
    model = build_model(scene)
    loads = nodal_loads(model, None, None)
    slack = equilibrium(replace(model, sea=replace(model.sea, current=None)), loads).positions
    backbone = [line.nodes for line in line_slices(scene) if line.name.startswith("backbone")]
    for degrees, expected in ((0.0, 4.8), (45.0, 18.6), (90.0, 20.05)):
        current = replace(model.sea.current, direction=jnp.asarray(np.deg2rad(degrees)))
        pose = equilibrium(replace(model, sea=replace(model.sea, current=current)), loads, t=44712.0 / 4)
        assert pose.status == "ok"
        way = np.hypot(*(pose.positions - slack)[:, :2].T)
        assert max(way[nodes].max() for nodes in backbone) == pytest.approx(expected, abs=0.06)
