"""Schemes that hold their own error: against SciPy, lengths, saved times, corners, derivatives, refusals, stiffness."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax.run.build import equal_steps
from dropper_jax.stepping.controlled import advance_controlled, start_controlled

SCHEMES = ("tsit5", "dop853")

# --- a pendulum whose point moves off, and which a force lets go: m L theta'' = what acts across the link ----------

LENGTH, MASS, DAMPING, PULL = 0.8, 0.3, 0.05, 2.0
MOVES, STOPS, SPEED, LET_GO = 0.213, 0.487, 0.7, 0.3371
PENDULUM = {
    "name": "pendulum",
    "run": {"dt": 0.05, "duration": 1.0},
    "point": [{"name": "top", "position": [0, 0, 0]}, {"name": "bob", "position": [0, 0, 0], "kind": "free"}],
    "line": [{"name": "rod", "from": "top", "to": "bob", "links": 1, "length": LENGTH, "mass": MASS}],
    "effects": {
        "weight": {},
        "linear_damping": {"b_l": DAMPING},
        "nodal_force": {"nodes": [1], "force_n": [[PULL, 0, 0]], "release": LET_GO},
        "end_motion": {
            "point": "top",
            "time": [MOVES, STOPS],
            "displacement": [[0, 0, 0], [SPEED * (STOPS - MOVES), 0, 0]],
        },
    },
    "start": {"kind": "angles", "zero": "down", "polar": [0.4], "azimuth": [0.0]},
}


def pendulum(times):
    """Places of the bob (k, 2) [m], x and z: theta from straight down, the point at x moving at u."""

    def piece(t0, t1, y, u, x0, pulled):
        def slope(t, y):
            theta, rate = y
            across = PULL * pulled * np.cos(theta) - DAMPING * (LENGTH * rate + u * np.cos(theta))
            return [rate, (across / MASS - 9.81 * np.sin(theta)) / LENGTH]

        found = solve_ivp(slope, (t0, t1), y, method="DOP853", rtol=1e-13, atol=1e-14, dense_output=True).sol
        inside = [(t, found(t)[0], x0 + u * (t - t0)) for t in times if t0 < t <= t1]
        return [(x + LENGTH * np.sin(a), -LENGTH * np.cos(a)) for _, a, x in inside], found(t1)

    places, y, x, before = [], np.array([0.4, 0.0]), 0.0, 0.0
    for t0, t1, u, pulled in (
        (0.0, MOVES, 0.0, 1),
        (MOVES, LET_GO, SPEED, 1),
        (LET_GO, STOPS, SPEED, 0),
        (STOPS, times[-1], 0.0, 0),
    ):
        y[1] -= (u - before) * np.cos(y[0]) / LENGTH  # the rod takes the point's jump along itself only
        found, y = piece(t0, t1, y, u, x, pulled)
        places, x, before = places + found, x + u * (t1 - t0), u
    return np.array(places)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_end_where_a_force_lets_go_and_where_a_point_moves_off_and_stops(scheme):
    solution = dj.simulate(PENDULUM, integrator=scheme, error_tolerance=1e-11)
    assert solution.status == "ok"
    exact = pendulum(solution.t[1:])
    assert np.max(np.abs(solution.positions[1:, 1, ::2] - exact)) < 1e-9
    # the work of the point that jumps is booked, so that the balance holds across its jumps
    assert solution.energy_drift < 1e-8 * solution.energy_scale
    assert solution.settings["steps"] < 1200


# --- the release of a dropper -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def released():
    """`released(scheme, tolerance)`: the damped release of a dropper for 1.5 s, its RMS distance from SciPy [m]."""
    exact = independent()

    def find(scheme, tolerance):
        solution = dj.simulate("dropper-release-a", integrator=scheme, error_tolerance=tolerance, dt=0.25, duration=1.5)
        assert solution.status == "ok"
        return solution, float(np.sqrt(np.mean((solution.positions[1:, 1:-1] - exact) ** 2)))

    return find


def independent():
    """Places (6, 6, 3) [m] of the release by SciPy, the tensions from a dense system node by node."""
    model, s = dj.build("dropper-release-a")
    mass = np.array([0.0324, 0.0334, 0.0324, 0.0334, 0.0324, 0.0334])
    ends = np.array([[0.0, 0.0, 0.0], [0.28, 0.0, 0.0]])

    def slope(t, y):
        r, v = y.reshape(2, 6, 3)
        force = -0.002 * v - 0.001 * np.linalg.norm(v, axis=1, keepdims=True) * v - [0, 0, 9.81] * mass[:, None]
        d = np.diff(np.concatenate([ends[:1], r, ends[1:]]), axis=0)
        rate = np.diff(np.concatenate([np.zeros((1, 3)), v, np.zeros((1, 3))]), axis=0)
        g = np.zeros((7, 6, 3))
        for j in range(6):
            g[j, j], g[j + 1, j] = d[j], -d[j + 1]
        g, inverse = g.reshape(7, 18), np.repeat(1 / mass, 3)
        pull = np.linalg.solve(g * inverse @ g.T, -np.sum(rate**2, axis=1) - g * inverse @ force.ravel())
        return np.concatenate([v.ravel(), inverse * (force.ravel() + g.T @ pull)])

    begin = np.concatenate([np.asarray(s.r).ravel(), np.zeros(18)])
    times = 0.25 * np.arange(1, 7)
    found = solve_ivp(slope, (0, 1.5), begin, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
    return found.y.T.reshape(6, 2, 6, 3)[:, 0]


@pytest.mark.parametrize(("scheme", "order", "tolerances"), [("tsit5", 5, (1e-5, 1e-9)), ("dop853", 8, (1e-5, 1e-9))])
def test_the_error_follows_the_tolerance_and_the_steps_its_root(released, scheme, order, tolerances):
    (coarse, far), (fine, near) = (released(scheme, tolerance) for tolerance in tolerances)
    # chaos has made errors some ten times larger by the end
    assert far < 100 * tolerances[0]
    assert near < 100 * tolerances[1]
    decades = np.log10(fine.settings["steps"] / coarse.settings["steps"])
    assert 4 / decades > order - 1.0
    assert np.log10(far / near) / decades > order - 1.5


@pytest.mark.parametrize("scheme", SCHEMES)
def test_states_at_saved_times_do_not_depend_on_their_spacing(released, scheme):
    wide, _ = released(scheme, 1e-9)
    close = dj.simulate("dropper-release-a", integrator=scheme, error_tolerance=1e-9, dt=0.01, duration=1.5)
    assert close.settings["steps"] in range(wide.settings["steps"] - 2, wide.settings["steps"] + 3)
    np.testing.assert_allclose(close.t, 0.01 * np.arange(151), rtol=1e-14)
    np.testing.assert_array_equal(close.t_tension, close.t)
    for name in ("positions", "velocities", "tension", "work"):
        np.testing.assert_allclose(getattr(close, name)[::25], getattr(wide, name), atol=2e-7, err_msg=name)
    # velocities are the rates of places, by differences over 0.02 s, whose error is h^2/6 of the third derivative
    slopes = (close.positions[2:] - close.positions[:-2]) / 0.02
    assert np.sqrt(np.mean((slopes - close.velocities[1:-1]) ** 2)) < 0.02 * close.max_speed


@pytest.mark.parametrize(("scheme", "tolerance"), [("tsit5", 1e-3), ("dop853", 1e-8)])
def test_lengths_and_energy_hold_over_50_s_without_damping(scheme, tolerance):
    solution = dj.simulate(
        "dropper-release-a-undamped", integrator=scheme, error_tolerance=tolerance, dt=0.05, duration=50.0
    )
    assert solution.status == ("energy_drift" if tolerance == 1e-3 else "ok")  # that one loses more than a tenth
    assert solution.max_closure_error < (1e-6 if tolerance == 1e-3 else 1e-13)
    assert solution.energy_drift < 300 * tolerance * solution.energy_scale


def test_a_summary_tells_the_steps_taken_and_refused(released):
    solution, _ = released("tsit5", 1e-5)
    summary = solution.summary()
    assert summary["error_tolerance"] == 1e-5
    assert summary["steps"] > 50
    assert summary["refused_steps"] >= 0
    assert summary["us_per_step"] == 1e6 * solution.run_s / (summary["steps"] + summary["refused_steps"])
    again = solution.rerun()
    np.testing.assert_array_equal(again.positions, solution.positions)


def test_motion_without_bounds_is_no_success():
    start = {"kind": "positions", "positions": [[0, 0, 0], [0, 0, -LENGTH]], "velocities": [[0, 0, 0], [1e160, 0, 0]]}
    solution = dj.simulate({**PENDULUM, "effects": {"weight": {}}, "start": start}, integrator="dop853")
    assert solution.status == "non_finite"
    assert solution.first_bad["time_s"] == 0.0
    assert len(solution.t) == 1


# --- what it is not for -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "changed", "words"),
    [
        ("paper-case-1", {}, "it runs single lines only; use energy_momentum"),
        ("dropper-release-a-compound", {}, "compound links couple them; use energy_momentum"),
        ("dropper-current", {}, "the scene has added mass; use energy_momentum"),
        ("measured-single-pendulum", {}, "use energy_momentum"),
        ("dropper-release-a", {"run.solver": "dense"}, "run.solver: 'dense' is given, but integrator 'dop853'"),
        ("dropper-release-a", {"run.error_tolerance": 1e-15}, "is below the resolution of float64"),
        ("dropper-release-a", {"run.error_tolerance": 0.0}, "run.error_tolerance: 0.0 is out of range"),
        (
            "dropper-release-a",
            {"run.integrator": "rattle", "run.error_tolerance": 1e-6},
            "integrator 'rattle' takes equal steps. Use it with tsit5 or dop853",
        ),
    ],
)
def test_what_it_is_not_for_is_refused_with_what_to_take(scene, changed, words):
    with pytest.raises(dj.SceneError, match=words):
        dj.simulate(dj.load_scene(scene).with_values({"run.integrator": "dop853", **changed}))


def test_a_line_that_stretches_is_refused_with_what_to_take(falling):
    with pytest.raises(dj.SceneError, match="the line is elastic; use energy_momentum, rk2 or rk4"):
        dj.simulate(falling(period=0.008, dt=0.02, duration=0.1), integrator="tsit5")


def test_studies_of_equal_steps_refuse_schemes_that_hold_their_own_error():
    scene = dj.load_scene("dropper-release-a").with_values({"run.integrator": "tsit5"})
    with pytest.raises(
        dj.SceneError, match="run.integrator: 'tsit5' controls its own error, but equal steps are needed"
    ):
        equal_steps(dj.build_model(scene), scene.run)


def test_an_accuracy_is_the_tolerance_of_a_step():
    runs = [dj.simulate("dropper-release-a", integrator="tsit5", duration=0.2, accuracy=a) for a in (0.1, 0.001)]
    assert [run.settings["error_tolerance"] for run in runs] == pytest.approx([1e-4, 1e-6])
    assert runs[0].settings["steps"] < runs[1].settings["steps"]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_damping_that_holds_the_steps_is_named_with_what_to_take(scheme):
    scene = dj.load_scene(PENDULUM).with_values({"effects.linear_damping.b_l": 300.0})
    stiff = dj.simulate(scene, integrator=scheme, duration=0.5)
    assert stiff.status == "ok"
    (told,) = (text for text in stiff.warnings if "linear_damping" in text)
    assert "damping, not the error, limits the steps. Use energy_momentum" in told
    # steps end up where h b/m is what the scheme bears
    assert 0.5 < stiff.settings["steps"] / (0.5 * 1000.0 / {"tsit5": 3.0, "dop853": 6.0}[scheme]) < 2.0
    calm = dj.simulate(PENDULUM, integrator=scheme)
    assert not any("limits the steps" in text for text in calm.warnings)


# --- derivatives --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def walk(both_modes):
    """A number of a run by its let-go force and damping: along steps taken before, by choosing them; and these."""
    model, start = dj.build(PENDULUM)
    stepper = dj.make_stepper(model, "tsit5")
    tolerance, dt, saves = jnp.asarray(1e-5), jnp.asarray(0.05), 20
    steps = jax.jit(partial(dj.controlled_steps, stepper, most=128))(model, start, 1.0, tolerance)

    def changed(p):
        new = {"nodal_force": {"release": p[0]}, "linear_damping": {"b_l": p[1]}}
        effects = tuple(replace(e, **new.get(e.name, {})) for e in model.effects)
        return replace(model, effects=effects)

    def told(path):
        return path.r[-1, 0, 0] + path.work[-1, 0] + path.tension[9, 0]

    def along(p):
        return told(dj.integrate_along(stepper, changed(p), start, steps, dt, saves)[1])

    def choosing(p):
        seen = changed(p)
        carry = start_controlled(stepper, seen, start, tolerance)
        return told(advance_controlled(stepper, seen, carry, dt, tolerance, saves)[1][0])

    # value and forward mode in one program
    pushed = jax.jit(lambda p, way: jax.jvp(choosing, (p,), (way,)))
    return SimpleNamespace(steps=steps, along=both_modes(along), push_choosing=pushed)


AT, EACH = np.array([LET_GO, DAMPING]), np.eye(2)


@pytest.mark.slow
def test_derivatives_are_those_along_the_steps_in_both_modes_corners_that_move_included(walk):
    assert int(walk.steps.number) < 128
    assert int(walk.steps.corner.sum()) == 3
    exact = [float(walk.along(AT + 1e-6 * e)[0] - walk.along(AT - 1e-6 * e)[0]) / 2e-6 for e in EACH]
    _, reverse, forward = walk.along(AT)
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(reverse, exact, rtol=1e-6)


@pytest.mark.check
def test_a_run_that_chooses_its_steps_has_the_derivatives_of_one_along_them(walk):
    expected, _, forward = walk.along(AT)
    for e, exact in zip(EACH, forward, strict=True):
        value, slope = walk.push_choosing(AT, e)
        assert float(value) == pytest.approx(float(expected), abs=1e-13)
        assert float(slope) == pytest.approx(float(exact), rel=1e-6)
