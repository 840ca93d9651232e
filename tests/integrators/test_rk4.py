"""Runge-Kutta of fourth order: its order, and a ringing link."""

import numpy as np
import pytest

import dropper_jax as dj

G = 9.81


def test_elastic_loop_follows_newtons_equations_with_the_order_of_the_scheme(elastic_order):
    found, error = elastic_order("rk4", (400, 800, 1600))
    assert found == pytest.approx(4.0, abs=0.2)
    assert error < 1e-9


def test_a_mass_on_an_elastic_link_rings_at_its_closed_form_frequency(march, chain):
    """z = rest + a cos(w t), w^2 = EA/(L m): exact for a vertical line."""
    length, mass, stiffness, amplitude = 0.5, 0.4, 80.0, 0.02
    rest = -length * (1 + mass * G / stiffness)
    nodes = [[0.0, 0.0, 0.0], [0.0, 0.0, rest - amplitude]]
    scene = chain(
        [length], [mass], {"kind": "positions", "positions": nodes}, axial={"law": "elastic", "EA": stiffness}
    )
    model, s = dj.build(scene)
    w = np.sqrt(stiffness / (length * mass))
    r = march(dj.make_stepper(model, "rk4"), model, s, 1.0, 2000)[0]
    assert r[-1, 0, 2] == pytest.approx(rest - amplitude * np.cos(w), abs=1e-9)
