"""What is made of runs and lines in water: growth, flow regime, pictures."""

import numpy as np
import pytest
from PIL import Image
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax import plots
from dropper_jax.modelling.growth import overgrown
from dropper_jax.scene import grown
from dropper_jax.study.flow_regime import regime

SCENE = scene_of(
    {"a": [0, 0, -2.0], "b": free_at([0, 0, -6.0])},
    line_of("l", "a", "b", 4, 1.0, mass=2.0, diameter=0.04),
    run={"dt": 0.05, "duration": 4.0},
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.2}},
    sea={"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.5, "period": 6.0}},
)


GROWTH = {"depth": [2, 6], "thickness": [0.05, 0.01], "density": 1300}


@pytest.fixture(scope="module")
def solution():
    return dj.simulate(SCENE, halvings=0)


def test_growth_from_a_bare_rope_gives_mass_diameter_and_wet_weight():
    found = grown(*(np.array([x]) for x in (2.0, 1.0, 0.02, 0.05, 1200.0)), water=1000.0, gravity=10.0)
    area = np.pi / 4 * (0.12**2 - 0.02**2)
    assert found.diameter[0] == pytest.approx(0.12)
    assert found.mass[0] == pytest.approx(1.0 + 1200.0 * area * 2.0)
    assert found.wet_weight[0] == pytest.approx(10.0 * (found.mass[0] - 1000.0 * np.pi / 4 * 0.12**2 * 2.0))


@pytest.mark.slow
def test_growth_over_depth_is_taken_where_the_links_hang():
    keyed = {**SCENE, "line": [{**SCENE["line"][0], "growth": GROWTH}]}
    bare = dj.load_scene(keyed)
    scene = overgrown(bare)
    # the links' middles hang at 2.5, 3.5, 4.5 and 5.5 m
    np.testing.assert_allclose(scene.lines[0].diameter, 0.04 + 2 * (0.05 - 0.01 * np.array([0.5, 1.5, 2.5, 3.5])))
    assert np.all(scene.lines[0].mass > 2.0)
    model = dj.build(bare)[0]
    np.testing.assert_array_equal(model.line.diameter, scene.lines[0].diameter)
    np.testing.assert_array_equal(model.line.mass, scene.lines[0].mass)
    assert bare.lines[0].mass[0] == 2.0  # the scene keeps the bare rope
    assert dj.load_scene(bare.to_dict()) == bare
    with pytest.raises(dj.SceneError, match="growth.depth"):
        overgrown(dj.load_scene({**SCENE, "line": [{**SCENE["line"][0], "growth": {**GROWTH, "depth": [6, 2]}}]}))


def test_growth_on_one_line_of_a_system_weighs_on_that_line_alone():
    points = {"a": [0, 0, -2.0], "c": [5.0, 0, -2.0]}
    points |= {"b": free_at([0, 0, -6.0], mass=50.0), "d": free_at([5.0, 0, -6.0], mass=50.0)}
    scene = scene_of(
        points,
        line_of("bare", "a", "b", 4, 4.0, type="rope"),
        line_of("grown", "c", "d", 4, 4.0, type="rope", growth=GROWTH),
        sea=SCENE["sea"],
        line_type=[{"name": "rope", "mass": 2.0, "diameter": 0.04, "EA": 1e9}],
        effects={"weight": {}, "buoyancy": {}},
    )
    loaded = dj.load_scene(scene)
    assert dj.load_scene(loaded.to_dict()) == loaded
    pose = dj.equilibrium(loaded)
    # the fixed point takes half of the first link; the layer is that at the links' middles, 2.5 to 5.5 m deep
    thick = 0.05 - 0.01 * np.array([0.5, 1.5, 2.5, 3.5])
    outer = np.pi / 4 * (0.04 + 2 * thick) ** 2
    mass = 2.0 + 1300.0 * (outer - np.pi / 4 * 0.04**2)
    bare = np.full(4, 2.0 - 1025.0 * np.pi / 4 * 0.04**2)
    for tension, weight in ((pose.tension[0], bare), (pose.tension[4], mass - 1025.0 * outer)):
        assert tension == pytest.approx(9.81 * (50.0 + 0.5 * weight[0] + weight[1:].sum()), rel=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thickness": [0.05]}, "line.0.growth.thickness"),
        ({"thickness": [0.05, -0.01]}, "line.0.growth.thickness"),
        ({"density": [1.0, 2.0, 3.0]}, "line.0.growth.density"),
        ({"densty": 1.0}, "line.0.growth.densty"),
        ({}, "has no .sea."),
    ],
)
def test_growth_that_makes_no_sense_or_is_out_of_the_water_is_refused(change, message):
    scene = SCENE if change else {key: SCENE[key] for key in ("run", "point")} | {"effects": {"weight": {}}}
    with pytest.raises(dj.SceneError, match=message):
        dj.load_scene({**scene, "line": [{**SCENE["line"][0], "growth": {**GROWTH, **change}}]})


