"""Motions of independent equations, and how far a scheme is from them.

The dropper's release: node by node. Chains in angles: Lagrange's equations (sympy). Elastic lines: Newton's second law.
All by SciPy's DOP853.
"""

from functools import cache

import jax
import numpy as np
import pytest
import sympy as sp
from release_by_scipy import MASS, links, release
from scipy.integrate import solve_ivp

import dropper_jax as dj

G = 9.81

# --- the release of a dropper -------------------------------------------------------------------------------------

RELEASE_DURATION, RELEASE_SAVES = 1.5, 6
RELEASES = {"dropper-release-a-undamped": (0.0, 0.0), "dropper-release-a": (0.002, 0.001)}


def angles(r):
    d = np.array([links(x) for x in r])
    return np.arctan2(-d[..., 2], d[..., 0])


@pytest.fixture(scope="session")
def releases():
    """`releases(scene)`: model, start and the link angles that DOP853 finds at some times, made once."""
    times = RELEASE_DURATION * np.arange(1, RELEASE_SAVES + 1) / RELEASE_SAVES

    @cache
    def find(scene):
        model, s = dj.build(scene)
        return model, s, angles(release(s.r, *RELEASES[scene], times))

    return find


@pytest.fixture(scope="session")
def order(march, releases):
    """`order(integrator, powers)`: slope of log(RMS angle error) of a release against log(step), steps 2^-p."""

    def find(integrator, powers, gamma=None, damped=False):
        model, s, exact = releases("dropper-release-a" if damped else "dropper-release-a-undamped")
        stepper = dj.make_stepper(model, integrator, gamma=gamma, halvings=0, track_work=False)
        errors = []
        for p in powers:
            r = march(stepper, model, s, RELEASE_DURATION, round(RELEASE_DURATION * 2**p), RELEASE_SAVES)[0]
            wrong = angles(r) - exact
            wrong -= 2 * np.pi * np.round(wrong / (2 * np.pi))
            errors.append(np.sqrt(np.mean(wrong**2)))
        return -np.polyfit(powers, np.log2(errors), 1)[0]

    return find


@pytest.fixture(scope="session")
def energy_loss(march):
    """`energy_loss(integrator, gamma)`: what the undamped release has lost after a second [J]."""

    def find(integrator, gamma):
        model, s = dj.build("dropper-release-a-undamped")
        stepper = dj.make_stepper(model, integrator, gamma=gamma, halvings=0, track_work=False)
        r, v, _ = march(stepper, model, s, 1.0, 500)
        before, after = (9.81 * np.sum(MASS * z) for z in (s.r[:, 2], r[-1, :, 2]))
        return before - after - 0.5 * np.sum(MASS[:, None] * v[-1] ** 2)

    return find


# --- chains in angles ---------------------------------------------------------------------------------------------

DURATION, SAVES = 5.0, 5


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


def lagrangian_motion(chain, case):
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


@pytest.fixture(scope="session")
def motion(chain):
    """`motion(name)`: model, start and the nodes at `SAVES` times over `DURATION` by Lagrange's equations."""
    return cache(lambda name: lagrangian_motion(chain, CHAINS[name]))


@pytest.fixture(scope="session")
def motion_error(march, motion):
    """`motion_error(integrator, name, steps)`: largest distance of a node from Lagrange's motion [m]."""

    def find(integrator, name, steps):
        model, s, exact = motion(name)
        stepper = dj.make_stepper(model, integrator, halvings=0, track_work=False)
        return np.max(np.abs(march(stepper, model, s, DURATION, steps, SAVES)[0] - exact))

    return find


# --- elastic lines ------------------------------------------------------------------------------------------------

#: Lengths [m], masses [kg], stiffness [N], internal damping [N s], linear damping [kg/s], and the far end [m].
LINK, LUMP, STIFFNESS, INTERNAL, DRAG = np.array([0.3, 0.2, 0.4]), np.array([0.2, 0.1, 0.3]), 60.0, 0.3, 0.05
END = np.array([0.6, 0.1, 0.0])


def elastic_slope(t, y):
    """Newton's second law, node by node, of a loop of three springs with dashpots, weight and linear damping."""
    r, v = y.reshape(2, 2, 3)
    nodes = np.vstack([np.zeros(3), r, END])
    speeds = np.vstack([np.zeros(3), v, np.zeros(3)])
    force = -DRAG * v - G * LUMP[:2, None] * np.array([0.0, 0.0, 1.0])
    for j in range(3):
        d, rate = nodes[j + 1] - nodes[j], speeds[j + 1] - speeds[j]
        size = np.linalg.norm(d)
        tension = STIFFNESS * (size / LINK[j] - 1) + INTERNAL * (d @ rate / size) / LINK[j]
        if j < 2:
            force[j] -= tension * d / size
        if j > 0:
            force[j - 1] += tension * d / size
    return np.concatenate([v, force / LUMP[:2, None]]).ravel()


@pytest.fixture(scope="session")
def elastic(chain):
    positions = np.array([[0.0, 0.0, 0.0], [0.25, 0.05, -0.2], [0.35, 0.1, -0.3], END])
    velocities = np.array([[0, 0, 0], [0.3, -0.2, 0.1], [0.0, 0.4, 0.0], [0, 0, 0.0]])
    start = {"kind": "positions", "positions": positions.tolist(), "velocities": velocities.tolist()}
    effects = {"weight": {}, "linear_damping": {"b_l": DRAG}}
    axial = {"law": "elastic", "EA": STIFFNESS, "damping": INTERNAL}
    scene = chain(LINK, LUMP.tolist(), start, right=END.tolist(), effects=effects, axial=axial)
    model, s = dj.build(scene)
    y0 = np.concatenate([positions[1:3], velocities[1:3]]).ravel()
    found = solve_ivp(elastic_slope, (0, 1.0), y0, method="DOP853", rtol=1e-13, atol=1e-13)
    return model, s, found.y[:6, -1].reshape(2, 3)


@pytest.fixture(scope="session")
def elastic_order(march, elastic):
    """`elastic_order(integrator, steps)`: order of a scheme on an elastic loop, and its error [m] at the last step."""

    def find(integrator, steps):
        model, s, exact = elastic
        stepper = dj.make_stepper(model, integrator).plain
        error = [np.max(np.abs(march(stepper, model, s, 1.0, n)[0][-1] - exact)) for n in steps]
        return -np.polyfit(np.log(steps), np.log(error), 1)[0], error[-1]

    return find


#: The mass [kg] that rings on a vertical elastic link of this length [m].
RING_LENGTH, RING_MASS = 0.5, 0.4


@pytest.fixture(scope="session")
def ring(chain):
    """Tensions over steps of a mass that rings on a vertical elastic link, over the weight, per unit of the first."""

    def make(integrator, EA, dt, steps, **weights):
        rest = -RING_LENGTH * (1 + RING_MASS * G / EA)
        nodes = [[0.0, 0.0, 0.0], [0.0, 0.0, rest * (1 + 1e-8)]]
        axial = {"law": "elastic", "EA": EA}
        scene = chain([RING_LENGTH], [RING_MASS], {"kind": "positions", "positions": nodes}, axial=axial)
        model, s = dj.build(scene)
        stepper = dj.make_stepper(model, integrator, **weights).plain
        _, path = jax.jit(lambda m, s: dj.integrate(stepper, m, s, dt, steps))(model, s)
        swing = np.asarray(path.tension[:, 0]) - RING_MASS * G
        return swing / (EA * 1e-8)

    return make
