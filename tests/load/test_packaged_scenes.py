"""The packaged scenes: all of them, and the numbers of those that a source prints."""

import json

import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import Scene, build_model, load_scene, packaged_scene, scene_names
from dropper_jax.load.variants import DAMPING

EXPECTED = {f"paper-case-{number}{end}" for number in range(1, 6) for end in ("", "-table-6")}
EXPECTED |= {f"paper-case-{number}-pitching" for number in range(1, 4)}
EXPECTED |= {f"dropper-release-{kind}{end}" for kind in (*"abcde", "3d", "a-compound") for end in ("", "-undamped")}
EXPECTED |= {*(f"dropper-release-{letter}-ramp" for letter in "abcde")}
EXPECTED |= {*(f"dropper-release-{letter}-ramp-14" for letter in "abc")}
EXPECTED |= {"edulis-longline", "edulis-tide", "looped-longline", "platform-longline", "rigid-dropper-longline"}
EXPECTED |= {"dropper-farm", "longline-200", "longline-rows", "ballasted-spar", "string", "string-in-current"}
EXPECTED |= {"conical-pendulum", "conical-pendulum-damped", "double-pendulum-periodic", "double-pendulum-chaotic"}
EXPECTED |= {"dropper-current", "dropper-regular-wave", "wet-pendulum-wave", "dropper-north-sea"}
EXPECTED |= {"dropper-north-sea-thesis", "dropper-north-sea-thesis-relative"}
EXPECTED |= {"measured-single-pendulum", "measured-double-pendulum"}

#: Link angles [rad] of the thesis' simulation before the release (Tables E.2 to E.4, signs as those of A).
MODEL_ANGLES = {
    "a": (0.1577, 1.4490, 1.3606, 0.8666, -1.1492, -1.3909, -1.4571),
    "b": (1.3264, 0.2358, 1.3713, 0.8197, -1.2286, -1.4166, -1.4752),
    "c": (1.4288, 1.2475, -0.8729, 1.3243, -0.1956, -1.3396, -1.4526),
}


def test_packaged_scenes_are_the_promised_ones():
    assert set(scene_names()) == EXPECTED


@pytest.mark.parametrize("name", ["foo", "foo-ramp", "paper-case-1-undamped", "dropper-farm-x"])
def test_a_name_without_a_packaged_scene_is_a_key_error(name):
    with pytest.raises(KeyError):
        packaged_scene(name)


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_packaged_scene_survives_plain_values_and_builds(name):
    scene = load_scene(name)
    assert scene.description.endswith(".")
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    model = build_model(scene)
    assert model.line.links == sum(line.links for line in scene.lines)
    assert model.dtype == np.float64
    assert name.endswith("-undamped") <= (not any(effect in scene.effects for effect in DAMPING))


def test_lab_dropper_has_the_links_of_table_8_1_with_b_first():
    line = load_scene("dropper-release-b").lines[0]
    np.testing.assert_array_equal(line.length, [0.1040, 0.1061] * 3 + [0.1040])
    np.testing.assert_array_equal(line.mass, [0.0324, 0.0334] * 3 + [0.0324])


def test_compound_bars_follow_from_table_d_1():
    line = load_scene("dropper-release-a-compound").lines[0]
    fitting, far = 6.2e-3 + 7.65e-3, 0.150
    for j, bar in enumerate([19.5e-3, 18.6e-3] * 3 + [19.5e-3]):
        mass = bar + fitting
        centre = (bar * far / 2 + fitting * far) / mass
        about_pivot = bar * far**2 / 3 + fitting * far**2
        assert line.mass[j] == pytest.approx(mass, rel=1e-12)
        assert line.centre_of_mass[j] == pytest.approx(centre, rel=1e-10)
        assert line.inertia[j] == pytest.approx(about_pivot - mass * centre**2, rel=1e-9)


@pytest.mark.parametrize(("letter", "node", "force"), [("a", 1, 1.128), ("b", 2, 0.78), ("c", 3, 0.78), ("d", 4, 0.6)])
def test_ramps_rise_from_rest_as_the_thesis_prints_them_until_the_release(letter, node, force):
    """(E.1)-(E.3), 0.094 and 0.065 N/s from 3 to 15 s; of D and E the thesis gives no force."""
    scene = load_scene(f"dropper-release-{letter}-ramp")
    assert (scene.start.kind, scene.run.step, scene.run.duration) == ("static", 0.0065, 65.0)
    ramp = build_model(scene).effect("nodal_force")
    assert ramp.nodes == (node,)
    times = [0.0, 3.0, 9.0, 14.999, 15.001]
    lifted = [float(ramp.factor(t) * ramp.force_n[0, 2]) for t in times]
    np.testing.assert_allclose(lifted, [0.0, 0.0, 0.5 * force, force, 0.0], atol=2e-4)


@pytest.mark.check
@pytest.mark.parametrize(("letter", "difference"), [("a", 0.023), ("b", 0.011), ("c", 0.003)])
def test_released_at_14_1_s_the_ramp_meets_the_angles_of_the_thesis_model(letter, difference):
    """RMS over the links before the release to Tables E.2 to E.4; at 15 s it is 0.09 to 0.10 rad."""
    scene = load_scene(f"dropper-release-{letter}-ramp-14")
    assert scene.effects["nodal_force"]["release"] == 14.1
    run = dj.simulate(scene, dt=scene.run.step, duration=14.1)
    before = run.polar[np.searchsorted(run.t, 14.1 - scene.run.step)]
    assert np.sqrt(np.mean((before - MODEL_ANGLES[letter]) ** 2)) == pytest.approx(difference, abs=6e-4)


def test_the_relative_form_of_the_thesis_force_is_a_scene():
    plain, relative = (load_scene(f"dropper-north-sea-thesis{end}").to_dict() for end in ("", "-relative"))
    force = plain["effects"]["thesis_wave_force"] | {"velocity": "relative"}
    assert relative["effects"] == plain["effects"] | {"thesis_wave_force": force}
    assert all(relative[key] == plain[key] for key in ("point", "line", "sea"))
