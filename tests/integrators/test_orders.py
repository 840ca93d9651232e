"""Orders of convergence to independent solutions, and the conditions that weights meet."""

import pytest

from dropper_jax.integrators.dop853 import Dop853
from dropper_jax.integrators.tsit5 import Tsit5

LAGRANGE = ("double, plane", "double, spherical", "three rods, plane", "two rods, spherical")


@pytest.mark.parametrize(
    ("integrator", "powers", "given", "expected", "within"),
    [
        ("semi_implicit_euler", (10, 11, 12, 13), {}, 1.0, 0.15),
        pytest.param("thesis_angles", (11, 12), {"gamma": 0.51}, 1.0, 0.15, marks=pytest.mark.slow),
        pytest.param("theta", (10, 11, 12, 13), {"gamma": 0.51}, 1.0, 0.15, marks=pytest.mark.slow),
        pytest.param("theta", (13, 14, 15, 16), {"gamma": 1.0}, 1.0, 0.2, marks=pytest.mark.slow),
        ("theta_midpoint", (10, 11, 12, 13), {"gamma": 0.51}, 1.0, 0.15),
        ("rattle", (8, 9, 10, 11), {}, 2.0, 0.1),
        ("rattle_4", (7, 8, 9), {}, 4.0, 0.3),
        ("energy_momentum", (8, 9, 10, 11), {}, 2.0, 0.1),
        ("energy_momentum_4", (7, 8, 9), {}, 4.0, 0.3),
        ("theta", (11, 12), {"damped": True}, 1.0, 0.15),
        ("rattle", (8, 9, 10), {"damped": True}, 2.0, 0.1),
        ("rattle_4", (7, 8, 9), {"damped": True}, 4.0, 0.3),
        ("energy_momentum", (8, 9, 10), {"damped": True}, 2.0, 0.1),
    ],
)
def test_releases_converge_to_the_independent_solution_with_the_order_of_the_scheme(
    order, integrator, powers, given, expected, within
):
    assert order(integrator, powers, **given) == pytest.approx(expected, abs=within)


@pytest.mark.parametrize(
    ("integrator", "powers", "least"),
    [("tsit5", (6, 7, 8), Tsit5.order - 0.7), ("dop853", (5, 6, 7), Dop853.order - 0.7)],
)
def test_embedded_schemes_converge_with_at_least_their_order(order, integrator, powers, least):
    assert order(integrator, powers) > least


@pytest.mark.parametrize(
    ("integrator", "coarsest", "expected", "largest"),
    [
        ("semi_implicit_euler", 4000, 1.0, 2e-3),
        ("rk2", 800, 2.0, 1e-4),
        ("generalized_alpha", 400, 2.0, 1e-5),
        ("energy_momentum", 4000, 2.0, 1e-5),
        ("rk4", 400, 4.0, 1e-9),
        pytest.param("energy_momentum_4", 200, 4.0, 1e-6, marks=pytest.mark.check),
    ],
)
def test_elastic_loop_follows_newtons_equations_with_the_order_of_the_scheme(
    elastic_order, integrator, coarsest, expected, largest
):
    found, error = elastic_order(integrator, (coarsest, 2 * coarsest, 4 * coarsest))
    assert found == pytest.approx(expected, abs=0.2)
    assert error < largest


@pytest.mark.parametrize(
    ("integrator", "chain_name", "steps", "metres"),
    [
        ("tsit5", "double, spherical", 2_000, 1e-9),
        ("dop853", "double, spherical", 2_000, 1e-9),
        *(("rattle", name, 200_000, 1e-6) for name in LAGRANGE[:2]),
        *(pytest.param("energy_momentum_4", name, 10_000, 1e-6, marks=pytest.mark.check) for name in LAGRANGE),
    ],
)
def test_it_follows_lagranges_equations(motion_error, integrator, chain_name, steps, metres):
    assert motion_error(integrator, chain_name, steps) < metres


@pytest.mark.parametrize(("scheme", "powers"), [(Tsit5, 5), (Dop853, 8)])
def test_stages_and_weights_satisfy_the_simplest_order_conditions(scheme, powers):
    c = [0.0, *(sum(row) for row in scheme.a)]
    for power in range(powers):
        assert sum(b * x**power for b, x in zip(scheme.b, c, strict=True)) == pytest.approx(1 / (power + 1), rel=1e-12)
    for errors in scheme.errors:
        assert sum(errors) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("integrator", ["theta", "theta_midpoint"])
def test_weights_above_one_half_take_energy_and_a_weight_of_one_takes_most(energy_loss, integrator):
    loss = [energy_loss(integrator, gamma) for gamma in (0.6, 1.0)]
    assert 0 < loss[0] < loss[1]
