"""What single schemes keep, and closed forms they follow."""

import numpy as np
import pytest

import dropper_jax as dj

G = 9.81


def circle_error(solution):
    radius = np.linalg.norm(solution.positions[:, 1, :2], axis=-1)
    height = np.max(np.abs(solution.positions[:, 1, 2] + np.sin(np.pi / 8)))
    return max(np.max(np.abs(radius - np.cos(np.pi / 8))), height)


def test_rattle_keeps_the_circle_at_the_rate_that_its_own_difference_equations_ask_for():
    """A steady turn by a per step: v_h = 2 R sin(a/2)/h, 4 R sin^2(a/2)/h^2 = w^2 R, v = R sin(a)/h.

    So v = R w sqrt(1 - (h w/2)^2), below the exact rate w by its second-order error.
    """
    h, rate = 0.01, np.sqrt(G / np.sin(np.pi / 8))
    own = rate * np.sqrt(1 - (h * rate / 2) ** 2)
    scene = dj.load_scene("conical-pendulum").with_values({"start.azimuth_rate": [own]})
    assert circle_error(dj.simulate(scene, integrator="rattle", dt=h)) < 1e-9


@pytest.mark.check
def test_fourth_order_rattle_keeps_energy_bounded_and_lengths_to_rounding():
    """Symplectic and symmetric: half the step takes a sixteenth of the energy error, which does not grow with time."""
    swings = []
    for dt in (0.004, 0.002):
        solution = dj.simulate("dropper-release-a-undamped", integrator="rattle_4", dt=dt, duration=8.0)
        assert solution.status == "ok"
        assert solution.max_closure_error < 1e-10
        early, late = (np.ptp(half) for half in np.array_split(solution.energy, 2))
        assert late < 3 * early
        swings.append(np.ptp(solution.energy))
    assert swings[1] < swings[0] / 8


@pytest.mark.check
def test_energy_momentum_4_has_order_four_on_lines_that_stretch():
    x = np.linspace(0.0, 3.0, 5)
    nodes = np.stack([x, 0.1 * x, -0.4 * np.sin(np.pi * x / 3.0)], axis=1)
    rope = {"length": 0.8, "mass": 0.5, "axial": {"law": "elastic", "EA": 3000.0, "damping": 5.0}}
    scene = {
        "run": {"dt": 0.001, "duration": 0.2, "integrator": "energy_momentum_4"},
        "point": [{"name": name, "position": list(nodes[i])} for name, i in (("a", 0), ("b", -1))],
        "line": [{"name": "rope", "from": "a", "to": "b", "links": 4, **rope}],
        "effects": {"weight": {}},
        "start": {"kind": "positions", "positions": nodes.tolist()},
    }
    last = [dj.simulate(scene, dt=h).positions[-1] for h in (0.004, 0.002, 0.001, 0.00025)]
    coarse, middle, fine = (np.max(np.abs(one - last[-1])) for one in last[:-1])
    assert np.log2([coarse / middle, middle / fine]) == pytest.approx([4.0, 4.0], abs=0.3)


def test_a_mass_on_an_elastic_link_rings_at_its_closed_form_frequency_by_rk4(march, chain):
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


def test_thesis_scheme_in_angles_has_the_right_sign_of_the_coriolis_term(march, motion):
    """First order: halving the step halves the error in space; a wrong sign would leave it as it is."""
    model, s, exact = motion("double, spherical")
    stepper = dj.make_stepper(model, "thesis_angles", gamma=0.51, halvings=0, track_work=False)
    error = [np.max(np.abs(march(stepper, model, s, 1.0, steps)[0][-1] - exact[0])) for steps in (4000, 8000)]
    assert error[1] < 5e-3
    assert error[0] / error[1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.check
def test_theta_midpoint_with_one_half_is_the_energy_momentum_scheme(march):
    model, s = dj.build("dropper-release-a")
    default = march(dj.make_stepper(model, halvings=0, track_work=False), model, s, 0.5, 128, 2)[0]
    weighted = march(
        dj.make_stepper(model, "theta_midpoint", gamma=0.5, halvings=0, track_work=False),
        model,
        s,
        0.5,
        128,
        2,
    )[0]
    np.testing.assert_array_equal(default, weighted)
