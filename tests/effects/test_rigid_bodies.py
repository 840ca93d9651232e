"""Rigid bodies: free rotation against Euler's equations, an arm against a compound pendulum, what scenes refuse."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import by_a_rope, swing_period
from scene_parts import fixed, line_of, system
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

import dropper_jax as dj
from dropper_jax import build, build_model, make_stepper
from dropper_jax.load.system_warnings import body_warnings

INERTIA, RATES = (1.0, 2.0, 3.0), (0.3, 1.0, 0.2)


def stone(dt=0.01, duration=60.0, **changed):
    """A body that nothing touches, beside a rope."""
    body = {"name": "stone", "position": [0.0, 0.0, 0.0], "velocity": [0.1, 0.0, 0.0], "angular_velocity": list(RATES)}
    body |= {"mass": 10.0, "centre_of_mass": [0.1, 0.2, -0.3], "inertia": list(INERTIA)}
    run = {"dt": dt, "duration": duration, "save_every": round(0.5 / dt)}
    return by_a_rope({**body, **changed}, run=run, effects={"weight": {"gravity": 0.0}})


def euler(times):
    """Attitude by Euler's equations `I w' = (I w) x w` and the quaternion's rate."""
    inertia = np.array(INERTIA)

    def rates(_, y):
        w, v, s = y[:3], y[3:6], y[6]
        turned = np.concatenate([0.5 * (s * w + np.cross(v, w)), [-0.5 * v @ w]])
        return np.concatenate([np.cross(inertia * w, w) / inertia, turned])

    start = np.concatenate([RATES, [0.0, 0.0, 0.0, 1.0]])
    y = solve_ivp(rates, (0.0, times[-1]), start, method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times).y
    return Rotation.from_quat(y[3:].T)


def attitude_error(solution):
    found = Rotation.from_euler("ZYX", solution.body("stone")["body_attitude"][:, ::-1])
    return np.max((found.inv() * euler(solution.t)).magnitude())


@pytest.fixture(scope="module")
def tumbling():
    return dj.simulate(stone())


def test_free_body_tumbles_as_eulers_equations_say_and_keeps_its_energy(tumbling):
    assert tumbling.status == "ok"
    assert tumbling.energy_drift < 1e-9 * tumbling.kinetic[0]
    assert tumbling.kinetic[0] == pytest.approx(0.5 * np.dot(INERTIA, np.square(RATES)) + 0.5 * 10.0 * 0.1**2)
    assert attitude_error(tumbling) < 2e-3


@pytest.mark.check
def test_attitude_converges_with_second_order(tumbling):
    halved = dj.simulate(stone(dt=0.02))
    assert np.log2(attitude_error(halved) / attitude_error(tumbling)) == pytest.approx(2.0, abs=0.05)


def test_momentum_of_a_free_body_stays(tumbling):
    moved = tumbling.body("stone")
    axes = Rotation.from_euler("ZYX", moved["body_attitude"][:, ::-1])
    own = axes.inv().apply(moved["body_rates"])
    turning = axes.apply(np.array(INERTIA) * own)
    np.testing.assert_allclose(turning, turning[:1] * np.ones_like(turning), atol=3e-4)
    arm = axes.apply([0.1, 0.2, -0.3])
    drift = moved["body_position"] + arm - tumbling.t[:, None] * np.array([0.1, 0.0, 0.0])
    np.testing.assert_allclose(drift, drift[:1] * np.ones_like(drift), atol=1e-8)


@pytest.mark.check
def test_arm_on_a_short_rope_swings_as_a_compound_pendulum():
    """On a rope of 1e-3 of the arm's length the arm turns about its end: `T = 4 K(sin(a/2)) sqrt(J/(m g l))`."""
    arm, mass, moment, angle = 2.0, 5.0, 3.0, 0.6
    body = {"name": "stone", "position": [0.0, 0.0, -0.002], "attitude": [0.0, angle, 0.0]}
    body |= {"mass": mass, "centre_of_mass": [0.0, 0.0, -arm], "inertia": [moment, moment, 0.1]}
    body["attachments"] = {"top": [0.0, 0.0, 0.0]}
    rope = line_of("rope", "hook", "top", 1, 0.002, mass=1e-3, diameter=0.02, axial={"law": "rope", "EA": 1e4})
    scene = system([fixed("hook", 0.0, 0.0, 0.0)], [rope], dt=0.005, duration=12.0, body=[body])
    solution = dj.simulate(scene | {"start": {"kind": "points"}})
    pitch = solution.body("stone")["body_attitude"][:, 1]
    expected = 4.0 * ellipk(np.sin(angle / 2) ** 2) * np.sqrt((moment + mass * arm**2) / (mass * 9.81 * arm))
    assert solution.status == "ok"
    assert swing_period(solution.t, pitch) == pytest.approx(expected, rel=3e-3)
    assert solution.energy_drift < 1e-6 * solution.energy_scale


@pytest.mark.check
def test_gradient_of_a_tumbling_body_against_differences(slopes_of):
    model, start = build(stone(duration=0.5))
    stepper = make_stepper(model).plain
    bodies = model.effect("rigid_bodies")

    def turned(given):
        mass, moments = given
        changed = tuple(replace(e, mass=mass, moments=moments) if e.name == bodies.name else e for e in model.effects)
        _, run = dj.integrate(stepper, replace(model, effects=changed), start, dt=0.02, steps=20)
        return jnp.sum(run.r[-1] * jnp.arange(run.r[-1].size).reshape(run.r[-1].shape))

    slopes_of(turned, (bodies.mass, bodies.moments), floor=1.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mass": -1.0}, "body.0.mass: -1.0 is out of range"),
        ({"inertia": [1.0, 2.0, 4.0]}, "not those of a body"),
        ({"inertia": [1.0, 2.0]}, "has 2 entries"),
        ({"attachments": {"a": [0.0, 0.0, 0.0]}}, "attachments.a: is also a"),
        ({"masss": 1.0}, "unknown key"),
    ],
)
def test_scene_refuses(changed, message, refusal):
    assert message in refusal(dj.load_scene, stone(**changed))


def test_an_attachment_on_an_arm_outside_the_hull_is_a_warning():
    scene = dj.load_scene("ballasted-spar")
    assert not list(body_warnings(scene))
    arm = scene.with_values({"body.0.attachments.base": [42.0, 0.0, 0.0]})
    (text,) = body_warnings(arm)
    assert "1 attachments are outside its cylinders and spheres, 'base' by 41.5 m" in text
    model, s = dj.build(arm.with_values({"start.kind": "points"}))
    # the point sits 42 m from the body's axis
    np.testing.assert_allclose(model.constraints[0].gap(model, s.r), 0.0, atol=1e-9)


def test_nodes_of_bodies_are_not_taken_for_times_at_which_an_effect_is_not_smooth():
    model = build_model(dj.load_scene("ballasted-spar"))
    ramp = float(dj.load_scene("ballasted-spar").sea.ramp)
    assert sorted(model.corners.tolist()) == [0.0, ramp]  # when the waves begin and are full
