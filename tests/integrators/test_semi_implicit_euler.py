"""Semi-implicit Euler: first order, rigid and elastic."""

import pytest


def test_it_converges_to_the_independent_solution_with_its_order(order):
    assert order("semi_implicit_euler", (10, 11, 12, 13)) == pytest.approx(1.0, abs=0.15)


def test_elastic_loop_follows_newtons_equations_with_the_order_of_the_scheme(elastic_order):
    found, error = elastic_order("semi_implicit_euler", (4000, 8000, 16000))
    assert found == pytest.approx(1.0, abs=0.2)
    assert error < 2e-3
