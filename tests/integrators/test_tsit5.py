"""Tsit5 with equal steps; runs that follow an accuracy are in tests/stepping/test_embedded.py."""

import pytest

from dropper_jax.integrators.tsit5 import Tsit5


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("tsit5", (6, 7, 8)) > Tsit5.order - 0.7


def test_it_follows_lagranges_equations_to_a_nanometre(motion_error):
    assert motion_error("tsit5", "double, spherical", 2_000) < 1e-9


def test_its_stages_and_weights_satisfy_the_simplest_order_conditions():
    c = [0.0, *(sum(row) for row in Tsit5.a)]
    for power in range(5):
        assert sum(b * x**power for b, x in zip(Tsit5.b, c, strict=True)) == pytest.approx(1 / (power + 1), rel=1e-12)
    for errors in Tsit5.errors:
        assert sum(errors) == pytest.approx(0.0, abs=1e-14)
