"""Link angles against closed forms: planar turns, cones, poles, inverses and finite differences."""

import numpy as np
import pytest

from dropper_jax.analysis import angle_rates, angles_to_links, link_angles, phase_curve

ZEROS = ("horizontal", "down")
T = np.linspace(0, 20, 4001)


def nodes_of(links):
    """Nodes (k, n + 1, 3) of link vectors (k, n, 3), the first in the origin."""
    return np.concatenate([np.zeros_like(links[:, :1]), np.cumsum(links, axis=1)], axis=1)


def planar(theta, length=0.15):
    """Links in the x-z plane at angle theta (k, n) from the x axis, positive downwards, written out by hand."""
    return nodes_of(length * np.stack([np.cos(theta), np.zeros_like(theta), -np.sin(theta)], axis=-1))


def cone(opening, azimuth, length=1.0):
    """A link at `opening` from the downward vertical, at azimuths (k,)."""
    opening = np.broadcast_to(opening, azimuth.shape)
    x, y = np.sin(opening) * np.cos(azimuth), np.sin(opening) * np.sin(azimuth)
    return nodes_of(length * np.stack([x, y, -np.cos(opening)], axis=-1)[:, None])  # length: a number or (k, 1, 1)


@pytest.mark.parametrize(
    ("vector", "horizontal", "down"),
    [
        ((1, 0, 0), (0, 0), (np.pi / 2, 0)),
        ((0, 0, -1), (np.pi / 2, 0), (0, 0)),
        ((0, 0, 1), (-np.pi / 2, 0), (np.pi, 0)),
        ((-1, 0, 0), (np.pi, 0), (-np.pi / 2, 0)),
        ((1, 0, -1), (np.pi / 4, 0), (np.pi / 4, 0)),
        ((-1, 0, -1), (3 * np.pi / 4, 0), (-np.pi / 4, 0)),
        ((0, 1, -1), (np.pi / 4, np.pi / 2), (np.pi / 4, np.pi / 2)),
        ((0, -1, -1), (3 * np.pi / 4, np.pi / 2), (-np.pi / 4, np.pi / 2)),
    ],
)
def test_single_links_have_the_angles_of_their_definition(vector, horizontal, down):
    nodes = np.array([[0.3, -0.2, 1.0], np.array([0.3, -0.2, 1.0]) + 0.5 * np.array(vector)])
    for zero, expected in zip(ZEROS, (horizontal, down), strict=True):
        polar, azimuth = link_angles(nodes, zero)
        assert polar.shape == azimuth.shape == (1,)
        np.testing.assert_allclose([polar[0], azimuth[0]], expected, atol=1e-12)


@pytest.mark.parametrize(
    "theta",
    [
        np.stack([np.linspace(0.3, 0.3 + 13.0, 400), np.linspace(-0.2, -0.2 - 21.0, 400)], axis=1),
        0.1 + 3.0 * np.arange(12)[:, None],
        2.0 * np.sin(3 * T)[:, None] + 4.0 * np.sin(0.7 * T + 0.5)[:, None],
    ],
    ids=["full turns", "sampled just below half a turn", "chaotic"],
)
def test_planar_turns_are_continuous_beyond_two_pi_with_zero_azimuth(theta):
    for zero, expected in zip(ZEROS, (theta, np.pi / 2 - theta), strict=True):
        polar, azimuth = link_angles(planar(theta), zero)
        np.testing.assert_allclose(polar, expected, atol=1e-12)
        assert np.all(azimuth == 0)


@pytest.mark.parametrize(
    "opening",
    [[-0.4, -0.2, 0.0, 0.2, 0.4, 0.2, 0.0, -0.2], [0.0, 0.0, 0.0, 0.1, 0.2, 0.0, 0.0]],
    ids=["swinging through it", "at rest at it, then leaving"],
)
def test_link_keeps_its_azimuth_at_the_vertical(opening):
    polar, azimuth = link_angles(cone(opening, np.full(len(opening), 0.7)), "down")
    np.testing.assert_allclose(polar[:, 0], opening, atol=1e-12)
    np.testing.assert_allclose(azimuth[:, 0], 0.7, atol=1e-12)


def test_link_passing_near_the_pole_takes_no_jump_of_half_a_turn():
    x = np.linspace(-0.3, 0.3, 14)  # no sample beside the pole itself
    nodes = nodes_of(np.stack([x, np.full_like(x, 1e-4), -np.sqrt(1 - x**2)], axis=-1)[:, None])
    polar, azimuth = link_angles(nodes, "down")
    assert np.abs(np.diff(polar[:, 0])).max() < 0.2
    away = np.abs(x) > 0.01
    assert np.abs(azimuth[away]).max() < 0.01
    np.testing.assert_allclose(polar[away, 0], np.arcsin(x[away]), atol=1e-4)


@pytest.mark.parametrize("zero", ZEROS)
def test_vertical_and_vanishing_links_never_give_nan(zero):
    vertical = np.zeros((5, 3, 3))
    vertical[:, 1:, 2] = [-1.0, -1.0]
    velocities = np.ones_like(vertical)
    with np.errstate(all="raise"):
        polar, azimuth = link_angles(vertical, zero)
        rates = angle_rates(vertical, velocities, zero)
    assert np.isfinite([polar, azimuth, *rates]).all()
    assert np.all(azimuth == 0)


def test_link_that_vanishes_for_a_sample_keeps_its_angles_and_a_missing_sample_is_nan():
    theta = np.linspace(2.0, 4.0, 9)[:, None]
    gone, missing = planar(theta), planar(theta)
    gone[4, 1] = gone[4, 0]
    missing[4, 1] = np.nan
    np.testing.assert_allclose(link_angles(gone)[0][4], theta[3], atol=1e-12)
    polar, _ = link_angles(missing)
    assert np.isnan(polar[4, 0])
    np.testing.assert_allclose(np.delete(polar, 4), np.delete(theta, 4), atol=1e-12)


