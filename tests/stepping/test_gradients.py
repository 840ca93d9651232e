"""Derivatives of a run: forward, reverse, differences, unrolled Newton, batches, halved steps, memory."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax import Line, Model, Point, state
from dropper_jax.effects import LinearDamping, QuadraticDamping, Weight
from dropper_jax.model import Graph, Member

DT = 0.005
MODEL, START = dj.build("dropper-release-a")
LOADS = jnp.zeros((6, 3)).at[0, 2].set(1.055338704)
RNG = np.random.default_rng(3)
WEIGHTS = jnp.asarray(RNG.normal(size=(6, 3)))
LINE = MODEL.lines[0]
PARAMETERS = {
    "b_l": jnp.asarray(0.002),
    "b_q": jnp.asarray(0.001),
    "mass": LINE.mass,
    "length": LINE.length,
    "end": jnp.asarray([0.28, 0.0, 0.0]),
    "shift": jnp.zeros((6, 3)),  # of the initial positions
    "speed": jnp.asarray(0.05 * RNG.normal(size=(6, 3))),
}


def model_of(p):
    points = (MODEL.points[0], Point(p["end"], "right", "fixed"))
    line = Line(
        p["length"],
        p["mass"],
        Graph((Member("line", p["length"].shape[-1], 0, 1, far=True),), (True, True), is_path=True),
    )
    return Model(points, (line,), (Weight(jnp.asarray(9.81)), LinearDamping(p["b_l"]), QuadraticDamping(p["b_q"])))


def start_of(p):
    """The lifted pose of the changed line, let go with the given speeds."""
    s = dj.settle(model_of(p), START, LOADS)
    return replace(s, r=s.r + p["shift"], v=p["speed"], work=jnp.zeros(2))


def scalar(stepper, p, steps=200, dt=DT, checkpoint=False):
    """Something of positions, velocities, tensions and work at all times, not symmetric in the nodes."""
    last, run = dj.integrate(stepper, model_of(p), start_of(p), dt, steps, 1, checkpoint)
    return jnp.mean(jnp.sum(WEIGHTS * run.r, (1, 2)) ** 2) + jnp.sum(WEIGHTS * last.v) + jnp.mean(run.tension[:, 2])


#: More iterations than a run needs, so that differences are not limited by the tolerance of a step.
EXACT = dj.make_stepper(model_of(PARAMETERS), iterations=24).plain
FLAT, UNRAVEL = ravel_pytree(PARAMETERS)
GROUPS = np.concatenate([[key] * PARAMETERS[key].size for key in sorted(PARAMETERS)])


def flat(function):
    return lambda x: function(UNRAVEL(x))


def differences(function, directions, step=1e-4):
    """Central differences of two step sizes, extrapolated: along the rows of `directions`."""
    sizes = np.array([step, -step, 2 * step, -2 * step])
    points = FLAT + (sizes[:, None, None] * directions).reshape(-1, FLAT.size)
    f = jax.lax.map(jax.jit(flat(function)), points).reshape(4, -1)
    return (4 * (f[0] - f[1]) / (2 * step) - (f[2] - f[3]) / (4 * step)) / 3


@pytest.fixture(scope="module")
def over_a_second(both_modes):
    """`f(x)`: value, reverse and forward mode over one second."""
    return both_modes(flat(partial(scalar, EXACT)))


def test_forward_and_reverse_agree_in_all_parameters(over_a_second):
    _, gradient, forward = (np.asarray(x) for x in over_a_second(FLAT))
    for group in PARAMETERS:
        mine = gradient[group == GROUPS]
        np.testing.assert_allclose(mine, forward[group == GROUPS], rtol=1e-9, atol=1e-9 * np.abs(mine).max())


def test_gradient_is_that_of_central_differences_over_one_second(over_a_second):
    """One direction of each group with a relative step of 1e-4 (of the size of a link, of 0.1 m/s for the state)."""
    size = np.abs(np.asarray(FLAT)) * np.where(GROUPS == "speed", 0.0, 1.0)
    size += np.where(GROUPS == "shift", 0.1, 0.0) + np.where(GROUPS == "speed", 0.1, 0.0)
    size[GROUPS == "end"] = 0.28
    random = size * np.random.default_rng(5).uniform(0.2, 1.0, FLAT.size)
    directions = np.array([random * (group == GROUPS) for group in PARAMETERS])
    expected = differences(partial(scalar, EXACT), directions, 1e-4)
    np.testing.assert_allclose(directions @ np.asarray(over_a_second(FLAT)[1]), expected, rtol=1e-6)


def test_gradient_is_that_of_unrolled_dense_newton():
    """The step's residual rows solved by plain Newton with the dense Jacobian, differentiated through."""
    scheme, steps = dj.INTEGRATORS["energy_momentum"](), 30

    def unrolled(p):
        model = model_of(p)

        def step(s, _):
            problem = scheme.problem(model, s, jnp.asarray(DT))
            guess, unravel = ravel_pytree(problem.guess())

            def rows(u):
                return ravel_pytree(problem.residual(unravel(u)))[0]

            def newton(u, _):
                return u - jnp.linalg.solve(jax.jacfwd(rows)(u), rows(u)), None

            s = problem.finish(unravel(jax.lax.scan(newton, guess, None, length=7)[0]))
            return s, s

        last, run = jax.lax.scan(step, start_of(p), None, length=steps)
        mean = jnp.mean(jnp.sum(WEIGHTS * run.r, (1, 2)) ** 2)
        return mean + jnp.sum(WEIGHTS * last.v) + jnp.mean(run.tension[:, 2])

    expected = jax.jit(jax.grad(flat(unrolled)))(FLAT)
    found = jax.jit(jax.grad(flat(partial(scalar, EXACT, steps=steps))))(FLAT)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


