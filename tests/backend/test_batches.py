"""Batches, one after another or side by side: each member is the single run that it would be alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax.backend.batches import map_members
from dropper_jax.backend.one_kernel import one_kernel
from dropper_jax.lanes import lanes
from dropper_jax.stepping.integrate import advance, integrate
from dropper_jax.stepping.progress import begin

X = np.linspace(0.3, 2.0, 5 * 4).reshape(5, 4)
#: Steps [s]: the third one is halved, the last is not a number.
STEPS = jnp.array([0.005, 0.01, 0.4, jnp.nan])


@pytest.mark.parametrize(("backend", "together"), [("cpu", None), ("gpu", None), ("gpu", 2)])
def test_members_are_those_of_vmap(monkeypatch, backend, together):
    def f(x, c, y):
        return {"sum": x @ c, "loop": jax.lax.while_loop(lambda a: a < 10.0, lambda a: a * (1.1 + y[0]), x[0])}

    axes = (0, None, 0)
    expected = jax.vmap(f, axes)(X, X[0], X)
    with monkeypatch.context() as patched:
        patched.setattr(jax, "default_backend", lambda: backend)
        found = map_members(f, axes, together)(X, X[0], X)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-14)


@pytest.fixture(scope="module")
def dropper():
    """Model, start and stepper of two links."""
    model, start = dj.build(dj.load_scene("double-pendulum-periodic"))
    return model, start, dj.make_stepper(model, "rattle", track_work=False)


@pytest.mark.parametrize("batch", [map_members, lanes])
def test_a_member_that_halves_its_steps_and_one_that_fails_leave_the_others_unchanged(dropper, batch):
    model, start, stepper = dropper

    def run(dt):
        _, saved = advance(stepper, model, begin(stepper, model, start), dt, saves=6)
        return saved.r[-1], jnp.sum(saved.retried), saved.first_bad[-1]

    r, retried, first_bad = one_kernel(batch(run))(STEPS)
    alone = jax.jit(run)
    for i, dt in enumerate(STEPS[:3]):
        expected, again, bad = alone(dt)
        np.testing.assert_allclose(r[i], expected, rtol=0, atol=1e-12)
        assert (retried[i], first_bad[i]) == (again, bad)
    assert list(first_bad) == [-1, -1, -1, 0]
    assert list(retried > 0) == [False, False, True, True]


@pytest.mark.check
def test_derivatives_of_a_batch_are_those_of_single_runs(dropper):
    model, start, stepper = dropper

    def height(dt):
        return integrate(stepper.plain, model, start, dt, 6, warn=False)[0].r[-1, 2]

    steps = STEPS[:2]
    found = jax.grad(lambda steps: jnp.sum(map_members(height)(steps)))(steps)
    expected = [jax.jacfwd(height)(dt) for dt in steps]
    np.testing.assert_allclose(found, expected, rtol=1e-10)
