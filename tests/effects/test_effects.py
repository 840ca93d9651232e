"""Each effect against its definition, and the energy balance that its work closes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.effects import EndMotion, NodalForce
from dropper_jax.model.work import work_names

G = 9.81
POSE = [[0.0, 0.0, 0.0], [0.3, 0.0, -0.4], [0.7, 0.3, -0.4], [0.7, 0.3, -0.9]]
SPEEDS = [[0, 0, 0], [0.4, 0.1, 0.3], [0.4, 0.1, 0.3], [0.9, 0.1, 0.3]]
RELEASE = "dropper-release-a-undamped"


@pytest.fixture(scope="module")
def instant(chain):
    """`instant(effects)`: the model of three links of 0.5 m with a free end in a fixed pose, and its kinematics."""

    def make(effects, **line):
        start = {"kind": "positions", "positions": POSE, "velocities": SPEEDS}
        model, s = dj.build(chain([0.5] * 3, [0.2, 0.1, 0.3], start, effects=effects, **line))
        return model, model.kinematics(s.r, s.v, s.t)

    return make


def force_of(model, k):
    return np.asarray(model.force(k))


def test_weight_is_mass_times_gravity_downwards(instant):
    model, k = instant({"weight": {"gravity": 9.7}})
    np.testing.assert_allclose(force_of(model, k), -9.7 * np.outer([0.2, 0.1, 0.3], [0, 0, 1]), rtol=1e-14)
    assert model.potential_energy(k) == pytest.approx(9.7 * (-0.08 - 0.04 - 0.27), rel=1e-14)


def test_weight_in_water_takes_the_place_of_the_weight_in_air(instant):
    model, k = instant({"weight": {"wet_weight": [0.5, -0.2, 0.1]}})
    np.testing.assert_allclose(force_of(model, k)[:, 2], [-0.5, 0.2, -0.1], rtol=1e-14)


def test_weight_of_compound_links_acts_in_their_centres_of_mass(instant):
    """Virtual work: the potential is m g z of the centres, and minus its gradient is the force."""
    model, k = instant({"weight": {}}, centre_of_mass=[0.2, 0.1, 0.4], inertia=1e-3)
    z = np.array(POSE)[:, 2]
    centres = z[:-1] + np.array([0.4, 0.2, 0.8]) * np.diff(z)
    assert model.potential_energy(k) == pytest.approx(G * np.dot([0.2, 0.1, 0.3], centres), rel=1e-13)
    gradient = jax.grad(lambda r: model.potential_energy(model.kinematics(r, k.v, k.t)))(k.r)
    np.testing.assert_allclose(force_of(model, k), -gradient, atol=1e-14)


def test_linear_damping_is_minus_b_v_per_node(instant):
    model, k = instant({"linear_damping": {"b_l": [0.1, 0.2, 0.3]}})
    np.testing.assert_allclose(force_of(model, k), -np.array([[0.1], [0.2], [0.3]]) * np.array(SPEEDS)[1:], rtol=1e-14)


@pytest.mark.parametrize("form", ["isotropic", "componentwise"])
def test_quadratic_damping_opposes_the_motion_whatever_its_sign(instant, form):
    model, k = instant({"quadratic_damping": {"b_q": 0.7, "form": form}})
    v = np.array(SPEEDS, float)[1:]
    for sign in (1, -1):
        size = np.abs(v) if form == "componentwise" else np.linalg.norm(v, axis=1, keepdims=True)
        found = force_of(model, k.with_velocity(jnp.asarray(sign * v)))
        np.testing.assert_allclose(found, -0.7 * size * sign * v, rtol=1e-12)
        assert np.sum(found * sign * v) < 0


def test_quadratic_damping_has_finite_derivatives_at_rest(instant):
    model, k = instant({"quadratic_damping": {"b_q": 0.7}})
    slope = jax.jacfwd(lambda v: model.force(k.with_velocity(v)))(jnp.zeros((3, 3)))
    np.testing.assert_allclose(slope, 0.0, atol=1e-12)


def ramp(t, start, rise, release):
    return 0.0 if t >= release else min(max((t - start) / rise, 0.0), 1.0)


@pytest.mark.parametrize("t", [0.0, 3.0, 4.0, 5.0, 9.0, 14.999, 15.0, 20.0])
def test_nodal_force_ramps_and_is_let_go_as_in_the_thesis(instant, t):
    """(E.1): min(max(0.094 (t - 3), 0), M g)."""
    values = {"nodes": [1, 3], "force_n": [[0, 0, 2.0], [1.0, -1.0, 0]], "start": 3.0, "rise": 4.0, "release": 15.0}
    model, k = instant({"nodal_force": values})
    expected = ramp(t, 3.0, 4.0, 15.0) * np.array([[0, 0, 2.0], [0, 0, 0], [1.0, -1.0, 0]])
    found = force_of(model, model.kinematics(k.r, k.v, jnp.asarray(t)))
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_nodal_force_is_constant_or_follows_its_table():
    force = jnp.ones((1, 3))
    assert NodalForce(force, nodes=(1,)).factor(7.0) == 1.0
    table = NodalForce(force, time=jnp.array([1.0, 2.0, 4.0]), scale=jnp.array([0.0, 1.0, -1.0]), nodes=(1,))
    found = [float(table.factor(t)) for t in (0.0, 1.5, 2.0, 3.0, 4.0, 9.0)]
    np.testing.assert_allclose(found, [0.0, 0.5, 1.0, 0.0, -1.0, -1.0], atol=1e-14)


def test_harmonic_end_motion_is_its_sine_and_its_ramp_has_no_jump_of_velocity():
    amplitude = jnp.array([0.1, 0.0, -0.2])
    motion = EndMotion(amplitude, jnp.array(2.0), jnp.array(0.3), jnp.array(5.0), point="right")
    for t in (0.0, 2.5, 5.0, 8.7):
        share = {0.0: 0.0, 2.5: 0.5}.get(t, 1.0)  # half way at half the time, by symmetry
        expected = share * np.array([0.1, 0.0, -0.2]) * np.sin(np.pi * t + 0.3)
        np.testing.assert_allclose(motion.displace(jnp.asarray(t)), expected, atol=1e-14)
    speed = jax.jacfwd(motion.displace)
    for t in (0.0, 5.0):
        jump = speed(jnp.asarray(t + 1e-9)) - speed(jnp.asarray(t - 1e-9))
        np.testing.assert_allclose(jump, 0.0, atol=1e-8)


def test_table_of_end_motion_passes_its_points_with_continuous_velocity():
    rng = np.random.default_rng(0)
    time, shift = np.array([0.0, 0.5, 1.2, 1.5, 2.5]), rng.normal(size=(5, 3))
    motion = EndMotion(time=jnp.asarray(time), displacement=jnp.asarray(shift), point="right")
    speed = jax.jacfwd(motion.displace)
    for i in range(5):
        np.testing.assert_allclose(motion.displace(jnp.asarray(time[i])), shift[i], atol=1e-13)
    for t in time[1:-1]:
        before, after = speed(jnp.asarray(t - 1e-9)), speed(jnp.asarray(t + 1e-9))
        np.testing.assert_allclose(before, after, atol=1e-6)
    np.testing.assert_allclose(motion.displace(jnp.asarray(9.0)), shift[-1])
    np.testing.assert_allclose(speed(jnp.asarray(9.0)), 0.0)


def test_table_of_a_steady_motion_is_exact():
    time = np.array([0.0, 0.7, 1.0, 2.0])
    motion = EndMotion(time=jnp.asarray(time), displacement=jnp.outer(time, jnp.array([1.0, 2.0, 3.0])), point="right")
    np.testing.assert_allclose(motion.displace(jnp.asarray(0.9)), 0.9 * np.array([1.0, 2.0, 3.0]), rtol=1e-13)
    np.testing.assert_allclose(jax.jacfwd(motion.displace)(jnp.asarray(1.6)), [1.0, 2.0, 3.0], rtol=1e-13)


END_MOTION = {"point": "right", "amplitude": [0.03, 0.01, 0.02], "period": 1.1, "ramp": 0.503}


@pytest.mark.parametrize(
    ("scene", "effects"),
    [
        (RELEASE, {"linear_damping": {"b_l": 0.01}, "quadratic_damping": {"b_q": 0.02}}),
        (RELEASE, {"nodal_force": {"nodes": [3], "force_n": [[0.1, 0.2, 0.0]], "rise": 0.5, "release": 1.2}}),
        (RELEASE, {"joint_friction": {"viscous": 2e-4}}),
        (RELEASE, {"end_motion": END_MOTION}),
        ("dropper-release-a-compound-undamped", {"end_motion": END_MOTION}),
    ],
    ids=["damping", "nodal force", "viscous joints", "moving end", "moving end of compound links"],
)
def test_work_of_each_effect_closes_the_energy_balance_to_rounding(scene, effects):
    changed = {f"effects.{name}.{key}": value for name, values in effects.items() for key, value in values.items()}
    solution = dj.simulate(dj.load_scene(scene).with_values(changed), dt=0.01, duration=2.0, halvings=0)
    assert solution.status == "ok"
    assert set(solution.work_names) == {name.replace("end_motion", "moving_ends") for name in effects}
    assert np.max(np.abs(solution.work[-1])) > 1e-4
    assert solution.energy_drift < 1e-11


def test_an_elastic_line_loses_what_its_internal_damping_takes_and_never_gains(chain):
    start = {"kind": "positions", "positions": [[0, 0, 0.0], [0.2, 0.1, -0.2], [0.4, 0, 0.0]]}
    axial = {"law": "elastic", "EA": 40.0, "damping": 0.2}
    scene = chain([0.25, 0.25], 0.1, start, right=[0.4, 0.0, 0.0], axial=axial)
    solution = dj.simulate(scene, dt=0.002, duration=1.0)
    assert solution.work_names == work_names(dj.build(scene)[0]) == ("internal_damping",)
    assert np.max(np.diff(solution.balance)) < 1e-12
    assert np.all(np.diff(solution.work[:, 0]) <= 0)


def test_moving_the_end_of_a_hanging_mass_up_does_the_work_of_lifting_it(march, chain):
    """The whole line moves up steadily by 0.4 m: m g times that, and its kinetic energy."""
    time, rise = [0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.4, 0.4]
    effects = {
        "weight": {},
        "linear_damping": {"b_l": 0.5},
        "end_motion": {"point": "left", "time": time, "displacement": [[0, 0, z] for z in rise]},
    }
    scene = chain([0.3, 0.2], [0.2, 0.1], {"kind": "static"}, effects=effects)
    solution = dj.simulate(scene, dt=0.005, duration=3.0)
    work = dict(zip(solution.work_names, solution.work[-1], strict=True))
    np.testing.assert_allclose(solution.positions[-1, :, 2], [0.4, 0.1, -0.1], atol=1e-9)
    assert work["moving_ends"] + work["linear_damping"] == pytest.approx(0.3 * G * 0.4, rel=1e-9)
    assert work["linear_damping"] < 0
