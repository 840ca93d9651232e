"""Prices of constraints at designs whose Lagrange multipliers are known."""

import numpy as np

from fitting.farm.optimise.prices import prices
from fitting.farm.optimise.values import Values

FREE = np.zeros(2, bool)
LOW, HIGH = np.full(2, -2.0), np.full(2, 2.0)


def circle(angle, limit=1.0):
    """min -x - y within x^2 + y^2 <= 2 limit, on the circle: the best is -2 sqrt(limit), at 45 degrees."""
    x = np.sqrt(2 * limit) * np.array([np.cos(angle), np.sin(angle)])
    return x, Values(-x.sum(), -np.ones(2), ("circle",), np.array([x @ x / 2]), x[None])


def test_the_price_of_a_curved_constraint_is_the_slope_of_its_optimum():
    x, values = circle(np.pi / 4)
    found = prices(values, x, LOW, HIGH, FREE, limit=1.0)
    # d(-2 sqrt(limit))/d limit = -1; a linear programme in a box would have one variable at the box's wall
    np.testing.assert_allclose([found.of[0], found.left], [1.0, 0.0], atol=1e-12)


def test_a_design_that_is_no_optimum_says_so():
    x, values = circle(np.pi / 4 + 0.3)
    found = prices(values, x, LOW, HIGH, FREE, limit=1.0)
    np.testing.assert_allclose(found.left, np.sin(0.3), rtol=1e-9)  # what of the slope lies along the circle


def test_bounds_hold_what_constraints_do_not():
    # min -x - 3 y, x at its bound, x + y <= 1: the constraint's price is that of y alone
    values = Values(0.0, np.array([-1.0, -3.0]), ("sum",), np.array([1.0]), np.ones((1, 2)))
    found = prices(values, np.array([-2.0, 3.0]), LOW, np.array([2.0, 9.0]), FREE, limit=1.0)
    np.testing.assert_allclose([found.of[0], found.left], [3.0, 0.0], atol=1e-12)


def test_sizes_of_a_catalogue_stay_and_idle_constraints_cost_nothing():
    values = Values(0.0, np.array([-1.0, -4.0]), ("a", "b"), np.array([1.0, 0.5]), np.array([[2.0, 9.0], [1.0, 1.0]]))
    found = prices(values, np.zeros(2), LOW, HIGH, np.array([False, True]), limit=1.0)
    np.testing.assert_allclose([*found.of, found.left], [0.5, 0.0, 0.0], atol=1e-12)
