"""Pinned bodies and friction of bodies on the bed: closed forms, the network's matrix against the dense one."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import by_a_rope, swing_period
from scene_parts import fixed, free, line_of, system
from scipy.special import ellipk

import dropper_jax as dj
from dropper_jax import SceneError, build, build_model, make_stepper, natural_modes
from dropper_jax.effects.body_bed import BodyBedFriction
from dropper_jax.statics import equilibrium

G, RHO, DEPTH = 9.81, 1025.0, 20.0
ARM, MASS, MOMENT = 2.0, 5.0, 3.0


def pendulum(angle=0.6, dt=0.005, duration=12.0, **more):
    """An arm that hangs from a pin, far from a rope."""
    body = {"name": "arm", "position": [1.0, 2.0, 3.0], "attitude": [0.0, angle, 0.0], "pinned": True}
    body |= {"mass": MASS, "centre_of_mass": [0.0, 0.0, -ARM], "inertia": [MOMENT, MOMENT, 0.1]}
    return by_a_rope({**body, **more}, run={"dt": dt, "duration": duration})


@pytest.mark.check
def test_a_pinned_arm_swings_as_a_compound_pendulum_about_its_pin():
    angle = 0.6
    solution = dj.simulate(pendulum(angle))
    pitch = solution.body("arm")["body_attitude"][:, 1]
    expected = 4.0 * ellipk(np.sin(angle / 2) ** 2) * np.sqrt((MOMENT + MASS * ARM**2) / (MASS * G * ARM))
    assert solution.status == "ok"
    assert swing_period(solution.t, pitch) == pytest.approx(expected, rel=1e-4)
    assert solution.energy_drift < 1e-9 * solution.energy_scale
    np.testing.assert_allclose(solution.body("arm")["body_position"], [[1.0, 2.0, 3.0]] * len(solution.t), atol=1e-9)


@pytest.mark.check
def test_a_pinned_body_hangs_below_its_pin_and_has_three_modes_of_the_closed_form():
    model = build_model(dj.load_scene(pendulum(0.5) | {"start": {"kind": "static"}}))
    pose = equilibrium(model)
    assert pose.status == "ok", pose.message
    found = dj.simulate(pendulum(0.5, duration=0.01) | {"start": {"kind": "static"}})
    np.testing.assert_allclose(found.body("arm")["body_attitude"][0, :2], 0.0, atol=1e-7)
    modes = natural_modes(model, pose.state, 30)
    period = 2 * np.pi * np.sqrt((MOMENT + MASS * ARM**2) / (MASS * G * ARM))
    turning = np.abs(modes.bodies[:, 0, 3:5]).max(axis=1) > 0.1
    np.testing.assert_allclose(modes.period[turning], [period, period], rtol=1e-6)


def test_a_body_that_starts_to_turn_has_the_velocity_of_its_rotation():
    solution = dj.simulate(pendulum(0.0, duration=0.02, angular_velocity=[0.3, 0.0, 0.0]))
    assert solution.kinetic[0] == pytest.approx(0.5 * (MOMENT + MASS * ARM**2) * 0.3**2, rel=1e-9)


def moored(bodies=2):
    """Two bodies, one pinned, between lines that bend, touch a body and each other."""
    body = {"mass": 50.0, "centre_of_mass": [0.0, 0.0, -0.2], "inertia": [9.0, 8.0, 7.0]}
    one = {"name": "one", "position": [3.0, 0.2, -4.7], "attachments": {"top": [0.0, 0.0, 0.4]}, **body}
    two = {"name": "two", "position": [5.0, 0.0, -7.0], "attachments": {"on": [0.0, 0.1, 0.3]}, **body}
    ends = {"left": ("a", "b", 5.2), "right": ("b", "c", 4.5), "down": ("b", "on", 2.8), "up": ("top", "c", 6.5)}
    contact = {"pairs": [["left", "up"]], "bodies": [["left", "one"]], "damping": 5.0, "stiffness": 1e4}
    return system(
        [fixed("a", 0.0, 0.0, -4.0), free("b", 5.0, 0.0, -4.2, mass=2.0), fixed("c", 9.0, 0.5, -4.0)],
        [line_of(name, start, end, 2, length, type="rod") for name, (start, end, length) in ends.items()],
        line_type=[{"name": "rod", "mass": 1.0, "diameter": 0.1, "EI": 50.0, "EA": 1e5}],
        body=[one | {"spheres": [{"centre": [0.0, 0.0, 0.0], "diameter": 1.0}]}, two | {"pinned": True}],
        sea={"depth": 30.0},
        effects={"weight": {}, "bending": {}, "line_contact": contact},
        start={"kind": "points"},
    )


@pytest.mark.check
def test_the_network_holds_bodies_with_bending_contact_and_pins_exactly(network_is_exact):
    """Corners and lines do touch: there are entries between them beside those of the seats."""
    model, s = build(moored())
    assert make_stepper(model).solver_name == "network"
    network_is_exact(model, s, 0.02, within=3e-7)


def drum(friction, velocity, attitude=(0.0, 0.0, 0.0), duration=3.0, dt=0.005, ball=False, **more):
    """A drum of 1 m and 2 m along x, or a ball, that lies on the bed and slides; water neither drags nor is added."""
    if ball:
        volume, area, inertia = np.pi / 6, np.pi / 4, [300.0] * 3
        shape = {"spheres": [{"centre": [0.0, 0.0, 0.0], "diameter": 1.0, "cd": 0.0, "ca": 0.0}]}
    else:
        volume, area, inertia = np.pi / 2, 2.0, [400.0, 1200.0, 1200.0]
        none = {"cdn": 0.0, "can": 0.0, "ends": "none"}
        shape = {"cylinders": [{"from": [-1.0, 0, 0], "to": [1.0, 0, 0], "diameter": 1.0, "slices": 4, **none}]}
    weight = G * (3000.0 - RHO * volume)
    body = {"name": "drum", "position": [0.0, 0.0, -DEPTH + 0.5 - weight / (1e6 * area)], "attitude": list(attitude)}
    body |= {"mass": 3000.0, "centre_of_mass": [0.0, 0.0, 0.0], "inertia": inertia, **shape}
    body |= {"touches_bed": True, "bed_friction": friction, "velocity": list(velocity)}
    effects = {"weight": {"gravity": G}, "seabed": {"stiffness": 1e6, "damping": 1e5}}
    run, sea = {"dt": dt, "duration": duration}, {"depth": DEPTH, "density": RHO}
    return by_a_rope({**body, **more}, run=run, sea=sea, effects=effects), weight


@pytest.mark.check
def test_a_drum_that_slides_stops_after_the_way_of_dry_friction():
    friction, speed = 0.4, 1.0
    scene, weight = drum(friction, [speed, 0.0, 0.0], duration=1.2)
    ran = dj.simulate(scene)
    assert ran.status == "ok"
    way = speed**2 / (2 * friction * weight / 3000.0)
    assert ran.body_position[-1, 0, 0] == pytest.approx(way, rel=0.01)  # it pitches as it brakes, by 2 mm at its middle
    late = ran.body_position[ran.t > 1.0, 0, 0]
    assert np.ptp(late) < 1e-4  # it lies
    total = ran.kinetic + ran.potential - ran.work.sum(axis=1)
    assert np.ptp(total) < 2e-3 * ran.kinetic[0]
    assert np.all(ran.work[-1, list(ran.work_names).index("body_bed")] < 0.0)


@pytest.mark.check
def test_a_ball_that_slides_ends_rolling_with_the_speed_of_the_textbook():
    # friction turns it until it rolls, m (v0 - v) r = I v/r: v = v0 m r^2/(m r^2 + I)
    scene, _ = drum(0.3, [1.0, 0.0, 0.0], ball=True, duration=1.5)
    ran = dj.simulate(scene)
    rolls = 1.0 * 3000.0 * 0.25 / (3000.0 * 0.25 + 300.0)
    assert ran.body_velocity[-1, 0, 0] == pytest.approx(rolls, rel=5e-3)
    assert ran.body_rates[-1, 0, 1] == pytest.approx(rolls / 0.5, rel=1e-2)
    # and then goes on for ever
    assert np.ptp(ran.body_velocity[-50:, 0, 0]) < 1e-3


def test_friction_of_bodies_dissipates_energy_in_any_motion():
    scene, _ = drum(0.4, [0.3, 0.2, 0.0], attitude=(0.1, 0.05, 0.3))
    model, start = build(scene)
    effect = next(e for e in model.effects if isinstance(e, BodyBedFriction))
    v = start.v + 0.1 * np.random.default_rng(2).normal(size=start.v.shape)
    force = jax.jit(lambda mu: replace(effect, friction=mu).force(model.instant(start.r, v, 0.0)))
    only = force(effect.friction) - force(0.0 * effect.friction)
    assert float(jnp.sum(only * v)) < 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"touches_bed": False}, "body.0.bed_friction: 0.4 of a body that does not touch the seabed"),
        ({"bed_friction": -1.0}, "body.0.bed_friction: -1.* is out of range"),
        ({"pinned": True}, "body.0.velocity: .* of a pinned body, which only rotates"),
    ],
)
def test_what_cannot_be_is_named(changes, words):
    with pytest.raises(SceneError, match=words):
        dj.load_scene(drum(0.4, [1.0, 0.0, 0.0], **changes)[0])


def test_keys_come_back_and_cost_nothing_where_they_are_not():
    kept = dj.load_scene(pendulum())
    assert dj.load_scene(kept.to_dict()) == kept
    plain = dj.load_scene(pendulum(pinned=False)).to_dict()["body"][0]
    assert not {"pinned", "bed_friction", "touches_bed"} & set(plain)
