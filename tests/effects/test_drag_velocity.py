"""Stiff drag: motions stop as they should, steady ones keep their speed, and slow decay is second order."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import hung_line, single_line

import dropper_jax as dj
from dropper_jax.effects.drag_velocity import SERIES_BELOW, excess


def loose(effects, dt, speed, steps, mass=0.05):
    """A mass on a slack rope that starts with `speed` [m/s] along x."""
    scene = hung_line(1, 1.0, mass, axial={"law": "rope", "EA": 1e3})
    scene["line"][0]["length"] = 1e3
    start = {"positions": [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]], "velocities": [[0.0, 0.0, 0.0], [speed, 0.0, 0.0]]}
    run = {"dt": dt, "duration": steps * dt}
    return scene | {"run": run, "effects": effects, "start": {"kind": "positions", **start}}


def speeds(scene):
    """Velocity along x and z (steps + 1, 2) [m/s], and the node's mass [kg]."""
    solution = dj.simulate(scene)
    assert solution.status == "ok"
    return solution.velocities[:, -1, ::2], float(dj.build(scene)[0].node_mass[0])


def pendulum(effects, dt, steps):
    """A mass of 0.05 kg on a rigid link that starts at 8.4 m/s."""
    scene = loose(effects, dt, 8.4, steps)
    scene["line"][0] |= {"length": 1.0, "axial": {"law": "rigid"}}
    return scene


def test_excess_is_its_closed_form_on_both_sides_of_the_series():
    z = np.array([1e-6, 1e-3, 0.9 * SERIES_BELOW, 1.1 * SERIES_BELOW, 1.0, 7.0, 40.0, 2e4])
    long = z.astype(np.longdouble)
    expected = 2.0 * (-1.0 / np.expm1(-long) - 1.0 / long) - 1.0
    np.testing.assert_allclose(excess(jnp.asarray(z)), expected.astype(float), rtol=2e-8, atol=1e-11)
    slopes = jax.vmap(jax.grad(excess))(jnp.asarray(z[1:-1]))
    differences = (excess(jnp.asarray(z[1:-1] * (1 + 1e-5))) - excess(jnp.asarray(z[1:-1] * (1 - 1e-5)))) / (
        2e-5 * z[1:-1]
    )
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=1e-9)
    assert float(excess(jnp.zeros(()))) == 0.0
    assert float(jax.grad(excess)(0.0)) == pytest.approx(1.0 / 6.0)


@pytest.mark.parametrize("b_l", [0.01, 1.0, 50.0, 1e6])
def test_linear_drag_alone_decays_as_its_closed_form_at_any_step(b_l):
    v, mass = speeds(loose({"linear_damping": {"b_l": b_l}}, 0.01, 2.0, 20))
    t = 0.01 * np.arange(21)
    np.testing.assert_allclose(v[:, 0], 2.0 * np.exp(-b_l / mass * t), rtol=1e-7, atol=1e-12)


def test_what_falls_against_stiff_drag_reaches_its_speed_in_one_step():
    v, mass = speeds(loose({"weight": {}, "linear_damping": {"b_l": 500.0}}, 0.01, 0.0, 4))
    np.testing.assert_allclose(v[1:, 1], -mass * 9.81 / 500.0, rtol=2e-2)
    np.testing.assert_allclose(v[3:, 1], -mass * 9.81 / 500.0, rtol=1e-6)


@pytest.mark.parametrize("effects", [{"linear_damping": {"b_l": 1e6}}, {"quadratic_damping": {"b_q": 1e4}}])
def test_a_pendulum_stops_and_never_turns_round(effects):
    """The velocity of the middle alone keeps 8.4 m/s and turns it round at every step."""
    v, _ = speeds(pendulum({"weight": {}, **effects}, 1e-3, 20))
    assert np.abs(v[-1]).max() < 0.01
    assert v[:, 0].min() > -1e-3


def test_quadratic_drag_alone_is_second_order():
    """Against `v0/(1 + v0 b t/m)`."""
    errors = []
    for steps in (20, 40, 80):
        v, mass = speeds(loose({"quadratic_damping": {"b_q": 0.1}}, 0.4 / steps, 2.0, steps))
        errors.append(abs(v[-1, 0] - 2.0 / (1.0 + 2.0 * 0.1 * 0.4 / mass)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def whipped(effects):
    """A light node next to the end of a loop of heavy ones, let go with steps far longer than its motions."""
    start = {"kind": "static", "release_nodes": [1], "release_force": [[0.0, 0.0, 4.01]]}
    effects = {"weight": {"gravity": 2.0}, **effects}
    return single_line([1.0] * 5, [0.01, 1, 1, 1, 1], start, [3.75, 0.0, 0.0], effects, 10.0**-0.75, 7.0)


@pytest.mark.parametrize("form", ["isotropic", "componentwise", "linear"])
def test_drag_in_still_water_never_gives_energy(form):
    effects = {"quadratic_damping": {"b_q": 1.0, "form": form}}
    if form == "linear":
        effects = {"linear_damping": {"b_l": 0.3}}
    solution = dj.simulate(whipped(effects))
    gained = np.diff(solution.work, axis=0)
    assert np.abs(gained).max() > 1e-2
    assert gained.max() <= 1e-12 * np.abs(solution.work).max()
