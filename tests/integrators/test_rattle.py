"""RATTLE: its order, a circle of its own, Lagrange's equations."""

import numpy as np
import pytest

import dropper_jax as dj

G = 9.81


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("rattle", (8, 9, 10, 11)) == pytest.approx(2.0, abs=0.1)


def test_damping_leaves_the_order_as_it_is(order):
    assert order("rattle", (8, 9, 10), damped=True) == pytest.approx(2.0, abs=0.1)


def circle_error(solution):
    radius = np.linalg.norm(solution.positions[:, 1, :2], axis=-1)
    height = np.max(np.abs(solution.positions[:, 1, 2] + np.sin(np.pi / 8)))
    return max(np.max(np.abs(radius - np.cos(np.pi / 8))), height)


def test_rattle_keeps_the_circle_at_the_rate_that_its_own_difference_equations_ask_for():
    """A steady turn by a per step: v_h = 2 R sin(a/2)/h, 4 R sin^2(a/2)/h^2 = w^2 R, v = R sin(a)/h.

    So v = R w sqrt(1 - (h w/2)^2), below the exact rate w by its second-order error.
    """
    h, rate = 0.01, np.sqrt(G / np.sin(np.pi / 8))
    own = rate * np.sqrt(1 - (h * rate / 2) ** 2)
    scene = dj.load_scene("conical-pendulum").with_values({"start.azimuth_rate": [own]})
    assert circle_error(dj.simulate(scene, integrator="rattle", dt=h)) < 1e-9


@pytest.mark.parametrize("name", ["double, plane", "double, spherical"])
def test_it_follows_lagranges_equations_to_a_micrometre(motion_error, name):
    assert motion_error("rattle", name, 200_000) < 1e-6
