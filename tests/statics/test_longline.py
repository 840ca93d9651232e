"""Longlines against closed forms: catenary on a bed, currents, modes, design values."""

import numpy as np
import pytest
from grounded_catenary import fairlead_forces
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import jn_zeros

from dropper_jax import SceneError, build, build_model, equilibrium, load_scene, natural_modes
from dropper_jax.study.design import solve_design

G = 9.81


# --- statics ------------------------------------------------------------------------------------------------------

CHAIN = {"mass": 10.91, "diameter": 0.042, "EA": 1e6}


def grounded_chain(one_line, links, end=(60.0, 0.0, 0.0), **friction):
    """Static pose of a chain with its anchor on the bed."""
    bed = {"weight": {}, "seabed": {"depth": 30.0, "stiffness": 1e9}, **friction}
    pose = equilibrium(one_line(75.0, links, [0.0, 0.0, -30.0], list(end), CHAIN, bed))
    assert pose.status == "ok", pose.message
    return pose


def fairlead_force(pose):
    """Force [N] of the chain on its upper end (x, y, z)."""
    last = pose.positions[-1] - pose.positions[-2]
    half_link = 0.5 * CHAIN["mass"] * G * 75.0 / len(pose.tension)  # hangs on the fairlead itself
    return pose.tension[-1] * last / np.linalg.norm(last) + [0.0, 0.0, half_link]


@pytest.mark.check
def test_chain_on_a_bed_is_the_elastic_catenary_to_1e_4_and_of_second_order(one_line):
    exact = fairlead_forces(75.0, CHAIN["mass"] * G, CHAIN["EA"], 60.0, 30.0)
    found = {links: fairlead_force(grounded_chain(one_line, links))[[0, 2]] for links in (25, 100, 200)}
    error = {links: np.max(np.abs(force / exact - 1)) for links, force in found.items()}
    assert error[100] < 1e-4
    assert error[25] / error[200] > 8.0**1.8  # second order, up to where the touchdown falls between nodes


@pytest.mark.check
@pytest.mark.parametrize(
    ("mu", "end"),
    [(0.3, (60.0, 0.0, 0.0)), (1.0, (60.0, 0.0, 0.0)), (1.0, (0.0, 60.0, 0.0))],
    ids=["to the anchor", "to a part without tension", "laid along y"],
)
def test_friction_on_the_bed_lowers_the_tension_towards_the_anchor_as_jonkman_derives(one_line, mu, end):
    length, w, links = 75.0, CHAIN["mass"] * G, 100
    h, v = fairlead_forces(length, w, CHAIN["EA"], 60.0, 30.0, friction=mu)
    beyond = (np.arange(links) + 0.5) * length / links - (length - v / w)  # middle of each link, past touchdown
    tension = np.where(beyond < 0, np.maximum(h + mu * w * beyond, 0.0), np.hypot(h, w * np.maximum(beyond, 0.0)))
    assert (tension[0] > 0.0) == (mu < 1.0)
    pose = grounded_chain(one_line, links, end, seabed_friction={"kinetic": mu, "statics": "outward"})
    assert np.max(np.abs(pose.tension - tension)) < 1e-4 * np.hypot(h, v)
    pull = fairlead_force(pose)
    assert pull[:2] == pytest.approx(h * np.array(end[:2]) / 60.0, rel=1e-4, abs=1e-4 * h)
    assert pull[2] == pytest.approx(v, rel=1e-4)


def in_a_current(one_line, links):
    """Largest error of the tension and of the sag, both relative, of a weightless line without axial drag."""
    drag, diameter, speed, length, span = 1.2, 0.05, 1.5, 40.0, 30.0
    kind = {"mass": 2.0, "diameter": diameter, "EA": 1e8, "cdn": drag}  # no weight in the scene: mass has no say
    sea = {"depth": 100.0, "current": {"kind": "uniform", "speed": speed}}
    scene = one_line(length, links, [0.0, 0.0, -50.0], [0.0, span, -50.0], kind, {"morison_drag": {}}, sea=sea)
    pose = equilibrium(scene)
    assert pose.status == "ok", pose.message
    q = 0.5 * 1025.0 * drag * diameter * speed**2
    strain = 0.0
    for _ in range(5):  # the stretched line is a little longer, and its load per length a little less
        a = brentq(lambda a: 2 * a * np.sinh(span / (2 * a)) - length * (1 + strain), 5.0, 100.0)  # noqa: B023
        tension = q * a / (1 + strain)
        strain = tension / kind["EA"]
    sag = a * (np.cosh(span / (2 * a)) - 1)
    return np.max(np.abs(pose.tension / tension - 1)), abs(np.max(pose.positions[:, 0]) / sag - 1)


@pytest.mark.check
def test_weightless_line_in_a_current_is_a_catenary_of_constant_tension(one_line):
    # without axial drag the load is normal, 1/2 rho Cd D U^2 cos^2 per length: a catenary with a = T/q
    (coarse, sag), (fine, _) = in_a_current(one_line, 100), in_a_current(one_line, 200)
    assert sag < 1e-4
    assert coarse < 2e-4  # in the middle, where the line is bent most; T is one and the same along the line
    assert fine < 1e-4
    assert coarse / fine == pytest.approx(4.0, abs=0.2)


