"""Conservation of energy, and orders of convergence against an independent solution of the same equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax.model.work import work_names

DURATION = 1.5
LENGTH = np.array([0.1040, 0.1061, 0.1040, 0.1061, 0.1040, 0.1061, 0.1040])
MASS = np.array([0.0324, 0.0334, 0.0324, 0.0334, 0.0324, 0.0334])
ENDS = np.array([[0.0, 0.0, 0.0], [0.28, 0.0, 0.0]])
SAVES = 6
RELEASES = {"dropper-release-a-undamped": (0.0, 0.0), "dropper-release-a": (0.002, 0.001)}


def links(r):
    return np.diff(np.concatenate([ENDS[:1], r, ENDS[1:]]), axis=0)


def acceleration(r, v, b_l, b_q):
    """M a = F + G' T with T from |d|' ' = 0, G a = -|d'|^2: the equations as an ODE, in NumPy, node by node."""
    force = -b_l * v - b_q * np.linalg.norm(v, axis=1, keepdims=True) * v
    force[:, 2] -= 9.81 * MASS
    d = links(r)
    rate = np.diff(np.concatenate([np.zeros((1, 3)), v, np.zeros((1, 3))]), axis=0)
    g = np.zeros((7, 6, 3))
    for j in range(7):
        if j < 6:
            g[j, j] = d[j]
        if j > 0:
            g[j, j - 1] = -d[j]
    g = g.reshape(7, 18)
    inverse = np.repeat(1 / MASS, 3)
    lagrange = np.linalg.solve(g * inverse @ g.T, -np.sum(rate**2, axis=1) - g * inverse @ force.ravel())
    return (inverse * (force.ravel() + g.T @ lagrange)).reshape(6, 3)


@pytest.fixture(scope="module")
def releases():
    """The undamped and the damped release of the dropper with the link angles that DOP853 finds at `SAVES` times."""
    return {name: release(name, *damping) for name, damping in RELEASES.items()}


def release(scene, b_l, b_q):
    model, s = dj.build(scene)

    def slope(t, y):
        r, v = y.reshape(2, 6, 3)
        return np.concatenate([v, acceleration(r, v, b_l, b_q)]).ravel()

    begin = np.concatenate([np.asarray(s.r), np.zeros((6, 3))]).ravel()
    times = DURATION * np.arange(1, SAVES + 1) / SAVES
    found = solve_ivp(slope, (0, DURATION), begin, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
    r = found.y.T.reshape(SAVES, 2, 6, 3)[:, 0]
    assert max(np.max(np.abs(np.linalg.norm(links(x), axis=1) - LENGTH)) for x in r) < 1e-9
    return model, s, angles(r)


def angles(r):
    d = np.array([links(x) for x in r])
    return np.arctan2(-d[..., 2], d[..., 0])


def order(march, release, integrator, powers, gamma=None):
    """Slope of log(RMS angle error) against log(step), steps 2^-p."""
    model, s, exact = release
    stepper = dj.make_stepper(model, integrator, gamma=gamma, halvings=0, track_work=False)
    errors = []
    for p in powers:
        r = march(stepper, model, s, DURATION, round(DURATION * 2**p), SAVES)[0]
        wrong = angles(r) - exact
        wrong -= 2 * np.pi * np.round(wrong / (2 * np.pi))
        errors.append(np.sqrt(np.mean(wrong**2)))
    return -np.polyfit(powers, np.log2(errors), 1)[0]


@pytest.mark.parametrize(
    ("integrator", "gamma", "powers", "expected", "within"),
    [
        ("energy_momentum", None, (8, 9, 10, 11), 2.0, 0.1),
        ("rattle", None, (8, 9, 10, 11), 2.0, 0.1),
        ("theta_midpoint", 0.51, (10, 11, 12, 13), 1.0, 0.15),
        ("theta", 0.51, (10, 11, 12, 13), 1.0, 0.15),
        ("theta", 1.0, (13, 14, 15, 16), 1.0, 0.2),
        ("semi_implicit_euler", None, (10, 11, 12, 13), 1.0, 0.15),
        ("thesis_angles", 0.51, (11, 12), 1.0, 0.15),
        ("energy_momentum_4", None, (7, 8, 9), 4.0, 0.3),
        ("rattle_4", None, (7, 8, 9), 4.0, 0.3),
    ],
)
def test_scheme_converges_to_the_independent_solution_with_its_order(
    march, releases, integrator, gamma, powers, expected, within
):
    found = order(march, releases["dropper-release-a-undamped"], integrator, powers, gamma)
    assert found == pytest.approx(expected, abs=within)


@pytest.mark.parametrize(
    ("integrator", "powers", "expected", "within"),
    [
        ("energy_momentum", (8, 9, 10), 2.0, 0.1),
        ("rattle", (8, 9, 10), 2.0, 0.1),
        ("theta", (11, 12), 1.0, 0.15),
        ("rattle_4", (7, 8, 9), 4.0, 0.3),
    ],
)
def test_damping_leaves_the_order_as_it_is(march, releases, integrator, powers, expected, within):
    assert order(march, releases["dropper-release-a"], integrator, powers) == pytest.approx(expected, abs=within)


def test_undamped_release_keeps_energy_and_lengths_over_50_seconds():
    solution = dj.simulate("dropper-release-a-undamped", dt=0.01, duration=50.0)
    assert solution.status == "ok"
    assert solution.energy_drift < 1e-9
    assert solution.max_closure_error < 1e-10


def test_undamped_release_keeps_energy_over_10_minutes_at_a_coarse_step():
    solution = dj.simulate("dropper-release-a-undamped", dt=0.02, duration=600.0, save_every=10)
    assert solution.status == "ok"
    assert solution.t[-1] == pytest.approx(600.0)
    assert solution.energy_drift < 1e-6
    assert solution.max_closure_error < 1e-10


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


@pytest.mark.parametrize("scene", ["dropper-release-a-compound-undamped", "string"])
def test_compound_links_and_free_ends_keep_energy_to_rounding(scene):
    solution = dj.simulate(scene, dt=0.01, duration=10.0, halvings=0)
    assert solution.status == "ok"
    assert solution.energy_drift < 1e-10 * solution.energy_scale
    assert solution.max_closure_error < 1e-10


def test_energy_of_a_solution_is_that_of_its_masses_heights_and_speeds():
    """At rest and at the first saved times, from positions alone (central differences for the speed)."""
    solution = dj.simulate("dropper-release-a-undamped", dt=0.0005, duration=0.1)
    r = solution.positions[:, 1:-1]
    speed = np.linalg.norm(r[2:] - r[:-2], axis=-1) / 0.001
    kinetic = 0.5 * np.sum(MASS * speed**2, axis=1)
    potential = 9.81 * np.sum(MASS * r[..., 2], axis=1)
    np.testing.assert_allclose(solution.potential, potential, rtol=1e-12)
    np.testing.assert_allclose(solution.kinetic[1:-1], kinetic, atol=1e-4 * np.max(kinetic))


@pytest.mark.parametrize("integrator", ["theta", "theta_midpoint"])
def test_weights_above_one_half_take_energy_and_implicit_euler_takes_most(march, integrator):
    model, s = dj.build("dropper-release-a-undamped")
    loss = []
    for gamma in (0.6, 1.0):
        stepper = dj.make_stepper(model, integrator, gamma=gamma, halvings=0, track_work=False)
        r, v, _ = march(stepper, model, s, 1.0, 500)
        before, after = (9.81 * np.sum(MASS * z) for z in (s.r[:, 2], r[-1, :, 2]))
        loss.append(before - after - 0.5 * np.sum(MASS[:, None] * v[-1] ** 2))
    assert 0 < loss[0] < loss[1]


def test_midpoint_weighting_of_one_half_is_the_energy_momentum_scheme(march):
    model, s = dj.build("dropper-release-a")
    default = march(dj.make_stepper(model, halvings=0, track_work=False), model, s, 0.5, 128, SAVES // 3)[0]
    weighted = march(
        dj.make_stepper(model, "theta_midpoint", gamma=0.5, halvings=0, track_work=False),
        model,
        s,
        0.5,
        128,
        SAVES // 3,
    )[0]
    np.testing.assert_array_equal(default, weighted)


def test_loss_of_energy_is_the_work_of_the_damping():
    solution = dj.simulate("dropper-release-a", dt=0.01, duration=20.0)
    assert solution.work_names == work_names(dj.build(solution.scene)[0]) == ("linear_damping", "quadratic_damping")
    assert solution.energy_drift < 1e-9
    assert np.all(np.diff(solution.work, axis=0) <= 0)
    assert np.all(np.diff(solution.energy) <= 1e-12)
