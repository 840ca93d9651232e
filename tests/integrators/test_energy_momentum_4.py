"""The energy-momentum scheme composed to fourth order."""

import pytest


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("energy_momentum_4", (7, 8, 9)) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("name", ["double, plane", "double, spherical", "three rods, plane", "two rods, spherical"])
def test_it_follows_lagranges_equations_to_a_micrometre(motion_error, name):
    assert motion_error("energy_momentum_4", name, 10_000) < 1e-6
