"""Motions against independent equations: Lagrange's for chains in angles (sympy, SciPy), Newton's for elastic lines."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import dropper_jax as dj

G = 9.81


def lagrangian_chain(length, mass, spatial, centre=None, inertia=None):
    """q'' = f(q, q') of a chain of links in polar angles from straight down (and azimuths), by Lagrange's equations.

    Each link has `m |c'|^2/2 + I |u'|^2/2 - m g c_z`, u its unit vector, c its centre of mass (default: its end).
    """
    n = len(length)
    polar = sp.symbols(f"a:{n}")
    azimuth = sp.symbols(f"b:{n}") if spatial else [sp.Integer(0)] * n
    q = sp.Matrix([*polar, *azimuth] if spatial else polar)
    rate = sp.Matrix(sp.symbols(f"w:{len(q)}"))
    node, energy, potential = sp.zeros(3, 1), 0, 0
    for j in range(n):
        u = sp.Matrix([sp.sin(polar[j]) * sp.cos(azimuth[j]), sp.sin(polar[j]) * sp.sin(azimuth[j]), -sp.cos(polar[j])])
        c = node + (length[j] if centre is None else centre[j]) * u
        v, turn = c.jacobian(q) * rate, u.jacobian(q) * rate
        energy += mass[j] * v.dot(v) / 2 + (0 if inertia is None else inertia[j]) * turn.dot(turn) / 2
        potential += mass[j] * G * c[2]
        node = node + length[j] * u
    lagrangian = energy - potential
    momentum = sp.Matrix([lagrangian.diff(w) for w in rate])
    matrix = momentum.jacobian(rate)
    forces = sp.Matrix([lagrangian.diff(x) for x in q]) - momentum.jacobian(q) * rate
    function = sp.lambdify([list(q), list(rate)], [matrix, forces], cse=True)

    def slope(t, y):
        q, w = np.split(y, 2)
        m, f = function(q, w)
        return np.concatenate([w, np.linalg.solve(np.asarray(m), np.asarray(f).ravel())])

    return slope


def nodes_of(length, q, spatial):
    """Nodes (k, n, 3) of angles (dof, k)."""
    n = len(length)
    polar, azimuth = q[:n].T, q[n : 2 * n].T if spatial else 0 * q[:n].T
    u = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)], axis=-1)
    return np.cumsum(np.asarray(length)[:, None] * u, axis=1)


CHAINS = {
    "double, plane": {
        "length": [1.0, 0.7],
        "mass": [1.0, 0.4],
        "polar": [1.3, -0.6],
        "polar_rate": [0.5, -1.0],
    },
    "double, spherical": {
        "length": [1.0, 1.0],
        "mass": [1.0, 0.2],
        "polar": [1.2, 0.9],
        "azimuth": [0.3, -0.4],
        "polar_rate": [-0.8, 0.6],
        "azimuth_rate": [1.4, -0.9],
    },
    "three rods, plane": {
        "length": [0.15, 0.2, 0.15],
        "mass": [0.03335, 0.04, 0.03245],
        "centre": [0.106, 0.13, 0.107],
        "inertia": [8.2e-5, 1.5e-4, 8.0e-5],
        "polar": [0.9, 0.5, -0.4],
        "polar_rate": [0.0, 1.0, -1.0],
    },
    "two rods, spherical": {
        "length": [0.4, 0.3],
        "mass": [0.5, 0.3],
        "centre": [0.25, 0.1],
        "inertia": [6e-3, 2e-3],
        "polar": [0.8, 1.1],
        "azimuth": [0.0, 0.7],
        "polar_rate": [0.5, 0.0],
        "azimuth_rate": [2.0, -1.5],
    },
}
DURATION, SAVES = 5.0, 5


@pytest.fixture(scope="module")
def motion(chain):
    """`motion(name)`: model, start and the nodes at `SAVES` times over `DURATION`, made once."""
    made = {}

    def make(name):
        if name not in made:
            made[name] = build(chain, CHAINS[name])
        return made[name]

    return make


def build(chain, case):
    angles = {key: case[key] for key in ("polar", "azimuth", "polar_rate", "azimuth_rate") if key in case}
    rods = {"centre_of_mass": case["centre"], "inertia": case["inertia"]} if "centre" in case else {}
    model, s = dj.build(chain(case["length"], case["mass"], {"kind": "angles", "zero": "down", **angles}, **rods))
    spatial = "azimuth" in case
    keys = (("polar", "azimuth"), ("polar_rate", "azimuth_rate"))
    y0 = np.concatenate([case[key] for pair in keys for key in pair[: 1 + spatial]])
    slope = lagrangian_chain(case["length"], case["mass"], spatial, case.get("centre"), case.get("inertia"))
    times = DURATION * np.arange(1, SAVES + 1) / SAVES
    found = solve_ivp(slope, (0, DURATION), y0, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-12)
    return model, s, nodes_of(case["length"], found.y[: len(y0) // 2], spatial)


@pytest.mark.parametrize("name", CHAINS)
def test_fourth_order_scheme_follows_lagranges_equations_to_a_micrometre(march, motion, name):
    model, s, exact = motion(name)
    stepper = dj.make_stepper(model, "energy_momentum_4", halvings=0, track_work=False)
    r = march(stepper, model, s, DURATION, 10_000, SAVES)[0]
    np.testing.assert_allclose(r, exact, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["double, plane", "double, spherical"])
def test_rattle_follows_lagranges_equations_to_a_micrometre(march, motion, name):
    model, s, exact = motion(name)
    stepper = dj.make_stepper(model, "rattle", halvings=0, track_work=False)
    r = march(stepper, model, s, DURATION, 200_000, SAVES)[0]
    np.testing.assert_allclose(r, exact, rtol=0, atol=1e-6)


def test_thesis_scheme_in_angles_has_the_right_sign_of_the_coriolis_term(march, motion):
    """First order: halving the step halves the error in space; a wrong sign would leave it as it is."""
    model, s, exact = motion("double, spherical")
    stepper = dj.make_stepper(model, "thesis_angles", gamma=0.51, halvings=0, track_work=False)
    error = [np.max(np.abs(march(stepper, model, s, 1.0, steps)[0][-1] - exact[0])) for steps in (4000, 8000)]
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(2.0, abs=0.1)


# --- elastic lines ----------------------------------------------------------------------------------------------

LENGTH, MASS, STIFFNESS, INTERNAL, DRAG = np.array([0.3, 0.2, 0.4]), np.array([0.2, 0.1, 0.3]), 60.0, 0.3, 0.05
END = np.array([0.6, 0.1, 0.0])


def elastic_slope(t, y):
    """Newton's second law, node by node, of a loop of three springs with dashpots, weight and linear damping."""
    r, v = y.reshape(2, 2, 3)
    nodes = np.vstack([np.zeros(3), r, END])
    speeds = np.vstack([np.zeros(3), v, np.zeros(3)])
    force = -DRAG * v - G * MASS[:2, None] * np.array([0.0, 0.0, 1.0])
    for j in range(3):
        d, rate = nodes[j + 1] - nodes[j], speeds[j + 1] - speeds[j]
        size = np.linalg.norm(d)
        tension = STIFFNESS * (size / LENGTH[j] - 1) + INTERNAL * (d @ rate / size) / LENGTH[j]
        if j < 2:
            force[j] -= tension * d / size
        if j > 0:
            force[j - 1] += tension * d / size
    return np.concatenate([v, force / MASS[:2, None]]).ravel()


@pytest.fixture(scope="module")
def elastic(chain):
    positions = np.array([[0.0, 0.0, 0.0], [0.25, 0.05, -0.2], [0.35, 0.1, -0.3], END])
    velocities = np.array([[0, 0, 0], [0.3, -0.2, 0.1], [0.0, 0.4, 0.0], [0, 0, 0.0]])
    start = {"kind": "positions", "positions": positions.tolist(), "velocities": velocities.tolist()}
    effects = {"weight": {}, "linear_damping": {"b_l": DRAG}}
    axial = {"law": "elastic", "EA": STIFFNESS, "damping": INTERNAL}
    scene = chain(LENGTH, MASS.tolist(), start, right=END.tolist(), effects=effects, axial=axial)
    model, s = dj.build(scene)
    y0 = np.concatenate([positions[1:3], velocities[1:3]]).ravel()
    found = solve_ivp(elastic_slope, (0, 1.0), y0, method="DOP853", rtol=1e-13, atol=1e-13)
    return model, s, found.y[:6, -1].reshape(2, 3)


@pytest.mark.parametrize(
    ("integrator", "steps", "expected", "finest"),
    [
        ("rk4", (400, 800, 1600), 4.0, 1e-9),
        ("rk2", (800, 1600, 3200), 2.0, 1e-4),
        ("semi_implicit_euler", (4000, 8000, 16000), 1.0, 2e-3),
        ("energy_momentum", (4000, 8000, 16000), 1.0, 1e-3),
        ("generalized_alpha", (400, 800, 1600), 2.0, 1e-5),
    ],
)
def test_elastic_loop_follows_newtons_equations_with_the_order_of_its_scheme(
    march, elastic, integrator, steps, expected, finest
):
    """The elastic law stands at the end of the step: energy_momentum is of first order in its stretching."""
    model, s, exact = elastic
    stepper = dj.make_stepper(model, integrator)
    error = [np.max(np.abs(march(stepper, model, s, 1.0, n)[0][-1] - exact)) for n in steps]
    assert -np.polyfit(np.log(steps), np.log(error), 1)[0] == pytest.approx(expected, abs=0.2)
    assert error[-1] < finest


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
