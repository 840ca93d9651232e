"""Friction in the joints: closed-form losses and decays, energy that never rises, joints that hold."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import rods

import dropper_jax as dj
from dropper_jax.integrators.stop_stuck import stop_stuck_joints

G = 9.81


def swings(angle):
    """Turning angles of whole half swings, from parabolas through the extreme samples between zero crossings.

    Dry friction may hold a link for one step where it turns, so that two extreme samples are equal.
    """
    crossings = np.flatnonzero(angle[:-1] * angle[1:] < 0)
    at = np.array([a + 1 + np.argmax(np.abs(angle[a + 1 : b])) for a, b in itertools.pairwise(crossings)])
    low, top, high = (angle[at + shift] for shift in (-1, 0, 1))
    return top - (high - low) ** 2 / (8 * (high - 2 * top + low))


def test_each_swing_of_a_dry_pendulum_loses_the_friction_torque_times_its_arc():
    """m g L (cos a1 - cos a0) = tau (a0 + a1) for turning angles a0 > a1 > 0 on both sides."""
    length, mass, tau, a0 = 0.5, 0.4, 0.05, 1.2
    solution = dj.simulate(rods([a0], length, mass, {"joint_friction": {"dry": tau}}), dt=0.001, duration=5.0)
    assert solution.status == "ok"
    link = solution.positions[:, 1]
    found = np.abs(swings(np.arctan2(link[:, 0], -link[:, 2])))
    assert len(found) >= 6
    before = np.concatenate([[a0], found[:-1]])
    loss = mass * G * length * (np.cos(found) - np.cos(before))
    np.testing.assert_allclose(loss, tau * (before + found), rtol=1e-4)


def test_small_dry_swings_decay_linearly_and_then_stop():
    """a falls by 2 tau/(m g L) each swing while it is above the band +-tau/(m g L), where the link stays."""
    length, mass, tau, a0 = 0.5, 0.4, 2e-4, 2e-3
    band = tau / (mass * G * length)
    solution = dj.simulate(rods([a0], length, mass, {"joint_friction": {"dry": tau}}), dt=0.002, duration=25.0)
    angle = np.arctan2(solution.positions[:, 1, 0], -solution.positions[:, 1, 2])
    found = np.abs(swings(angle))
    np.testing.assert_allclose(found[:5], a0 - 2 * band * np.arange(1, 6), rtol=1e-4)
    assert abs(angle[-1]) <= band
    assert np.ptp(angle[-1000:]) == 0.0


@pytest.mark.check
def test_a_stuck_link_creeps_by_nothing_in_300_seconds():
    """Held at an angle where its weight asks for 0.9 of the limit."""
    length, mass, a = 0.5, 0.4, 0.3
    tau = mass * G * length * np.sin(a) / 0.9
    scene = rods([a], length, mass, {"joint_friction": {"dry": float(tau)}})
    solution = dj.simulate(scene, dt=0.02, duration=300.0, save_every=10)
    assert solution.status == "ok"
    link = solution.positions[:, 1]
    assert np.max(np.abs(np.arctan2(link[:, 0], -link[:, 2]) - a)) < 1e-12
    assert np.max(np.abs(solution.velocities)) < 1e-12


def test_viscous_joint_of_one_link_decays_as_the_closed_form(march):
    """m L^2 a'' = -c a' - m g L a for small a."""
    length, mass, c, a0, t = 0.5, 0.4, 0.03, 1e-4, 2.0
    model, s = dj.build(rods([a0], length, mass, {"joint_friction": {"viscous": c}}))
    link = march(dj.make_stepper(model, halvings=0), model, s, t, 8192)[0][-1, 0]
    rate = c / (2 * mass * length**2)
    w = np.sqrt(G / length - rate**2)
    expected = a0 * np.exp(-rate * t) * (np.cos(w * t) + rate / w * np.sin(w * t))
    assert np.arctan2(link[0], -link[2]) == pytest.approx(expected, abs=2e-6 * a0)


def test_viscous_joints_of_two_links_follow_the_linear_equations_of_small_angles(march):
    """M a'' + C a' + K a = 0, the second joint acts on the difference of the rates; solved by eigenvalues."""
    length, mass, c, a0, t = np.array([0.5, 0.3]), np.array([0.4, 0.2]), [0.03, 0.01, 0.0], 1e-4, 1.0
    both, between = mass.sum(), mass[1] * length.prod()
    m = np.array([[both * length[0] ** 2, between], [between, mass[1] * length[1] ** 2]])
    damping = np.array([[c[0] + c[1], -c[1]], [-c[1], c[1]]])
    k = G * np.diag([both * length[0], mass[1] * length[1]])
    inverse = np.linalg.inv(m)
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ k, -inverse @ damping]])
    values, vectors = np.linalg.eig(system)
    y = (vectors * np.exp(values * t)) @ np.linalg.solve(vectors, [a0, -a0, 0, 0])
    effects = {"joint_friction": {"viscous": c}}
    model, s = dj.build(rods([a0, -a0], length.tolist(), mass.tolist(), effects))
    r = march(dj.make_stepper(model, halvings=0), model, s, t, 8192)[0][-1]
    d = np.diff(np.vstack([np.zeros(3), r]), axis=0)
    np.testing.assert_allclose(np.arctan2(d[:, 0], -d[:, 2]), y[:2].real, atol=1e-5 * a0)