def test_samples_of_a_run_that_diverged_are_nan_and_affect_no_other():
    theta = np.linspace(1.0, 2.0, 8)[:, None] + np.array([0.0, 0.3])
    nodes = planar(theta)
    nodes[6] *= 1e200
    nodes[7, 1:] = np.inf
    rates = angle_rates(nodes, np.zeros_like(nodes))
    np.testing.assert_allclose(link_angles(nodes)[0][:7], theta[:7], atol=1e-12)
    assert np.isnan(link_angles(nodes)[0][7]).all()
    assert all(np.all(rate[:6] == 0) for rate in rates)


@pytest.mark.parametrize("rate", [5.0, -5.0])
def test_conical_motion_has_constant_polar_angle_and_linear_azimuth(rate):
    turned = 0.4 + rate * np.linspace(0, 10, 2001)
    polar, azimuth = link_angles(cone(0.6, turned), "down")
    np.testing.assert_allclose(polar[:, 0], 0.6, atol=1e-12)
    np.testing.assert_allclose(azimuth[:, 0], turned, atol=1e-10)


def test_first_azimuth_lies_within_a_quarter_turn_of_x_with_any_noise():
    for azimuth in np.linspace(-np.pi, np.pi, 41):
        first = link_angles(cone(0.6, np.array([azimuth])), "down")[1][0, 0]
        assert -np.pi / 2 < first <= np.pi / 2 + 1e-8
    sideways = cone(0.6, np.array([-np.pi / 2 - 1e-14, -np.pi / 2 + 1e-14]))
    np.testing.assert_allclose(link_angles(sideways, "down")[1], np.pi / 2, atol=1e-12)


@pytest.mark.parametrize("zero", ZEROS)
def test_angles_to_links_inverts_link_angles(zero):
    random = np.random.default_rng(3)
    length = random.uniform(0.1, 2.0, 6)
    unit = random.normal(size=(50, 6, 3))
    links = length[:, None] * unit / np.linalg.norm(unit, axis=-1, keepdims=True)
    polar, azimuth = link_angles(nodes_of(links), zero)
    np.testing.assert_allclose(angles_to_links(polar, azimuth, length, zero), links, atol=1e-12)


@pytest.mark.parametrize("zero", ZEROS)
def test_rates_equal_central_differences_of_the_angles(zero):
    def motion(t):
        """A stretching link that passes over its azimuth's full turn and past the horizontal."""
        return cone(1.2 + 0.9 * np.sin(2 * t), 0.3 + 1.7 * t, (1 + 0.1 * np.sin(5 * t))[:, None, None])

    h = 1e-4
    t = np.arange(0, 6, h)
    nodes = motion(t)
    velocities = (motion(t + 1e-6) - motion(t - 1e-6)) / 2e-6
    for angle, rate in zip(link_angles(nodes, zero), angle_rates(nodes, velocities, zero), strict=True):
        np.testing.assert_allclose(rate[1:-1], (angle[2:] - angle[:-2]) / (2 * h), atol=1e-5)


def test_rate_through_the_pole_is_the_planar_one_and_the_azimuth_rate_is_zero():
    swing = np.array([-0.2, 0.0, 0.2])
    nodes = planar(np.pi / 2 - swing[:, None], length=2.0)
    velocities = np.zeros_like(nodes)
    # d(polar from down)/dt = 3 rad/s: velocity 2 m * 3 rad/s along (cos, 0, sin)
    velocities[:, 1] = 6.0 * np.stack([np.cos(swing), 0 * swing, np.sin(swing)], axis=-1)
    polar_rate, azimuth_rate = angle_rates(nodes, velocities, "down")
    np.testing.assert_allclose(polar_rate[:, 0], 3.0, atol=1e-12)
    np.testing.assert_allclose(azimuth_rate, 0.0, atol=1e-12)


def test_phase_curve_of_a_harmonic_swing_is_an_ellipse():
    t = np.linspace(0, 4, 500)
    theta, rate = 1.5 + 0.4 * np.sin(3 * t), 1.2 * np.cos(3 * t)
    nodes = planar(np.stack([0 * t, theta], axis=1), length=1.0)
    velocities = np.zeros_like(nodes)
    velocities[:, 2] = rate[:, None] * np.stack([-np.sin(theta), 0 * t, -np.cos(theta)], axis=-1)
    angle, speed = phase_curve(nodes, velocities, link=1)
    np.testing.assert_allclose(((angle - 1.5) / 0.4) ** 2 + (speed / 1.2) ** 2, 1.0, atol=1e-10)
    np.testing.assert_allclose(phase_curve(nodes, velocities, link=-1)[0], angle)


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: link_angles(np.zeros((4, 3, 3)), "up"), "zero"),
        (lambda: link_angles(np.zeros((4, 3))[:, :2]), "positions"),
        (lambda: link_angles(np.zeros((1, 3))), "positions"),
        (lambda: angle_rates(np.zeros((4, 3, 3)), np.zeros((3, 3, 3))), "velocities"),
        (lambda: phase_curve(np.zeros((4, 3, 3)), np.zeros((4, 3, 3)), link=2), "link"),
        (lambda: phase_curve(np.zeros((4, 3, 3)), np.zeros((4, 3, 3)), angle="yaw"), "angle"),
    ],
)
def test_mistakes_name_the_argument(call, word):
    with pytest.raises(ValueError, match=f"^{word}"):
        call()
