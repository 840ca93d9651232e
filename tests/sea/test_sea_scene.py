"""Scenes with water: packaged ones, what is refused, what is warned of, what a scene without water pays."""

import copy

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system

import dropper_jax as dj
from dropper_jax import build_model
from dropper_jax.load.sea_warnings import sea_warnings
from dropper_jax.plausibility.line_weights import wet_weights
from dropper_jax.sea import Waves
from dropper_jax.sea.make import make_sea
from dropper_jax.sea.spec import SeaSpec, sea_names
from dropper_jax.sea.wave_files import elevation_components, from_wavespectra

LINE = system(
    [fixed("a", 0, 0, -1), free("b", 0, 0, -5)],
    [line_of("l", "a", "b", 4, 1.0, mass=5.0, diameter=0.05)],
    dt=0.02,
    duration=100.0,
    effects={"weight": {}, "buoyancy": {}, "morison_drag": {"cdn": 1.0}},
    start={"kind": "angles", "zero": "down", "polar": [0.0] * 4},
    sea={"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.5, "period": 6.0}},
)


def changed(**values) -> dict:
    table = copy.deepcopy(LINE)
    for path, value in values.items():
        *parents, key = (int(part) if part.isdecimal() else part for part in path.split("__"))
        place = table
        for part in parents:
            place = place[part] if isinstance(place, list) else place.setdefault(part, {})
        if value is None:
            place.pop(key)
        else:
            place[key] = value
    return table


@pytest.mark.parametrize(("name", "hs"), [("north-sea-25-year", 2.57), ("north-sea-25-year-jonswap", 8.20)])
def test_packaged_seas_have_their_height(name, hs):
    sea = make_sea(SeaSpec.read({"packaged": name}, "sea"))
    assert float(sea.waves.significant_height) == pytest.approx(hs, abs=0.005)
    assert {"jonswap-29", "regular-case-1", name} <= set(sea_names())


def test_another_packaged_sea_takes_the_place_of_the_scenes_own():
    scene = dj.load_scene("dropper-regular-wave").with_values({"sea.packaged": "jonswap-29"})
    assert scene.sea.waves.kind == "components"
    assert len(scene.sea.waves.period) == 29
    assert scene.sea.ramp == 16.66  # the scene's, not the sea's


def test_a_packaged_sea_is_overridden_by_the_scene_and_by_paths():
    scene = dj.Scene.from_dict(changed(sea={"packaged": "regular-case-1", "waves": {"amplitude": 0.7}}))
    assert scene.sea.waves.amplitude == 0.7
    assert scene.sea.waves.period == 8.33
    assert scene.with_values({"sea.waves.period": 5.0, "sea.density": 1010.0}).sea.waves.period == 5.0


BAD = [
    (changed(sea__waves__period=-6.0), "sea.waves.period: -6.0 is out of range"),
    (changed(sea__waves__perod=6.0), "sea.waves.perod: unknown key; did you mean 'period'?"),
    (changed(sea__waves__hs=6.0), "sea.waves.hs: not used by kind 'regular'"),
    (changed(sea__depth=-1.0), "sea.depth: -1.0 is out of range"),
    (changed(sea=None), "effects.buoyancy: needs water, but the scene has no [sea]"),
    (changed(sea__packaged="north-sea"), "sea.packaged: 'north-sea' is not a packaged sea; did you mean 'north-"),
    (changed(line__0__diameter=None), "line.0.diameter: missing"),
    (changed(point__0__position=[0, 0, -30]), "point.0.position: z = -30 m is below the seabed"),
    (changed(effects__buoyancy__wet_weight=30.0), "line.0.diameter: 0.05 m of link 1 displaces 0.001963 m^3"),
    (changed(effects__buoyancy__wet_weight=80.0), "effects.buoyancy.wet_weight: 80 N of link 1 is not below"),
    (changed(effects__weight__wet_weight=30.0), "effects.weight.wet_weight: is a weight in water"),
    (
        changed(effects__weight__gravity=9.81, sea__gravity=1.62),
        "effects.weight.gravity: 9.81 m/s^2, but sea.gravity is 1.62 m/s^2; allowed: one value. Remove one of the two",
    ),
    (changed(sea__wave_current="doppler"), "sea.wave_current: 'doppler' needs waves and a current"),
    (changed(sea__waves={"kind": "spectrum", "hs": 1.0}), "sea.waves.tp: missing"),
    (
        changed(sea__waves__kind=None),
        "sea.waves.kind: missing; needed: how the waves are given; allowed: regular, components, spectrum, elevation",
    ),
    (changed(sea__waves={"kind": "components", "amplitude": [1.0, 1.0], "period": [3.0]}), "sea.waves.period: [3.0]"),
    (changed(sea__current={"kind": "table", "heights": [0.0]}), "sea.current: `heights` and `velocities` belong"),
    (changed(sea__interpolation="grid", sea__stretching="none"), "sea.interpolation: 'grid' does not support this sea"),
    (
        changed(sea__interpolation="grid", sea__level={"offset": 1.0}),
        "sea.interpolation: 'grid' does not support this sea; allowed: none, or a sea with no sea.level",
    ),
    (
        changed(sea__current={"speed": -4.0}, sea__wave_current="doppler", sea__waves__period=3.0),
        "sea.wave_current: the current stops 1 of 1 wave components, the first of period 3 s",
    ),
]


@pytest.mark.parametrize(("table", "start"), BAD, ids=[start[:40] for _, start in BAD])
def test_bad_input_is_one_line_that_names_it(table, start, refusal):
    assert refusal(dj.build, table).startswith(start)


def test_a_scene_has_one_gravity_whichever_section_gives_it():
    plain = dj.load_scene(changed(sea__waves=None))
    weight = wet_weights(plain)
    found = [
        dj.load_scene(changed(sea__waves=None, sea__gravity=1.62)),
        dj.load_scene(changed(sea__waves=None, effects__weight__gravity=1.62)),
        plain.with_values({"sea.gravity": 1.62}),
        plain.with_values({"effects.weight.gravity": 1.62}),
    ]
    for scene in found:
        assert scene.sea.gravity == scene.effects["weight"]["gravity"] == scene.gravity == 1.62
        np.testing.assert_allclose(wet_weights(scene), weight * 1.62 / 9.81, rtol=1e-12)
        model = build_model(scene)
        assert {float(e.gravity) for e in model.effects if hasattr(e, "gravity")} == {float(model.sea.gravity)}
    assert dj.Scene.from_dict(found[0].to_dict()) == found[0]
    # weightless lines in waves, which need a gravity
    waves = dj.load_scene(changed(effects__weight__gravity=0.0, effects__buoyancy=None))
    assert waves.sea.gravity == 9.81
    assert waves.with_values({"sea.gravity": 9.0}).gravity == 0.0
    assert dj.load_scene(changed(effects__buoyancy=None)).with_values({"effects.weight.gravity": 0.0}) == waves


def test_another_gravity_of_the_water_gives_no_weight_to_lines_without_one():
    scene = dj.load_scene(changed(effects={"morison_drag": {"cdn": 1.0}}))
    assert "weight" not in scene.with_values({"sea.gravity": 9.0}).effects


ALL_COLUMNS = "period_s,amplitude_m,phase_rad,direction_rad\n6,0.5,0,1.5\n"


@pytest.mark.parametrize(
    ("text", "start", "problem"),
    [
        ("period,amplitude\n3,1\n", "file", "has the columns period, amplitude; allowed: period_s or frequency_hz"),
        ("# swell\nperiod_s,amplitude_m\n\n3,x\n", "file", "line 4: '3,x' is not all numbers"),
        ('period_s,amplitude_m\n3,"1\n4,1\n', "file", "unexpected end of data"),
        ("period_s,amplitude_m\n-3,1\n", "file", "period_s of component 1 is -3; allowed: > 0"),
        ("period_s,amplitude_m\n", "file", "has no rows"),
        ("period_s,frequency_hz,amplitude_m\n6,1,0.5\n", "file", "1: frequency_hz 1 is not 1/period_s, 0.1667 Hz"),
        ("period_s,period_s,amplitude_m\n6,6,0.5\n", "file", "allowed: every column once"),
        # values have the ranges of those in the scene
        (ALL_COLUMNS + "8,0.5,0,270\n", "direction.1", "270.0 is out of range"),
        (ALL_COLUMNS + "8,-0.5,0,0\n", "amplitude.1", "-0.5 is out of range"),
        (ALL_COLUMNS, "direction", "given twice"),
    ],
)
def test_component_files_that_cannot_be_read_are_refused_by_path(tmp_path, text, start, problem, refusal):
    file = tmp_path / "sea.csv"
    file.write_text(text)
    waves = {"kind": "components", "file": str(file)}
    if problem == "given twice":
        waves["direction"] = 0.2
    message = refusal(dj.load_scene, changed(sea__waves=waves))
    assert message.startswith(f"sea.waves.{start}: ")
    assert problem in message


def test_component_files_are_read_with_periods_before_frequencies(tmp_path):
    file = tmp_path / "sea.csv"
    file.write_text("frequency_hz,period_s,amplitude_m,phase_rad\n0.12,8.345,0.873,0.837\n0.13,7.586,0.832,5.658\n")
    scene = dj.Scene.from_dict(changed(sea__waves={"kind": "components", "file": str(file)}))
    np.testing.assert_array_equal(scene.sea.waves.period, [8.345, 7.586])
    assert dj.Scene.from_dict(scene.to_dict()) == scene


WARN = [
    (changed(sea__waves__amplitude=4.0), "sea.waves: wave height 8 m is beyond breaking, 0.142 L tanh(kd) = 7.656"),
    (changed(sea__depth=4.0), "sea.depth: the line can reach down to z = -5 m, but the seabed at -4 m"),
    (
        changed(sea__waves={"kind": "components", "amplitude": [0.1] * 3, "period": [10.0, 5.0, 10 / 3]}),
        "sea.waves: the sea repeats after 10 s, within the run of 100 s",
    ),
    (changed(line__0__diameter=0.9, sea__waves__period=3.0), "line.0.diameter: 0.064 of 14"),
    (
        changed(
            sea__depth=15.0, sea__waves={"kind": "components", "amplitude": [2.0] * 3, "period": [12.0, 10.0, 8.5]}
        ),
        "sea.waves: significant wave height 9.798 m is 0.65 of the depth",
    ),
]


@pytest.mark.parametrize(("table", "start"), WARN, ids=["breaking", "reach", "repeats", "slender", "shallow"])
def test_what_is_doubtful_is_a_warning_with_numbers(table, start):
    scene = dj.Scene.from_dict(table)
    assert any(printed.startswith(start) for printed in sea_warnings(scene, make_sea(scene.sea)))


@pytest.mark.parametrize("farm", ["dropper-farm-2", "dropper-farm-4"])
def test_shelter_that_does_not_turn_with_the_current_is_a_warning(farm):
    def reported(direction):
        scene = dj.load_scene(farm).with_values({"sea.current.direction": direction})
        return [printed for printed in sea_warnings(scene, make_sea(scene.sea)) if printed.startswith("line.shelter")]

    assert not reported(0.0)
    assert not reported(0.5)
    assert "the current flows at 90 degrees from x" in reported(np.pi / 2)[0]
    assert reported(np.pi)


def test_the_tail_of_a_spectrum_is_no_reason_to_warn():
    waves = {"kind": "components", "amplitude": [1.0, 0.05], "period": [10.0, 1.3]}
    scene = dj.Scene.from_dict(changed(line__0__diameter=0.9, sea__waves=waves))
    assert not any("diameter" in printed for printed in sea_warnings(scene, make_sea(scene.sea)))


def test_a_measured_elevation_comes_back_between_its_samples():
    t = np.arange(0.0, 60.0, 0.5)
    eta = 0.7 * np.cos(2 * np.pi * 6 / 60 * t + 0.4) + 0.2 * np.sin(2 * np.pi * 15 / 60 * t)
    waves = elevation_components(t, eta)
    fine = np.linspace(0, 59, 400)
    found = np.cos(waves["phase"] - 2 * np.pi / waves["period"] * fine[:, None]) @ waves["amplitude"]
    expected = 0.7 * np.cos(2 * np.pi * 6 / 60 * fine + 0.4) + 0.2 * np.sin(2 * np.pi * 15 / 60 * fine)
    np.testing.assert_allclose(found, expected, atol=1e-10)


@pytest.fixture
def dataset():
    """`dataset(density, frequency, coming)`: a dataset as wavespectra has them."""
    xarray = pytest.importorskip("xarray", reason="reading wavespectra datasets needs the extra io")

    def make(density, frequency, coming, axes=("freq", "dir")):
        return xarray.Dataset({"efth": (axes, density)}, {"freq": frequency, "dir": coming})

    return make


@pytest.mark.parametrize(
    "coming",
    [np.arange(0.0, 360.0, 10.0), np.arange(180.0, 275.0, 10.0), np.arange(-180.0, 180.0, 10.0)],
    ids=["all", "sector", "signed"],
)
def test_a_wavespectra_dataset_becomes_a_sea_of_its_energy_and_course(dataset, coming):
    frequency = np.linspace(0.05, 0.3, 26)
    density = np.exp(-((frequency - 0.1) ** 2) / 2e-4)[:, None] * (np.mod(coming, 360.0) == 270.0)
    waves = from_wavespectra(dataset(density, frequency, coming), seed=1)
    assert 0.5 * np.sum(waves["amplitude"] ** 2) == pytest.approx(np.sum(density) * 0.01 * 10.0, rel=1e-6)
    np.testing.assert_allclose(waves["direction"], 0.0, atol=1e-12)  # from the west, so towards +x
    assert dj.Scene.from_dict(changed(sea__waves=waves)).sea.waves.kind == "components"
    every = from_wavespectra(dataset(np.ones((26, len(coming))), frequency, coming))
    dj.Scene.from_dict(changed(sea__waves=every))  # no direction beyond a turn


FREQUENCIES = np.linspace(0.05, 0.3, 6)
DENSITY = np.arange(1.0, 13.0).reshape(6, 2)
FROM_WEST = [260.0, 270.0]


def test_a_wavespectra_dataset_with_falling_frequencies_is_that_with_rising_ones(dataset):
    rising = from_wavespectra(dataset(DENSITY, FREQUENCIES, FROM_WEST))
    falling = from_wavespectra(dataset(DENSITY[::-1], FREQUENCIES[::-1], FROM_WEST))
    assert np.sum(falling["amplitude"] ** 2) == pytest.approx(np.sum(rising["amplitude"] ** 2))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0.0 * DENSITY, FREQUENCIES, FROM_WEST), "efth: needs finite densities"),
        ((-DENSITY, FREQUENCIES, FROM_WEST), "efth: needs finite densities"),
        ((np.where(DENSITY == 3.0, np.nan, DENSITY), FREQUENCIES, FROM_WEST), "efth: needs finite densities"),
        ((DENSITY, FREQUENCIES - 0.05, FROM_WEST), "efth: needs finite densities"),  # at 0 Hz
        ((DENSITY, FREQUENCIES - 0.1, FROM_WEST), "freq: "),
        ((DENSITY, np.nan * FREQUENCIES, FROM_WEST), "freq: "),
        ((DENSITY, FREQUENCIES[[0, 2, 1, 3, 4, 5]], FROM_WEST), "freq: "),
        ((DENSITY, 0.1 * np.ones(6), FROM_WEST), "freq: "),
        ((np.ones((6, 5)), FREQUENCIES, np.arange(0.0, 361.0, 90.0)), "dir: "),  # north twice
        ((np.ones((6, 3)), FREQUENCIES, [0.0, 10.0, 30.0]), "dir: "),
        ((np.ones((2, 6, 2)), FREQUENCIES, FROM_WEST, ("time", "freq", "dir")), "efth: has the dimensions ("),
        ((DENSITY[:, :1], FREQUENCIES, FROM_WEST[:1]), "efth: has the dimensions ("),
    ],
)
def test_wavespectra_datasets_without_one_sea_are_refused(dataset, given, message, refusal):
    assert refusal(from_wavespectra, dataset(*given)).startswith(f"dataset.{message}")