# --- the same on a loop of three links, which compiles faster --------------------------------------------------

SMALL = {
    "b_l": jnp.asarray(0.002),
    "b_q": jnp.asarray(0.001),
    "mass": jnp.asarray([0.03, 0.04, 0.03]),
    "length": jnp.asarray([0.1, 0.12, 0.1]),
    "end": jnp.asarray([0.2, 0.0, 0.0]),
    "speed": jnp.asarray([[0.25, 0.1, -0.15], [0.05, -0.2, 0.3]]),
}
SMALL_FLAT, SMALL_UNRAVEL = ravel_pytree(SMALL)
SMALL_START = state(model_of(SMALL), [[0.04, 0.0, -(0.0084**0.5)], [0.16, 0.0, -(0.0084**0.5)]])


def small_end(stepper, p, steps=40, dt=DT, checkpoint=False):
    """The start stays where it is as lengths and the end change: the first step mends that, smoothly."""
    s = replace(SMALL_START, v=p["speed"])
    last, run = dj.integrate(stepper, model_of(p), s, dt, steps, 1, checkpoint)
    weights = WEIGHTS[:2]
    return jnp.mean(jnp.sum(weights * run.r, (1, 2)) ** 2) + jnp.sum(weights * last.v) + jnp.mean(run.tension[:, 1])


def small_flat(function):
    return jax.jit(lambda x: function(SMALL_UNRAVEL(x)))


def check_all_ways(run, step=5e-4):
    """Reverse = forward to 1e-9, and = extrapolated central differences to 1e-6 in each group of parameters."""
    _, reverse, forward = (np.asarray(x) for x in run(SMALL_FLAT))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * np.abs(reverse).max())
    groups = np.concatenate([[key] * SMALL[key].size for key in sorted(SMALL)])
    for group in SMALL:
        direction = np.where(groups == group, np.asarray(SMALL_FLAT), 0.0)
        # relative steps where rounding (1e-13 / h, against which 1e-9 has to stand) and the error in h^4 are both small
        f = [run(SMALL_FLAT + h * direction)[0] for h in (step, -step, 2 * step, -2 * step)]
        expected = float((4 * (f[0] - f[1]) / (2 * step) - (f[2] - f[3]) / (4 * step)) / 3)
        assert direction @ reverse == pytest.approx(expected, rel=1e-6, abs=1e-9), group


