"""Dop853 with equal steps; runs that follow an accuracy are in tests/stepping/test_embedded.py."""

import pytest

from dropper_jax.integrators.dop853 import Dop853


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("dop853", (5, 6, 7)) > Dop853.order - 0.7


def test_it_follows_lagranges_equations_to_a_nanometre(motion_error):
    assert motion_error("dop853", "double, spherical", 2_000) < 1e-9


def test_its_stages_and_weights_satisfy_the_simplest_order_conditions():
    c = [0.0, *(sum(row) for row in Dop853.a)]
    for power in range(8):
        assert sum(b * x**power for b, x in zip(Dop853.b, c, strict=True)) == pytest.approx(1 / (power + 1), rel=1e-12)
    for errors in Dop853.errors:
        assert sum(errors) == pytest.approx(0.0, abs=1e-14)
