"""Clamps that turn: a cantilever shaken and turned against the modes of its equation, work, quaternions, refusals."""

import jax.numpy as jnp
import numpy as np
import pytest
from scene_parts import fixed, free, line_of, system
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

import dropper_jax as dj
from dropper_jax.effects.clamp_motion import rotate

LENGTH = 10.0  # [m]
EI = 200.0  # [N m^2]
PER_METRE = 1.0  # [kg/m]
TURN = 0.01  # [rad]
SHAKE = 0.03  # [m]
RATE = 0.8  # [rad/s]
TIME = np.linspace(0.0, 8.0, 161)


def angle(t):
    return 0.5 * TURN * (1.0 - np.cos(RATE * t))


def shift(t):
    return 0.5 * SHAKE * (1.0 - np.cos(RATE * t))


def scene(links=24, **clamp):
    """A rod along x without weight, clamped at a wall that moves along z and turns about y."""
    directions = np.stack([np.cos(angle(TIME)), 0.0 * TIME, np.sin(angle(TIME))], axis=1)
    moves = np.stack([0.0 * TIME, 0.0 * TIME, shift(TIME)], axis=1)
    wall = {"point": "wall", "time": TIME.tolist()}
    effects = {"bending": {"EI": EI}, "end_motion": {**wall, "displacement": moves.tolist()}}
    clamp = {**wall, "direction": directions.tolist(), **clamp}
    effects["clamp_motion"] = {key: value for key, value in clamp.items() if value is not None}
    return system(
        [fixed("wall", 0.0, 0.0, 0.0), free("tip", LENGTH, 0.0, 0.0)],
        [line_of("rod", "wall", "tip", links, LENGTH, type="rod")],
        duration=8.0,
        line_type=[{"name": "rod", "mass": PER_METRE, "diameter": 0.02, "EA": 1e6, "law": "elastic"}],
        effects=effects,
        start={"kind": "points"},
    )


def tip_by_modes(times):
    """Height (k,) [m] of the tip by four modes of a cantilever in the frame of the wall, integrated by SciPy."""
    height = 0.0
    for x in (1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349):
        s = (np.cosh(x) + np.cos(x)) / (np.sinh(x) + np.sin(x))

        def mode(z, x=x, s=s):
            return np.cosh(x * z) - np.cos(x * z) - s * (np.sinh(x * z) - np.sin(x * z))

        size = quad(lambda z: mode(z) ** 2, 0.0, 1.0)[0]
        by_shift = quad(mode, 0.0, 1.0)[0] / size
        by_turn = LENGTH * quad(lambda z: z * mode(z), 0.0, 1.0)[0] / size
        stiffness = (x / LENGTH) ** 4 * EI / PER_METRE
        push = 0.5 * RATE**2 * (SHAKE * by_shift + TURN * by_turn)

        def slope(t, y, stiffness=stiffness, push=push):
            return [y[1], -stiffness * y[0] - push * np.cos(RATE * t)]

        found = solve_ivp(slope, (0.0, times[-1]), [0.0, 0.0], t_eval=times, rtol=1e-9, atol=1e-12).y[0]
        height = height + mode(1.0) * found
    return shift(times) + LENGTH * angle(times) + height


@pytest.fixture(scope="module")
def shaken():
    return dj.simulate(scene())


@pytest.mark.check
def test_a_cantilever_that_is_shaken_and_turned_follows_its_modes(shaken):
    assert shaken.status == "ok", shaken.failure
    exact = tip_by_modes(shaken.t)
    assert np.max(np.abs(shaken.positions[:, -1, 2] - exact)) < 4e-3 * np.max(np.abs(exact))