@pytest.mark.check
def test_gradients_under_vmap_are_those_of_each_member():
    stepper = dj.make_stepper(model_of(SMALL), iterations=24).plain

    def one(b):
        return small_end(stepper, SMALL | {"b_l": b[0], "b_q": b[1]})

    b = jnp.asarray([[0.002, 0.001], [0.01, 0.0], [0.0, 0.02]])
    single = jax.jit(jax.grad(one))
    alone = np.array([single(x) for x in b])
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(one)))(b), alone, rtol=1e-10)
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.jacfwd(one)))(b), alone, rtol=1e-9)


@pytest.mark.check
def test_checkpointing_changes_no_derivative():
    stepper = dj.make_stepper(model_of(SMALL)).plain
    plain, kept = (
        jax.grad(small_flat(partial(small_end, stepper, checkpoint=flag)))(SMALL_FLAT) for flag in (False, True)
    )
    np.testing.assert_allclose(plain, kept, rtol=1e-11, atol=1e-11 * np.abs(plain).max())


# schemes alone are in test_step_derivatives.py
@pytest.mark.check
@pytest.mark.slow
def test_the_dense_solver_has_equal_forward_and_reverse_derivatives_and_differences(both_modes):
    stepper = dj.make_stepper(model_of(SMALL), "energy_momentum", "dense", iterations=16).plain
    check_all_ways(both_modes(small_flat(partial(small_end, stepper))))


@pytest.mark.check
def test_derivatives_through_halved_steps_are_exact_in_both_modes(both_modes):
    """A step that turns the links about once: it fails as a whole, and the run repeats its accepted parts."""
    stepper, dt = dj.make_stepper(model_of(SMALL), halvings=6), 0.1
    run = dj.integrate(stepper, model_of(SMALL), replace(SMALL_START, v=20 * SMALL["speed"]), dt, 1)[1]
    assert run.retried[0]
    assert run.residual[0] < 1e-11
    faster = small_flat(lambda p: small_end(stepper, p | {"speed": 20 * p["speed"]}, steps=1, dt=dt))
    check_all_ways(both_modes(faster))


def conical_end(b, **choice):
    """Speed squared [m^2/s^2] of the damped conical pendulum after two steps, as a function of its damping."""
    model, s = dj.build("conical-pendulum-damped")
    stepper = dj.make_stepper(model, track_work=False, **choice)
    changed = Model(model.points, model.lines, (model.effects[0], LinearDamping(b)))
    return jnp.sum(dj.integrate(stepper, changed, s, DT, 2)[0].v ** 2)


@pytest.mark.check
@pytest.mark.parametrize("outer", [jax.jacfwd, jax.grad])
@pytest.mark.parametrize("inner", [jax.jacfwd, jax.grad])
def test_second_derivatives_are_those_of_differences(outer, inner):
    h = 1e-4
    first = jax.jit(inner(conical_end))
    expected = float((first(0.2 + h) - first(0.2 - h)) / (2 * h))
    assert float(jax.jit(outer(inner(conical_end)))(0.2)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.check
def test_reverse_mode_over_10_000_steps_needs_at_most_20_megabytes():
    stepper = dj.make_stepper(MODEL, track_work=False)

    def late(b):
        p = PARAMETERS | {"b_l": b[0], "b_q": b[1]}
        return jnp.mean(dj.integrate(stepper, model_of(p), START, DT, 10_000, 10, checkpoint=True)[1].r[..., 2])

    compiled = jax.jit(jax.value_and_grad(late)).lower(jnp.asarray([0.002, 0.001])).compile()
    assert compiled.memory_analysis().temp_size_in_bytes <= 20e6
