"""One step from a state as `build` makes it, without what a scheme adds to a state at the start of a run."""

import jax
import numpy as np
import pytest

import dropper_jax as dj

ROPE = {
    "run": {"dt": 0.005, "duration": 1.0},
    "point": [
        {"name": "a", "position": [0.0, 0.0, 0.0]},
        {"name": "b", "kind": "free", "position": [0.6, 0.0, 0.0]},
    ],
    "line": [
        {"name": "d", "from": "a", "to": "b", "links": 2, "length": 0.3, "mass": 0.03}
        | {"axial": {"law": "rope", "EA": 50.0}}
    ],
    "effects": {"weight": {}},
    "start": {"kind": "positions", "positions": [[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.6, 0.0, 0.0]]},
}
STEP = 0.002


def two_steps(stepper, model, s):
    """Two steps by `dj.step` in a loop of the user, and by `dj.integrate`."""
    own = jax.jit(lambda s: jax.lax.fori_loop(0, 2, lambda _, s: dj.step(stepper, model, s, STEP)[0], s))(s)
    return own, dj.integrate(stepper, model, s, STEP, 2)[0]


@pytest.mark.check
def test_thesis_angles_steps_from_a_built_state():
    model, s = dj.build("dropper-release-a")
    own, run = two_steps(dj.make_stepper(model, "thesis_angles", gamma=0.51), model, s)
    np.testing.assert_allclose(own.r, run.r, atol=1e-12)
    np.testing.assert_allclose(own.v, run.v, atol=1e-10)


def test_generalized_alpha_steps_from_a_built_state_with_its_acceleration():
    """A horizontal rope that is released falls freely: v = -g t, exactly, until its links turn."""
    model, s = dj.build(ROPE)
    stepper = dj.make_stepper(model, "generalized_alpha")
    one, _ = dj.step(stepper, model, s, STEP)
    run, _ = dj.integrate(stepper, model, s, STEP, 1)
    np.testing.assert_allclose(one.v, run.v, atol=1e-12)
    np.testing.assert_allclose(one.v[:, 2], -9.81 * STEP, rtol=1e-3)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"integrator": "rk4", "iterations": 3}, "iterations: are given, but integrator 'rk4' solves nothing"),
        ({"iterations": 0}, "iterations: 0 is out of range; allowed: 1 or more corrections"),
        ({"halvings": 1.5}, "halvings: 1.5 is out of range; allowed: 0 or more halvings"),
        ({"tolerance": np.nan}, "residual_tolerance: nan is out of range; allowed: a number >= 0"),
    ],
)
def test_settings_of_a_step_that_have_no_meaning_are_refused_in_one_line(settings, reason, refusal):
    assert refusal(dj.make_stepper, dj.build_model(ROPE), **settings).startswith(reason)


@pytest.mark.parametrize("call", [dj.make_stepper, dj.simulate])
def test_a_setting_that_does_not_exist_is_refused_in_one_line(call):
    scene = dj.build_model("dropper-release-a") if call is dj.make_stepper else "dropper-release-a"
    with pytest.raises(dj.SceneError, match="^iteration: unknown setting; did you mean 'iterations'\\?$"):
        call(scene, iteration=3)