# --- modes --------------------------------------------------------------------------------------------------------


def hanging_modes(one_line, links):
    kind = {"mass": 2.0, "diameter": 0.05, "EA": 1e8}
    scene = one_line(10.0, links, [0.0, 0.0, 0.0], [0.0, 0.0, -10.0], kind, {"weight": {}})
    scene["point"][1]["kind"] = "free"
    model, s = build(scene)
    return natural_modes(model, equilibrium(scene).state, 6).omega[::2]  # each frequency twice: in x and in y


def test_hanging_chain_swings_at_the_bessel_frequencies_and_converges_with_second_order(one_line):
    exact = 0.5 * jn_zeros(0, 3) * np.sqrt(G / 10.0)
    found = {links: hanging_modes(one_line, links) for links in (50, 100)}
    coarse, fine = (np.abs(omega / exact - 1) for omega in found.values())
    assert fine[0] < 1e-4
    assert np.all(coarse / fine > 3.7)
    assert np.all(coarse / fine < 4.3)
    # what is left is the polygon's, not the solver's: its own frequencies, and the limit of two of them
    for links, omega in found.items():
        np.testing.assert_allclose(omega, polygon_modes(links), rtol=1e-6)
    limit = (4 * found[100] - found[50]) / 3
    np.testing.assert_allclose(limit, exact, rtol=1e-4)


def polygon_modes(links):
    """Three slowest frequencies of equal masses on a light thread of 10 m, half of one at its lower end."""
    size = 10.0 / links
    pull = np.arange(links, 0.0, -1.0) - 0.5  # tension over m g, from the top
    stiffness = np.diag(pull) + np.diag(np.append(pull[1:], 0.0)) - np.diag(pull[1:], 1) - np.diag(pull[1:], -1)
    mass = np.append(np.ones(links - 1), 0.5)
    return np.sqrt(eigh(G / size * stiffness, np.diag(mass), eigvals_only=True)[:3])


def test_taut_sagging_cable_vibrates_as_irvine_and_caughey_say(one_line):
    span, mass, tension, EA = 100.0, 1.0, 2.0e4, 2.0e6
    sag = mass * G * span**2 / (8 * tension)
    effective = span * (1 + 8 * (sag / span) ** 2)
    irvine = (mass * G * span / tension) ** 2 * span / (tension * effective / EA)
    # the inextensible parabola's length less the elastic stretch gives the wanted horizontal tension
    parabola = span * (1 + 8 / 3 * (sag / span) ** 2 - 32 / 5 * (sag / span) ** 4)
    length = parabola / (1 + tension * effective / (EA * span))
    kind = {"mass": mass, "diameter": 0.02, "EA": EA}
    scene = one_line(length, 100, [0.0] * 3, [span, 0.0, 0.0], kind, {"weight": {}})
    pose = equilibrium(scene)
    level = pose.tension * np.diff(pose.positions[:, 0]) / np.linalg.norm(np.diff(pose.positions, axis=0), axis=1)
    assert level[0] == pytest.approx(tension, rel=3e-4)
    base = np.sqrt(level[0] * (1 + tension / EA) / mass) / span  # mass per stretched length
    odd = brentq(lambda w: np.tan(w / 2) - w / 2 + 4 / irvine * (w / 2) ** 3, np.pi + 1e-9, 3.0 * np.pi - 1e-3)
    modes = natural_modes(build_model(load_scene(scene)), pose.state, 6)
    upright = [m for m in range(6) if np.max(np.abs(modes.shape[m, :, 2])) > 0.5]
    level_modes = [m for m in range(6) if m not in upright]
    assert modes.omega[level_modes[0]] == pytest.approx(np.pi * base, rel=3e-4)  # out of plane: a taut string
    symmetric = [m for m in upright if abs(modes.shape[m, 49, 2]) > 0.5][0]
    assert modes.omega[symmetric] == pytest.approx(odd * base, rel=1e-3)


# --- design -------------------------------------------------------------------------------------------------------


def test_design_finds_the_float_that_carries_a_hanging_chain_at_a_wanted_depth(one_line):
    kind = {"mass": 10.0, "diameter": 0.04, "EA": 1e6}
    scene = one_line(12.0, 6, [0.0, 0.0, -19.0], [0.0, 0.0, -7.0], kind, {"weight": {}}, sea={"depth": 20.0})
    scene["point"][1] = {"name": "b", "kind": "free", "position": [0.0, 0.0, -8.0], "mass": 5.0, "volume": 0.2}
    # wholly under water and vertical, the first link carries the lift less all weights above its middle
    found = solve_design(scene, "point.b.volume", 0.13, 0.5, "tension.line.first", 500.0)
    above = 5.0 + 10.0 * (12.0 - 1.0)  # half of the first link goes to the anchor
    assert found.value == pytest.approx((500.0 + above * G) / (1025.0 * G), rel=1e-8)
    with pytest.raises(SceneError, match="does not include"):
        solve_design(scene, "point.b.volume", 0.4, 0.5, "tension.line.first", 500.0)
