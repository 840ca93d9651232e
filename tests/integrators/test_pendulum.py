"""One link against closed forms: the conical pendulum's circle, periods from elliptic integrals, decay, free fall."""

import numpy as np
import pytest
from scipy.special import ellipk

import dropper_jax as dj

G = 9.81


def angles(polar, rate=0.0, azimuth_rate=0.0):
    return {
        "kind": "angles",
        "zero": "down",
        "polar": [polar],
        "polar_rate": [rate],
        "azimuth_rate": [azimuth_rate],
    }


def period(length, amplitude):
    """4 sqrt(L/g) K(sin^2(a/2)) [s]."""
    return 4 * np.sqrt(length / G) * ellipk(np.sin(amplitude / 2) ** 2)


@pytest.fixture
def swing(march):
    """`swing(scene, duration, steps)`: the angle of the link from the vertical at the end, and its tension."""

    def find(scene, duration, steps, integrator="energy_momentum"):
        model, s = dj.build(scene)
        r, _, tension = march(dj.make_stepper(model, integrator).plain, model, s, duration, steps)
        return np.arctan2(r[-1, -1, 0], -r[-1, -1, 2]), tension[-1, 0]

    return find


@pytest.fixture
def period_error(swing):
    """Relative error of the period, from the angle that is left when the link should pass straight down.

    After 2 1/4 periods the link is at the bottom with rate 2 sqrt(g/L) sin(a/2).
    """

    def find(scene, reduced, amplitude, **choice):
        exact = period(reduced, amplitude)
        left, _ = swing(scene, 2.25 * exact, 16384, **choice)
        rate = 2 * np.sqrt(G / reduced) * np.sin(amplitude / 2)
        return abs(left) / rate / (2.25 * exact)

    return find


def circle_error(solution):
    radius = np.linalg.norm(solution.positions[:, 1, :2], axis=-1)
    height = np.max(np.abs(solution.positions[:, 1, 2] + np.sin(np.pi / 8)))
    return max(np.max(np.abs(radius - np.cos(np.pi / 8))), height)


def test_conical_pendulum_with_the_right_rate_keeps_its_circle_for_40_seconds():
    solution = dj.simulate("conical-pendulum")
    assert solution.status == "ok"
    assert solution.t[-1] == pytest.approx(40.0)
    assert circle_error(solution) < 1e-9


def test_rattle_keeps_the_circle_at_the_rate_that_its_own_difference_equations_ask_for():
    """A steady turn by a per step: v_h = 2 R sin(a/2)/h, 4 R sin^2(a/2)/h^2 = w^2 R, v = R sin(a)/h.

    So v = R w sqrt(1 - (h w/2)^2), below the exact rate w by its second-order error.
    """
    h, rate = 0.01, np.sqrt(G / np.sin(np.pi / 8))
    own = rate * np.sqrt(1 - (h * rate / 2) ** 2)
    scene = dj.load_scene("conical-pendulum").with_values({"start.azimuth_rate": [own]})
    assert circle_error(dj.simulate(scene, integrator="rattle", dt=h)) < 1e-9


def test_the_rate_printed_in_the_thesis_is_no_circle():
    rate = np.sqrt(G * np.cos(np.pi / 8))
    scene = dj.load_scene("conical-pendulum").with_values({"start.azimuth_rate": [rate]})
    radius = np.linalg.norm(dj.simulate(scene, duration=5.0).positions[:, 1, :2], axis=-1)
    assert np.ptp(radius) > 0.1


@pytest.mark.parametrize("amplitude", [1e-3, 0.1, 1.5, 2.8])
@pytest.mark.parametrize("integrator", ["energy_momentum", "rattle"])
def test_period_of_a_pendulum_is_the_elliptic_integral(period_error, chain, integrator, amplitude):
    scene = chain([0.7], [0.3], angles(amplitude))
    assert period_error(scene, 0.7, amplitude, integrator=integrator) < 1e-6


def test_compound_pendulum_swings_like_a_simple_one_of_length_second_moment_over_static_moment(period_error, chain):
    y, inertia, mass = 0.106, 8e-5, 0.033
    scene = chain([0.15], [mass], angles(1.2), centre_of_mass=y, inertia=inertia)
    reduced = (inertia + mass * y**2) / (mass * y)
    assert period_error(scene, reduced, 1.2) < 1e-6


def test_weight_in_water_sets_the_period_not_the_weight_in_air(swing, chain):
    """w/m takes the place of g."""
    scene = chain([0.7], [0.3], angles(0.8), effects={"weight": {"wet_weight": 0.3 * G / 4}})
    left, _ = swing(scene, 2 * 2.25 * period(0.7, 0.8), 16384)
    assert 0.7 * abs(left) < 1e-5


def test_small_swings_with_linear_damping_decay_as_the_closed_form(swing, chain):
    """theta = a exp(-c t) (cos w t + c/w sin w t), c = b/(2 m), w^2 = g/L - c^2; cubic terms are of size a^2."""
    mass, length, b, amplitude, t = 0.5, 0.8, 0.3, 1e-4, 3.0
    scene = chain([length], [mass], angles(amplitude), effects={"weight": {}, "linear_damping": {"b_l": b}})
    c = b / (2 * mass)
    w = np.sqrt(G / length - c**2)
    expected = amplitude * np.exp(-c * t) * (np.cos(w * t) + c / w * np.sin(w * t))
    assert swing(scene, t, 8192)[0] == pytest.approx(expected, abs=1e-6 * amplitude)


def test_without_any_force_a_link_turns_at_a_constant_rate(swing, chain):
    scene = chain([0.6], [0.2], angles(0.3, rate=2.0), effects={})
    angle, tension = swing(scene, 1.0, 4096)
    assert angle == pytest.approx(2.3, abs=1e-6)
    assert tension == pytest.approx(0.2 * 0.6 * 2.0**2, rel=1e-6)
