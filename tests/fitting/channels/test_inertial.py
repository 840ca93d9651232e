"""Accelerometers and gyroscopes on links: what they show of known motions, and fits to SciPy's with every defect."""

import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import rods
from scipy.integrate import solve_ivp

from dropper_jax import SceneError, load_scene
from dropper_jax.base.constants import GRAVITY
from fitting import fit_channels
from fitting.channels.channel import SavedMotion
from fitting.channels.inertial import Accelerometer, Gyro
from fitting.channels.make_problem import make_problem
from fitting.channels.observe import at_times

MASS, LENGTH, B_L, B_Q, START = 0.2, 0.5, 0.04, 0.05, 0.8
POSITION, TURN, LATE = 0.31, 0.05, 0.013
BIAS, SPIN, PULL, DEEP = (0.12, -0.07), 0.015, 1.03, 0.011
NOISE = {"along": 0.05, "across": 0.05, "spin": 0.01, "pull": 0.01, "deep": 0.002, "angle": 0.005}
COMMON = {"name": "a", "columns": ("c", "d"), "unit": "-"}
CHANNELS = [
    {
        **{"name": "acc", "kind": "accelerometer", "columns": ["along", "across"], "unit": "m/s^2"},
        **{"link": 1, "position": 0.25},
    },
    {"name": "spin", "kind": "gyro", "column": "spin", "unit": "deg/s", "link": 1},
    {"name": "pull", "kind": "tension", "column": "pull", "unit": "N", "point": "pivot"},
    {"name": "deep", "kind": "depth", "column": "deep", "unit": "m", "end": "to"},
]
DEFECTS = {
    "channel.acc.offset.0": BIAS[0],
    "channel.acc.offset.1": BIAS[1],
    "channel.acc.position": POSITION,
    "channel.acc.turn": TURN,
    "channel.acc.delay": LATE,
    "channel.spin.offset": SPIN,
    "channel.pull.gain": PULL,
    "channel.deep.offset": DEEP,
}
TRUTH = {"effects.linear_damping.b_l": B_L, "effects.quadratic_damping.b_q": B_Q, "start.polar.0": START} | DEFECTS


def acceleration(angle, rate):
    speed = LENGTH * rate
    return -GRAVITY / LENGTH * np.sin(angle) - (B_L + B_Q * abs(speed)) * rate / MASS


def swing(t):
    """Angle from straight down, rate and acceleration of a pendulum with linear and quadratic drag."""
    rates = lambda _, y: [y[1], acceleration(*y)]  # noqa: E731
    angle, rate = solve_ivp(rates, (0, 5), [START, 0], "DOP853", rtol=1e-11, atol=1e-12, dense_output=True).sol(t)
    return angle, rate, acceleration(angle, rate)


def columns():
    """What the sensors read, with noise and every defect."""
    t = np.arange(0.0, 4.0, 0.02)
    angle, rate, _ = swing(t)
    then = swing(np.maximum(t - LATE, 0.0))
    radial = -POSITION * then[1] ** 2 - GRAVITY * np.cos(then[0])
    tangential = -(POSITION * then[2] + GRAVITY * np.sin(then[0]))
    clean = {
        "along": np.cos(TURN) * radial + np.sin(TURN) * tangential + BIAS[0],
        "across": np.cos(TURN) * tangential - np.sin(TURN) * radial + BIAS[1],
        "spin": -rate + SPIN,
        "pull": PULL * MASS * (GRAVITY * np.cos(angle) + LENGTH * rate**2),
        "deep": LENGTH * np.cos(angle) + DEEP,
    }
    random = np.random.default_rng(0)
    found = {name: y + NOISE[name] * random.normal(size=len(t)) for name, y in clean.items()}
    return {"t": t, **found, "spin": np.degrees(found["spin"])}


def scene():
    effects = {"linear_damping": {"b_l": 0.02}, "quadratic_damping": {"b_q": 0.1}}
    return rods([0.78], LENGTH, MASS, effects) | {"run": {"dt": 0.01, "duration": 4.0, "integrator": "rattle_4"}}


