"""Schemes with an embedded error: against SciPy, lengths, saved times, corners, derivatives, refusals, stiffness."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from release_by_scipy import release
from scipy.integrate import solve_ivp

import dropper_jax as dj
from dropper_jax.stepping.integrate import advance
from dropper_jax.stepping.progress import begin

SCHEMES = ("tsit5", "dop853")

# --- a pendulum whose point moves off, and which a force lets go: m L theta'' = what acts across the link ----------

LENGTH, MASS, DAMPING, PULL = 0.8, 0.3, 0.05, 2.0
MOVES, STOPS, SPEED, LET_GO = 0.213, 0.487, 0.7, 0.3371
PENDULUM = {
    "name": "pendulum",
    "run": {"accuracy": 0.01, "save_interval": 0.05, "duration": 1.0},
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
def test_steps_end_where_a_force_is_released_and_where_a_point_starts_and_stops(scheme):
    solution = dj.simulate(PENDULUM, integrator=scheme, accuracy=1e-8)
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
    exact = release(dj.build("dropper-release-a")[1].r, 0.002, 0.001, 0.25 * np.arange(1, 7))

    def find(scheme, tolerance):
        run = {"save_interval": 0.25, "duration": 1.5, **follow(tolerance)}
        solution = dj.simulate("dropper-release-a", integrator=scheme, **run)
        assert solution.status == "ok"
        return solution, float(np.sqrt(np.mean((solution.positions[1:, 1:-1] - exact) ** 2)))

    return find


def follow(tolerance):
    """The accuracy that allows an error of a step [m], [m/s]."""
    return {"accuracy": 1000.0 * tolerance}


@pytest.mark.check
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
    close = dj.simulate("dropper-release-a", integrator=scheme, **follow(1e-9), save_interval=0.01, duration=1.5)
    assert close.settings["steps"] >= wide.settings["steps"]  # steps end at the saved times
    np.testing.assert_allclose(close.t, 0.01 * np.arange(151), rtol=1e-14)
    np.testing.assert_allclose(close.t_tension[1:], close.t[1:] - 0.005, rtol=1e-12)
    for name in ("positions", "velocities", "work"):
        np.testing.assert_allclose(getattr(close, name)[::25], getattr(wide, name), atol=2e-7, err_msg=name)
    # tensions are means over the intervals
    means = np.mean(close.tension[1:].reshape(-1, 25, close.tension.shape[1]), axis=1)
    np.testing.assert_allclose(means, wide.tension[1:], rtol=0.02)
    # velocities are the rates of places, by differences over 0.02 s, whose error is h^2/6 of the third derivative
    slopes = (close.positions[2:] - close.positions[:-2]) / 0.02
    assert np.sqrt(np.mean((slopes - close.velocities[1:-1]) ** 2)) < 0.02 * close.max_speed


@pytest.mark.parametrize(("scheme", "tolerance"), [("tsit5", 1e-3), ("dop853", 1e-8)])
def test_lengths_and_energy_hold_over_50_s_without_damping(scheme, tolerance):
    solution = dj.simulate(
        "dropper-release-a-undamped", integrator=scheme, **follow(tolerance), save_interval=0.05, duration=50.0
    )
    assert solution.status == "ok"
    assert solution.max_closure_error < (1e-6 if tolerance == 1e-3 else 1e-13)
    assert solution.energy_drift < 300 * tolerance * solution.energy_scale


def test_a_summary_has_the_steps_taken_and_refused(released):
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
    assert 0.0 < solution.first_bad["time_s"] <= 0.05
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
        ("dropper-release-a", {"run.integrator": "rattle", "run.accuracy": 0.01}, "which integrator 'rattle' has not"),
    ],
)
def test_what_it_is_not_for_is_refused_with_what_to_take(scene, changed, words):
    with pytest.raises(dj.SceneError, match=words):
        dj.simulate(dj.load_scene(scene).with_values({"run.integrator": "dop853", **changed}))


@pytest.mark.parametrize("key", ["tolerance", "step_tolerance", "error_tolerance"])
def test_a_key_that_an_accuracy_replaces_is_refused_with_what_to_take(key):
    run = {**PENDULUM["run"], key: 1e-6}
    with pytest.raises(dj.SceneError, match=f"run.{key}: no longer exists. Use run.accuracy"):
        dj.load_scene({**PENDULUM, "run": run})


def test_a_line_that_stretches_is_refused_with_what_to_take(falling):
    with pytest.raises(dj.SceneError, match="the line is elastic; use energy_momentum, rk2 or rk4"):
        dj.simulate(falling(period=0.008, dt=0.02, duration=0.1), integrator="tsit5")


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_step_given_by_the_user_is_taken(scheme):
    run = dj.simulate("dropper-release-a", integrator=scheme, dt=0.005, duration=0.2)
    assert run.status == "ok"
    assert run.settings["steps"] == 40
    assert "refused_steps" not in run.settings


def test_an_accuracy_is_the_tolerance_of_a_step():
    runs = [dj.simulate("dropper-release-a", integrator="tsit5", duration=0.2, accuracy=a) for a in (0.1, 0.001)]
    assert [run.settings["error_tolerance"] for run in runs] == pytest.approx([1e-4, 1e-6])
    assert runs[0].settings["steps"] < runs[1].settings["steps"]


@pytest.mark.check
@pytest.mark.parametrize("scheme", SCHEMES)
def test_damping_that_holds_the_steps_is_named_with_what_to_take(scheme):
    scene = dj.load_scene(PENDULUM).with_values({"effects.linear_damping.b_l": 300.0})
    stiff = dj.simulate(scene, integrator=scheme, duration=0.5)
    assert stiff.status == "ok"
    (reported,) = (text for text in stiff.warnings if "linear_damping" in text)
    assert "damping, not the error, limits the steps. Use energy_momentum" in reported
    # steps end up where h b/m is what the scheme bears
    assert 0.5 < stiff.settings["steps"] / (0.5 * 1000.0 / {"tsit5": 3.0, "dop853": 6.0}[scheme]) < 2.0
    calm = dj.simulate(PENDULUM, integrator=scheme)
    assert not any("limits the steps" in text for text in calm.warnings)


# --- derivatives --------------------------------------------------------------------------------------------------


STEPPER = dj.make_stepper(dj.build(PENDULUM)[0], "tsit5")
AT, EACH = np.array([LET_GO, DAMPING]), np.eye(2)


def changed(model, p):
    """The model with another release and damping."""
    new = {"nodal_force": {"release": p[0]}, "linear_damping": {"b_l": p[1]}}
    return replace(model, effects=tuple(replace(e, **new.get(e.name, {})) for e in model.effects))


@pytest.mark.check
def test_a_run_along_the_steps_that_it_took_has_derivatives_in_both_modes(slopes_of):
    model, start = dj.build(PENDULUM)
    steps = dj.step_lengths(STEPPER, model, start, 0.05, 20, accuracy=0.01, most=128)
    lengths = steps.length
    number = int(steps.ends[-1])
    assert 20 < number < 128
    ends = np.cumsum(lengths[:number])
    for corner in (MOVES, LET_GO, STOPS):
        assert np.min(np.abs(ends - corner)) < 1e-12

    def along(damping):
        path = dj.integrate(STEPPER, changed(model, [LET_GO, damping[0]]), start, lengths[:number], number)[1]
        return path.r[-1, 0, 0] + path.work[-1, 0]

    slopes_of(along, AT[1:], 1e-6)


@pytest.mark.check
def test_a_run_that_chooses_its_steps_has_derivatives_by_damping_and_by_the_time_of_a_release():
    model, start = dj.build(PENDULUM)

    def end(p, accuracy):
        other = changed(model, p)
        carry = begin(STEPPER, other, start, follows=True)
        path = advance(STEPPER, other, carry, jnp.asarray(0.05), 20, accuracy=jnp.asarray(accuracy))[1]
        return path.r[-1, 0, 0] + path.work[-1, 0]

    slope = jax.jit(lambda p, way: jax.jvp(lambda p: end(p, 1e-6), (p,), (way,))[1])
    value = jax.jit(lambda p: end(p, 1e-8))
    for e in EACH:
        difference = float(value(AT + 1e-4 * e) - value(AT - 1e-4 * e)) / 2e-4
        assert float(slope(AT, e)) == pytest.approx(difference, rel=1e-4)
