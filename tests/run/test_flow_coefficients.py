"""Drag and added mass that follow the flow: the numbers of the practice, KC in closed form, what is refused."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import free_at, line_of, scene_of

import dropper_jax as dj
from dropper_jax.effects.rough_cylinder import amplification, rough_added_mass, rough_drag, steady_drag
from dropper_jax.modelling.flow_coefficients import VISCOSITY, flow_table, link_flow

ROUGH = {
    "morison_drag": {"coefficients": "rough_cylinder", "roughness": 0.03},
    "morison_inertia": {"coefficients": "rough_cylinder", "cat": 0.1},
}
SCENE = scene_of(
    {"a": [0, 0, -1.0], "b": free_at([0, 0, -5.0])},
    line_of("l", "a", "b", 4, 1.0, mass=40.0, diameter=0.15),
    run={"dt": 0.02, "duration": 0.2},
    effects={"weight": {}, "buoyancy": {}, **ROUGH},
    start={"kind": "angles", "zero": "down", "polar": [0.0] * 4},
    sea={"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.2, "period": 6.0}},
)


def test_the_numbers_that_a_public_practice_states():
    # API RP 2A-WSD (2014), 5.3.1.2.8: smooth 0.65 and C_M 1.6, rough 1.05 and 1.2, of currents and large waves
    np.testing.assert_allclose(steady_drag([1e-5, 0.02]), [0.65, 1.05])
    np.testing.assert_allclose(1.0 + rough_added_mass(60.0, np.array([1e-5, 0.02])), [1.6, 1.2])
    # B.5.3.1.2.8.2: 1.00 to 1.10 with marine growth, 0.6 to 0.7 of k = 0.05 mm on members of 0.5 to 2 m
    growth, bare = steady_drag(np.array([0.01, 0.05, 0.2])), steady_drag(0.05e-3 / np.array([0.5, 2.0]))
    assert np.all((growth >= 1.0) & (growth <= 1.1))
    assert np.all((bare >= 0.6) & (bare <= 0.7))
    # B.5.3.1.2.8.4: C_M is 2 up to K = 3, and 1.6 (smooth), 1.2 (rough) from K/C_DS = 17 on; reached here by 21
    assert np.all(rough_added_mass(np.array([0.5, 3.0 - 1e-9]), 0.02) == 1.0)
    assert float(rough_added_mass(21.0 * 0.65, 1e-5)) == pytest.approx(0.6)
    assert float(rough_added_mass(21.0 * 1.05, 0.02)) == pytest.approx(0.2)
    # B.5.3.1.2.8.5: the steady drag where the current is above 0.4 of the wave's velocity
    share = lambda ratio: ratio / (1.0 + ratio)  # noqa: E731
    assert float(rough_drag(12.0, 0.05, share(0.41))) == pytest.approx(1.05)
    assert float(rough_drag(12.0, 0.05, share(0.39))) > 1.4


def test_the_numbers_taken_from_the_other_practice():
    # DNV-RP-C205, from memory: smooth 0.65, k/D = 1e-3: (29 - 12)/20, rough 1.05
    np.testing.assert_allclose(steady_drag([1e-6, 1e-3, 0.05]), [0.65, 0.85, 1.05])
    # C_pi = 1.50 - 0.024 (12/1.05 - 10) = 1.465714: psi at KC 0.5, 1, 7, 12
    top = 1.4657142857
    np.testing.assert_allclose(amplification([0.5, 1.0, 7.0, 12.0], 1.05), [top - 0.5, top - 1.0, top - 0.5, top])
    assert amplification(np.inf, 1.05) == amplification(200.0, 1.05) == 1.0
    # C_A: 1 up to KC 3, 1 - 0.044 * 7 at 10 (smooth), at most down to 0.6 - (C_DS - 0.65)
    np.testing.assert_allclose(rough_added_mass([2.0, 10.0, 90.0], 1e-6), [1.0, 0.692, 0.6])
    assert float(rough_added_mass(90.0, 0.05)) == pytest.approx(0.2)
    # half of the flow is current: the wake is carried away
    assert float(rough_drag(12.0, 0.05, 0.5)) == pytest.approx(1.05)


def test_kc_of_a_hanging_line_is_that_of_the_orbits():
    flow = link_flow(dj.load_scene(SCENE))
    omega = 2 * np.pi / 6.0
    k = omega**2 / 9.81
    for _ in range(200):
        k = omega**2 / (9.81 * np.tanh(20.0 * k))
    z = -1.5 - np.arange(4)
    # upright links: across them the level velocity alone, amplitude a w cosh k(z + d)/sinh kd; KC = u T/D
    speed = 0.2 * omega * np.cosh(k * (z + 20.0)) / np.sinh(20.0 * k)
    np.testing.assert_allclose(flow.kc, speed * 6.0 / 0.15, rtol=1e-3)
    np.testing.assert_allclose(flow.re, speed / np.sqrt(2) * 0.15 / VISCOSITY, rtol=1e-3)
    np.testing.assert_allclose(flow.coefficients["morison_drag"], rough_drag(flow.kc, 0.2, 0.0))
    assert np.all(flow.current == 0.0)


def test_a_spectrum_has_the_kc_of_its_variance_and_mean_period():
    scene = dj.load_scene(SCENE).with_values({"sea.waves": {"kind": "spectrum", "hs": 1.0, "tp": 8.0, "count": 60}})
    model, _ = dj.build(scene)
    times = jnp.linspace(0.0, 4000.0, 4001)
    places = jnp.asarray([[0.0, 0.0, -2.5]])
    u = jax.vmap(lambda t: model.sea.without_waves().at(places, t).velocity[0, 0] + _level(model.sea, places, t))(times)
    waves = model.sea.waves
    tz = 2 * np.pi * np.sqrt(float(jnp.sum(waves.amplitude**2) / jnp.sum((waves.amplitude * waves.omega) ** 2)))
    expected = np.sqrt(2.0) * float(jnp.std(u)) * tz / 0.15
    assert link_flow(scene).kc[1] == pytest.approx(expected, rel=0.03)  # the series is finite


def _level(sea, places, t):
    # unstretched, as linear theory has it at a fixed place
    return sea.waves.airy_velocity(places, t, sea.depth)[0, 0]


def test_the_program_is_that_of_given_numbers():
    scene = dj.load_scene(SCENE)
    found = link_flow(scene).coefficients
    numbers = {"coefficients": "given", "cdn": found["morison_drag"].tolist()}
    given = {**SCENE, "effects": {**SCENE["effects"], "morison_drag": numbers}}
    given["effects"]["morison_inertia"] = {"can": found["morison_inertia"].tolist(), "cat": 0.1}
    (a, _), (b, _) = dj.build(scene), dj.build(given)
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(x, y)
    assert dj.Scene.from_dict(scene.to_dict()) == scene
    assert scene.to_dict()["effects"]["morison_drag"]["coefficients"] == "rough_cylinder"


def test_tables_of_ones_own_are_taken_between_their_rows():
    table = {"coefficients": "table", "table_kc": [0.0, 20.0], "table_cdn": [1.0, 2.0]}
    scene = dj.load_scene({**SCENE, "effects": {**SCENE["effects"], "morison_drag": table}})
    flow = link_flow(scene)
    np.testing.assert_allclose(flow.coefficients["morison_drag"], 1.0 + flow.kc / 20.0)


TABLE = {"coefficients": "table"}
BAD = [
    ({**TABLE, "table_kc": [0.0, 2.0], "table_cdn": [1.0, 1.0]}, "morison_drag.table_kc: KC = 7."),
    ({**TABLE, "table_kc": [0.0, 2.0]}, "morison_drag.table_kc: needs at least 2 rising values"),
    (
        {**TABLE, "table_kc": [0.0, 90.0], "table_cdn": [1.0, 1.0], "table_re": [1e5, 1e6]},
        "morison_drag.table_re: Re = ",
    ),
    (
        {"cdn": 1.0, "table_cdn": [1.0, 1.0]},
        "morison_drag.table_cdn: [1.0, 1.0] is not used by coefficients 'given'; allowed: with 'table'",
    ),
    ({}, "morison_drag.cdn: missing; needed: drag coefficient across the link"),
    ({"coefficients": "rough_cylinder", "roughness": -0.1}, "morison_drag.roughness: -0.1 is out of range"),
    ({"coefficients": "rough"}, "morison_drag.coefficients: 'rough' is unknown"),
    (
        {"coefficients": "rough_cylinder", "cdn": 1.2},
        "morison_drag.cdn: 1.2 is not used by coefficients 'rough_cylinder'; allowed: with 'given'",
    ),
    (
        {"cdn": 1.2, "table_kc": [0.0, 9.0]},
        "morison_drag.table_kc: [0.0, 9.0] is not used by coefficients 'given'; allowed: with 'table'",
    ),
]


@pytest.mark.parametrize(("drag", "start"), BAD, ids=[start[13:40] for _, start in BAD])
def test_what_is_outside_of_a_table_or_does_not_fit_is_named(drag, start, refusal):
    scene = {**SCENE, "effects": {**SCENE["effects"], "morison_drag": drag}}
    assert refusal(dj.build, scene).startswith(f"effects.{start}")


def test_roughness_without_a_rough_cylinder_is_refused(refusal):
    """Added mass of a rough cylinder uses the roughness of the drag."""
    drag = {"cdn": 1.2, "roughness": 0.03}
    scene = {**SCENE, "effects": {**SCENE["effects"], "morison_drag": drag}}
    assert dj.load_scene(scene).effects["morison_drag"]["roughness"] == 0.03
    scene["effects"]["morison_inertia"] = {"can": 1.0}
    line = refusal(dj.load_scene, scene)
    assert line.startswith("effects.morison_drag.roughness: 0.03 is not used by coefficients 'given'; allowed: with")


def test_coefficients_of_line_types_are_left_out_where_the_flow_gives_them():
    rope = {"name": "rope", "mass": 40.0, "diameter": 0.15, "EA": 1e6, "cdn": 1.1, "cdt": 0.2, "can": 0.9}
    line = {key: value for key, value in SCENE["line"][0].items() if key not in ("mass", "diameter", "axial")}
    line |= {"type": "rope", "length": 4.0, "links": 4}
    scene = dj.load_scene({**SCENE, "line_type": [rope], "line": [line], "start": {"kind": "static"}})
    assert scene.effects["morison_drag"]["cdn"] is None
    assert np.allclose(scene.effects["morison_drag"]["cdt"], 0.2)
    given = scene.with_values({"effects.morison_inertia.coefficients": "given"})
    assert np.allclose(given.effects["morison_inertia"]["can"], 0.9)
    assert dj.Scene.from_dict(scene.to_dict()) == scene


def test_command_and_table_say_the_numbers(printed, json_of, file_of):
    scene = dj.load_scene(SCENE)
    rows = flow_table(scene)
    assert rows[0]["cdn"]["min"] < rows[0]["cdn"]["max"]
    assert not rows[0]["post_critical"]
    file = file_of(scene)
    assert json_of(["sea", file, "--json"])["coefficients"] == json.loads(json.dumps(rows))
    assert "share of the current" in printed(["sea", file]).out