def test_the_flow_regime_is_bounded_by_the_fastest_water(solution):
    found = regime(solution)
    fastest = 0.5 * 2 * np.pi / 6.0 / np.tanh(2 * np.pi / 53.0 * 20.0) * 1.2 + solution.max_speed
    assert 0.05 < found["relative_speed_m_per_s"] < fastest
    assert found["keulegan_carpenter"] == pytest.approx(found["relative_speed_m_per_s"] * 6.0 / 0.04)
    assert found["diameter_over_wavelength"] < 0.05


@pytest.mark.parametrize("name", ["under_surface", "response", "tension_envelope"])
def test_pictures_of_water_are_written(solution, tmp_path, name):
    file = getattr(plots, name)(solution, tmp_path / f"{name}.png")
    assert file.stat().st_size > 10_000


def test_the_animation_shows_the_surface_rise_and_fall(solution, tmp_path):
    """Mean row of the surface's pixels per frame, against the elevation at the line, which the picture's scale maps."""
    rows, blue = [], np.array([0x56, 0xB4, 0xE9])
    with Image.open(plots.animate(solution, tmp_path / "sea.gif", fps=10)) as image:
        for frame in range(0, image.n_frames, 5):
            image.seek(frame)
            pixels = np.asarray(image.convert("RGB"), int)
            left = pixels[:, : int(0.7 * pixels.shape[1])]  # the colour bar has blues too
            rows.append(np.nonzero(np.abs(left - blue).sum(axis=-1) < 12)[0].mean())
    assert np.all(np.isfinite(rows))
    sea = dj.build(solution.scene)[0].sea
    times = np.linspace(0.0, 4.0, len(rows))
    eta = [float(sea.elevation(np.zeros((1, 3)), t)[0]) for t in times]
    assert np.corrcoef(eta, rows)[0, 1] < -0.95  # rows are counted downwards


def test_flow_across_a_system_is_that_of_its_own_links(made):
    # two lines along the current, one above the other: no flow across either, but across a link between them
    line = {"mass": 1.0, "diameter": 0.1, "nodes": "shared", "axial": {"law": "rope", "EA": 1e6}}
    points = {
        "a": [0.0, 0.0, -5.0],
        "b": free_at([10.0, 0.0, -5.0]),
        "c": [0.0, 0.0, -9.0],
        "d": free_at([10.0, 0.0, -9.0]),
    }
    scene = scene_of(
        points,
        line_of("upper", "a", "b", 2, 5.0, **line),
        line_of("lower", "c", "d", 2, 5.0, **line),
        effects={"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0}},
        sea={"depth": 20.0, "current": {"speed": 1.0}},
    )
    still = np.array([[x, 0.0, z] for z in (-5.0, -9.0) for x in (0.0, 5.0, 10.0)])
    found = regime(made(scene, np.tile(still, (3, 1, 1)), np.ones((3, 4))))
    assert found["relative_speed_m_per_s"] == pytest.approx(0.0, abs=1e-12)
    upright = np.array([[x, 0.0, z] for x in (0.0, 4.0) for z in (-5.0, -10.0, -15.0)])
    found = regime(made(scene, np.tile(upright, (3, 1, 1)), np.ones((3, 4))))
    assert found["relative_speed_m_per_s"] == pytest.approx(1.0)
    assert found["reynolds"] == pytest.approx(0.1 / 1.35e-6)