def turning(spacing):
    """A link of 2 m that turns at 3 rad/s from +x downwards about its first node, which falls freely."""
    t = jnp.arange(0, 2, spacing)
    first = jnp.stack([0 * t, 0 * t, -0.5 * GRAVITY * t**2], axis=1)
    d = 2 * jnp.stack([jnp.cos(3 * t), 0 * t, -jnp.sin(3 * t)], axis=1)
    nodes = jnp.stack([first, first + d], axis=1)
    return SavedMotion(nodes, nodes[1:], jnp.zeros((len(t) - 1, 1)), spacing)


def test_an_accelerometer_in_free_fall_shows_only_the_turning_and_a_gyro_its_rate():
    motion = turning(0.01)
    shown = Accelerometer(**COMMON, position=1.5, axes=(0, 1, 2)).see(motion)
    assert np.allclose(shown, [-1.5 * 9, 0.0, 0.0], atol=1e-5)
    turned = Accelerometer(**COMMON, position=1.5, turn=0.3).see(motion)
    assert np.allclose(turned, [-13.5 * np.cos(0.3), 13.5 * np.sin(0.3)], atol=1e-5)
    assert np.allclose(Gyro(**COMMON).see(motion), 3.0, atol=1e-5)


@pytest.mark.check
def test_at_rest_it_shows_gravity_upwards_and_errors_are_of_fourth_order():
    still = turning(0.01)._replace(nodes=jnp.zeros((9, 2, 3)).at[:, 1, 2].set(-1.0))
    assert np.allclose(Accelerometer(**COMMON).see(still), [-GRAVITY, 0.0])
    off = [np.abs(Accelerometer(**COMMON, position=1.5).see(turning(h))[:, 0] + 13.5).max() for h in (0.08, 0.04)]
    assert 14 < off[0] / off[1] < 18
    t = jnp.linspace(0.0, 1.9, 50)  # the ends are extrapolated
    assert np.allclose(at_times(Gyro(**COMMON).see(turning(0.01)), 0.02, 0.01, t), 3.0, atol=1e-5)


@pytest.mark.check
def test_damping_and_every_defect_of_four_sensors_are_found_within_their_errors():
    found = fit_channels({"run": [{"file": columns()}], "channel": CHANNELS}, scene(), list(TRUTH))
    assert found.status == "ok", found.message
    off = {name: (found[name] - value) / found.estimates()[name]["std_error"] for name, value in TRUTH.items()}
    assert max(map(abs, off.values())) < 3.5, off
    assert found.estimates()["channel.acc.position"]["std_error"] < 0.005


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"link": 2}, r"channel\.0\.link: 2 is outside line 'chain'; allowed: 1 to 1"),
        ({"position": 0.7}, r"channel\.0\.position: 0\.7 is out of range; allowed: a number 0 to 0\.5"),
        ({"axes": ["along", "up"]}, r"channel\.0\.axes\.1: 'up'"),
        ({"axes": ["along"]}, "2 columns for 1 axes"),
        ({"unit": "m"}, r"channel\.0\.unit: 'm' is not a unit of this quantity; allowed: m/s\^2, gn"),
    ],
)
def test_a_sensor_that_its_link_cannot_carry_is_refused_in_one_line(change, message):
    table = {"run": [{"file": columns()}], "channel": [CHANNELS[0] | change]}
    with pytest.raises(SceneError, match=message):
        fit_channels(table, scene(), ["b_l"])


def test_states_saved_too_rarely_are_refused():
    sparse = scene() | {"run": {"dt": 0.01, "duration": 4.0, "save_every": 5}}
    with pytest.raises(SceneError, match="save_every up to 2"):
        fit_channels({"run": [{"file": columns()}], "channel": CHANNELS[:1]}, sparse, ["b_l"])


def test_a_brief_run_has_the_states_that_cubics_of_an_accelerometer_need():
    """Three samples a little over an interval apart; cubics need four rows besides two lost at either end."""
    t = [0.0, 0.012, 0.024]
    data = {
        "run": [{"file": {"t": t, "along": [0.0] * 3, "across": [0.0] * 3}}],
        "channel": [{**CHANNELS[0], "noise": 0.1}],
    }
    problem = make_problem(data, load_scene(scene()), ["b_l"], [], {}, {}, {})
    assert problem.plan(0).saves + 1 - 2 * 2 >= 4