def test_an_elevation_that_does_not_change_is_refused(tmp_path, refusal):
    file = tmp_path / "flat.csv"
    file.write_text("t_s,elevation_m\n" + "".join(f"{i},0.3\n" for i in range(8)))
    waves = {"kind": "elevation", "file": str(file)}
    assert "has one elevation at all times" in refusal(dj.load_scene, changed(sea__waves=waves))


@pytest.mark.parametrize(("hs", "height"), [(0.0, -5.0), (2.0, 40.0)], ids=["calm", "line in air"])
def test_an_interpolated_sea_has_the_water_of_its_components(hs, height):
    sea = {"depth": 50.0, "waves": {"kind": "spectrum", "hs": hs, "tp": 7.0, "count": 5}, "interpolation": "grid"}
    spec = SeaSpec.read(sea, "sea")
    r = jnp.asarray([[2.0, 1.0, height], [-3.0, 0.0, height - 2.0]])
    found = make_sea(spec, (np.array([0.0, 0.0, height]), 5.0)).at(r, jnp.asarray(3.0))
    exact = make_sea(spec).at(r, jnp.asarray(3.0))
    np.testing.assert_allclose(found.velocity, exact.velocity, atol=1e-3)


def test_the_interpolated_sea_keeps_its_stated_error():
    waves = {"kind": "spectrum", "hs": 2.0, "tp": 7.0, "count": 40, "direction": 1.5}
    model = build_model(dj.load_scene(changed(sea__waves=waves, sea__interpolation="grid", sea__depth=30.0)))
    grid = model.sea.waves
    assert float(jnp.max(grid.error)) < 1e-3
    rng = np.random.default_rng(5)
    r = jnp.asarray(rng.uniform([-1, -4, -5], [1, 4, 0], (200, 3)))
    for t in (3.0, 1234.5):
        exact, found = (kind.motion(grid, r, jnp.asarray(t), 30.0) for kind in (Waves, type(grid)))
        for a, b, e in zip(exact[1:], found[1:], grid.error, strict=True):
            size = np.sqrt(3 * np.mean(np.asarray(a) ** 2))
            assert np.max(np.abs(a - b)) < 3 * float(e) * size
        np.testing.assert_allclose(found.elevation, exact.elevation, atol=1e-3)
