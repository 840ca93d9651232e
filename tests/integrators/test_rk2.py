"""Runge-Kutta of second order."""

import pytest


def test_elastic_loop_follows_newtons_equations_with_the_order_of_the_scheme(elastic_order):
    found, error = elastic_order("rk2", (800, 1600, 3200))
    assert found == pytest.approx(2.0, abs=0.2)
    assert error < 1e-4