@pytest.mark.check
@pytest.mark.parametrize(
    ("scene", "dry", "duration", "settings"),
    [
        ("dropper-release-a-undamped", 2e-5, 4.0, {}),
        ("string", 2e-5, 4.0, {}),
        ("dropper-release-a-undamped", 2e-3, 6.0, {"halvings": 2}),
    ],
    ids=["in the plane", "in space", "real bearings"],
)
def test_dry_friction_never_raises_the_energy(scene, dry, duration, settings):
    """With the friction of real bearings all 8 joints of the loop, of 5 motions, end up held, and creep by nothing."""
    scene = dj.load_scene(scene).with_values({"effects.joint_friction.dry": dry})
    solution = dj.simulate(scene, dt=0.01, duration=duration, **settings)
    assert solution.status == "ok"
    assert np.max(np.diff(solution.energy)) < 1e-12
    assert np.max(np.diff(solution.work, axis=0)) < 1e-12
    assert solution.energy_drift < 1e-9
    assert solution.energy[-1] < solution.energy[0] - 10 * dry
    if dry == 2e-3:
        assert np.max(np.ptp(solution.positions[-100:], axis=0)) < 1e-14


def test_pins_count_only_the_turn_about_their_axis():
    """A link that turns about the vertical at a constant rate and opening feels no horizontal pin across its path."""
    a, length = 0.5, 0.4
    rate = np.sqrt(G / (length * np.cos(a)))
    effects = {"joint_friction": {"viscous": 0.05, "axis": [0.0, 0.0, 1.0]}}
    model, s = dj.build(rods([a], length, 0.3, effects, azimuth_rate=[float(rate)]))
    k = model.kinematics(s.r, s.v, s.t)
    moment = np.cross(s.r[0], model.effect("joint_friction").force(k)[0])
    about = rate * np.sin(a) ** 2  # vertical part of the angular velocity of the link without spin
    assert moment[2] == pytest.approx(-0.05 * about * np.sin(a) ** 2, rel=1e-9)
    _, s = dj.build(rods([a], length, 0.3, effects, polar_rate=[2.0]))
    k = model.kinematics(s.r, s.v, s.t)
    np.testing.assert_allclose(model.effect("joint_friction").force(k), 0.0, atol=1e-15)


@pytest.mark.check
def test_derivatives_with_dry_friction_are_those_of_the_sliding_motion(slopes_of):
    """While a link slides, forward, reverse and differences agree in the limit torque."""
    model, s = dj.build(rods([0.9], 0.5, 0.4, {"joint_friction": {"dry": 0.01}}))
    stepper = dj.make_stepper(model, halvings=0, track_work=False, iterations=8)
    weight, friction = model.effects

    def end(tau):
        changed = replace(model, effects=(weight, replace(friction, dry=tau)))
        return dj.integrate(stepper, changed, s, 0.005, 40)[0].r[-1, 0]

    slopes_of(end, jnp.asarray(0.01), 1e-6, rel=1e-5)


def test_joints_stopped_on_their_bounds_are_solved_with_any_rounding():
    """Two joints at rest in the middle of a step, hit by random rates at its end: |h z + P| <= h tau, less energy."""
    h, tau, z = 0.01, 0.2, np.array([0.15, -0.1])
    effects = {"joint_friction": {"dry": tau, "axis": [0.0, 1.0, 0.0]}}
    model, s = dj.build(rods([0.6, 0.2], effects=effects))
    middle = model.kinematics(s.r, jnp.zeros_like(s.v), s.t)
    link = np.diff(np.vstack([np.zeros(3), s.r]), axis=0)
    rates = np.random.default_rng(1).normal(size=(500, 2, 1)) * 0.01
    before = np.cumsum(np.cross([0.0, 1.0, 0.0], link) * rates, axis=1)

    def stop(v):
        return stop_stuck_joints(model, (jnp.asarray(z)[:, None],), middle, model.kinematics(s.r, v, s.t), h)

    after, work = jax.jit(jax.vmap(stop))(before)
    assert np.all(np.isfinite(after))
    lost = 0.5 * np.sum(np.square(before) - np.square(after), axis=(1, 2))
    np.testing.assert_allclose(lost, -work, atol=1e-15)
    assert np.all(work <= 0.0)
    # impulses from the change of angular momentum: of the outer mass about the second joint, of both about the first
    change = np.asarray(after) - before
    second = np.cross(link[1], change[:, 1])[:, 1]
    impulse = np.stack([np.cross(link[0], change.sum(1))[:, 1] + second, second], axis=1)
    assert np.all(np.abs(h * z + impulse) <= h * tau * (1 + 1e-9))
    assert np.mean(np.abs(h * z + impulse) > h * tau * (1 - 1e-9)) > 0.1


def test_a_composition_that_steps_backwards_refuses_dry_friction():
    """Its middle step would turn friction into a drive: it lost 2.3 times what `energy_momentum` does."""
    dry, viscous = (dj.build(rods([0.9], effects={"joint_friction": {kind: 0.1}}))[0] for kind in ("dry", "viscous"))
    with pytest.raises(ValueError, match=r"energy_momentum_4.*'joint_friction' has a set-valued law"):
        dj.make_stepper(dry, "energy_momentum_4")
    assert dj.make_stepper(viscous, "energy_momentum_4").integrator.order == 4


def test_friction_in_joints_of_links_that_break_is_refused(refusal):
    scene = rods([0.9, 0.8], effects={"joint_friction": {"dry": 0.1}})
    line = {**scene["line"][0], "axial": {"law": "elastic", "EA": 1e4}}
    failure = [{"line": line["name"], "link": 1, "time": 1.0}]
    message = refusal(dj.load_scene, {**scene, "line": [line], "failure": failure})
    assert message.startswith("effects.joint_friction: would pass torques through links that [[failure]] breaks")
