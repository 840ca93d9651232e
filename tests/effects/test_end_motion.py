"""Moving ends: harmonic with a ramp, from a table, and the work they do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.effects import EndMotion

G = 9.81


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


def test_moving_the_end_of_a_hanging_mass_up_does_the_work_of_lifting_it(chain):
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


def test_a_table_with_a_ramp_leaves_its_first_row_without_a_jump():
    rows, time = [[0.1, 0.0, 0.0], [0.5, 0.0, 0.2], [0.9, 0.0, 0.4], [1.3, 0.0, 0.6]], [0.0, 1.0, 2.0, 3.0]
    plain, ramped = (
        EndMotion(time=jnp.array(time), displacement=jnp.array(rows), point="end", **more)
        for more in ({}, {"ramp": jnp.asarray(2.0)})
    )
    for t in (0.0, 0.5, 1.3, 2.0, 2.7):
        u = min(t / 2.0, 1.0)
        first = np.array(rows[0])
        expected = first + (np.asarray(plain.displace(t)) - first) * (u**3 * (10 - 15 * u + 6 * u * u))
        np.testing.assert_allclose(ramped.displace(t), expected, atol=1e-14)
    velocity = jax.jacfwd(ramped.displace)
    np.testing.assert_allclose(velocity(0.0), 0.0, atol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(velocity)(0.0), 0.0, atol=1e-12)
    np.testing.assert_allclose(ramped.kinks, [3.0])


@pytest.mark.parametrize(
    "both",
    [
        {"time": [0.0, 1.0], "displacement": [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], "amplitude": [1.0, 0.0, 0.0]},
        {"time": [5.0, 9.0], "amplitude": [1.0, 0.0, 0.0], "period": 2.0},
    ],
)
def test_keys_of_a_table_and_of_a_harmonic_motion_are_not_combined(both, chain, refusal):
    scene = chain([0.3], [0.2], {"kind": "static"}, effects={"weight": {}, "end_motion": {"point": "left", **both}})
    assert "give either `amplitude` and `period`, or `time` and `displacement`" in refusal(dj.load_scene, scene)