@pytest.mark.check
def test_its_moment_at_the_wall_is_that_of_the_bent_rod(shaken):
    """The moment of the inertia of the whole rod about the wall, from the heights of its nodes."""
    every = 10
    at = slice(every, None, every)
    t, z = shaken.t, shaken.positions[:, :, 2]
    acceleration = (z[2 * every :: every] - 2.0 * z[every:-every:every] + z[: -2 * every : every]) / (every * 0.01) ** 2
    mass = PER_METRE * LENGTH / 24 * np.array([*np.ones(24), 0.5])
    arm = np.linspace(0.0, LENGTH, 25)
    exact = np.abs(acceleration @ (mass * arm))
    found = shaken.bending_moment[at, 0][: len(exact)]
    assert t[at][0] == pytest.approx(0.1)
    assert np.max(np.abs(found - exact)) < 5e-3 * np.max(exact)


@pytest.mark.check
def test_the_work_of_the_clamp_closes_the_balance(shaken):
    names = list(shaken.work_names)
    done = np.abs(shaken.work[:, names.index("clamp_motion")])
    assert np.max(done) > 0.1 * shaken.energy_scale
    assert shaken.energy_drift < 1e-8 * shaken.energy_scale


def test_quaternions_that_are_rounded_turn_a_vector_as_those_of_scipy():
    rows = np.random.default_rng(2).normal(size=(50, 4))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    turned = Rotation.from_quat(rows, scalar_first=True).apply([0.6, 0.0, 0.8])
    np.testing.assert_allclose(rotate(jnp.asarray(1.0009 * rows), jnp.array([3.0, 0.0, 4.0])), turned, atol=1e-12)


@pytest.mark.check
def test_quaternions_turn_the_line_as_directions_do():
    half = 0.5 * angle(TIME)
    rows = np.stack([np.cos(half), 0.0 * half, -np.sin(half), 0.0 * half], axis=1)
    by_direction = dj.simulate(scene(links=4), duration=1.0)
    turned = {"direction": None, "quaternion": rows.ravel().tolist(), "along": [1.0, 0.0, 0.0]}
    by_quaternion = dj.simulate(scene(links=4, **turned), duration=1.0)
    np.testing.assert_allclose(by_quaternion.positions, by_direction.positions, atol=1e-12)


def test_at_rest_the_line_has_the_direction_of_the_clamp():
    model, _ = dj.build(scene(links=6))
    pose = dj.equilibrium(model, t=4.0)
    assert pose.status == "ok", pose.message
    line = np.asarray(pose.positions[-1] - pose.positions[0])
    np.testing.assert_allclose(line, LENGTH * np.array([np.cos(angle(4.0)), 0.0, np.sin(angle(4.0))]), atol=1e-6)


@pytest.mark.parametrize(
    ("clamp", "message"),
    [
        ({"point": "tip"}, "clamp_motion.point: 'tip' is not a fixed point"),
        ({"time": [0.0, 0.0]}, "clamp_motion.time: needs at least 2 increasing times"),
        ({"direction": [[1.0, 0.0, 0.0]]}, "direction: has 1 rows; allowed: 2"),
        ({"direction": [[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]}, "direction.1: has the length 2; allowed: 1"),
        (
            {"direction": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]},
            "direction.1: jumps by 90 degrees from the row before; allowed: 60",
        ),
        ({"quaternion": [1.0, 0.0, 0.0, 0.0]}, "give either `direction`, or `quaternion` and `along`"),
        (
            {"direction": None, "quaternion": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], "along": [1.0, 0.0, 0.0]},
            "quaternion: has 7 numbers; allowed: 4 per time",
        ),
    ],
)
def test_what_a_clamp_cannot_do_is_refused(clamp, message, refusal):
    printed = refusal(dj.load_scene, scene(**{"time": [0.0, 1.0], **clamp}))
    assert printed.startswith("effects.clamp_motion")
    assert message in printed


@pytest.mark.parametrize(("name", "needed"), [("clamp_motion", "bending"), ("seabed_friction", "seabed")])
def test_an_effect_without_the_one_that_it_needs_is_refused(name, needed, refusal):
    table = scene()
    values = {"clamp_motion": table["effects"].pop("clamp_motion"), "seabed_friction": {"kinetic": 0.5}}
    table["effects"] = {name: values[name]}
    assert refusal(dj.load_scene, table) == f"effects.{name}: needs [effects.{needed}]; it is missing"
