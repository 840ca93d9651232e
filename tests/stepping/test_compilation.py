"""The programs of these tests against those of users: compiled in other ways, they give the same numbers."""

import json
import os

import jax
import numpy as np
import pytest

import dropper_jax as dj

#: Two schemes on a damped dropper, short of chaos; a fixed number of iterations, so that both take the same path.
RUNS = [
    {"scene": "dropper-release-a", "integrator": "energy_momentum", "dt": 0.01, "duration": 0.5},
    {"scene": "dropper-release-a", "integrator": "rattle", "dt": 0.002, "duration": 0.5},
]
AS_A_USER = """
import json, sys
import dropper_jax as dj
runs = [dj.simulate(**run) for run in json.loads(sys.argv[1])]
print(json.dumps([[run.status, run.positions.tolist(), run.tension[1:].tolist()] for run in runs]))
"""


@pytest.mark.check
@pytest.mark.skipif(not os.environ.get("XLA_FLAGS"), reason="no quick flags here: tests run what users run")
def test_programs_as_users_compile_them_give_the_same_motion(as_a_user):
    for run, (status, positions, tension) in zip(RUNS, as_a_user(AS_A_USER, json.dumps(RUNS)), strict=True):
        here = dj.simulate(**run)
        assert here.status == status == "ok"
        # rounding of 1e-16, grown by the motion's own sensitivity (46 at 2 s)
        np.testing.assert_allclose(here.positions, positions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(here.tension[1:], tension, rtol=0, atol=1e-9)


@pytest.fixture
def compiled():
    """The durations of the compilations so far."""
    found = []

    def note(event, duration, **_):
        if event.endswith("backend_compile_duration"):
            found.append(duration)

    jax.monitoring.register_event_duration_secs_listener(note)
    yield found
    jax.monitoring.unregister_event_duration_listener(note)


def test_a_run_that_differs_in_values_only_is_not_compiled_again(compiled):
    scene = dj.load_scene("dropper-release-a")
    first = dj.simulate(scene, dt=0.01, duration=0.2)
    compiled.clear()
    other = scene.with_values({"effects.linear_damping.b_l": 0.02, "line.0.mass": 0.3})
    second = dj.simulate(other, dt=0.005, duration=0.1)
    assert (first.status, second.status) == ("ok", "ok")
    assert not np.array_equal(first.positions, second.positions)
    assert compiled == []
    dj.simulate(scene, dt=0.01, duration=0.2, iterations=5)  # a setting of the step is part of the program
    assert compiled


def test_steps_runs_and_gradients_called_without_jit_are_compiled_once(compiled):
    model, start = dj.build("double-pendulum-chaotic")
    stepper = dj.make_stepper(model, "energy_momentum")

    def height(model, dt):
        return dj.integrate(stepper, model, start, dt, steps=4)[1].r[-1, 2, 2]

    def call_each(model, dt):
        state, _ = dj.step(stepper, model, start, dt)
        lengths = dj.step_lengths(stepper, model, start, dt, 4)
        gradient = jax.grad(height)(model, dt)
        return jax.block_until_ready((state, lengths, height(model, dt), gradient))

    heavier = jax.tree.map(lambda x: 1.01 * x, model)
    call_each(model, 0.01)
    compiled.clear()
    call_each(heavier, 0.008)
    assert compiled == []
