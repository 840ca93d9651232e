"""The loss of a trace as functions of JAX, for loops of one's own, and the short program of the docs."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import dropper_jax as dj
from fitting import Camera, FitSettings, TraceLoss, fit, loss_of_trace, observe, simulate_truth, write_trace
from fitting.estimate.least_squares import fit_windows
from fitting.estimate.windows import Starts

DOCS = Path(__file__).parents[3] / "docs"
pytestmark = pytest.mark.usefixtures("optimised")


@pytest.fixture(scope="module")
def problem(two, prepared):
    """Two rods seen by SciPy, five times off."""
    return TraceLoss(replace(prepared, begin=5 * two.TRUTH))


def test_the_loss_is_half_the_chi_square_that_the_windows_of_a_fit_have(problem):
    prepared = problem.prepared
    residual = prepared.simulator(prepared.values, prepared.starts, prepared.windows).residual
    assert float(problem.loss(problem.params, problem.starts)) == pytest.approx(0.5 * np.sum(residual**2), rel=1e-9)


@pytest.mark.check
def test_the_loss_has_the_slopes_of_differences_and_goes_through_jit_grad_and_vmap(problem):
    slopes = jax.jit(jax.grad(problem.loss, argnums=(0, 1)))(problem.params, problem.starts)
    ends = []
    for i, size in enumerate(1e-5 * np.asarray(problem.scale)):
        step = size * jnp.eye(len(problem.params))[i]
        both = jax.vmap(problem.loss, (0, None))(problem.params + jnp.stack([step, -step]), problem.starts)
        ends.append((both[0] - both[1]) / (2 * size))
    np.testing.assert_allclose(slopes[0], ends, rtol=1e-5)
    turn = 1e-6 * jnp.eye(problem.starts.theta.shape[1])[0]
    theta, omega = problem.starts
    moved = [problem.loss(problem.params, Starts(theta + side * turn, omega)) for side in (1, -1)]
    assert float(slopes[1].theta[:, 0].sum()) == pytest.approx(float(moved[0] - moved[1]) / 2e-6, rel=1e-4)


@pytest.mark.check
def test_with_the_starts_eliminated_value_and_slopes_are_those_of_fitted_starts(problem, two):
    at = 1.05 * jnp.asarray(two.TRUTH)
    value, gradient = problem.value_and_grad(at, problem.best_starts(at))
    prepared = problem.prepared
    held = prepared.problem(frozen=np.ones(2, bool))
    fitted = fit_windows(held, np.asarray(at), prepared.starts, iterations=30)
    assert float(value) == pytest.approx(fitted.cost, abs=0.05)
    # half a standard error of this noise changes the loss by an eighth
    np.testing.assert_allclose(gradient, fitted.gradient, atol=0.05 * np.sqrt(np.diag(fitted.information)).min())
    for i, size in enumerate(1e-3 * two.TRUTH):
        step = size * jnp.eye(2)[i]
        ends = [problem.value_and_grad(at + side * step, problem.best_starts(at))[0] for side in (1, -1)]
        assert float(gradient[i]) == pytest.approx(float(ends[0] - ends[1]) / (2 * size), rel=0.02)


@pytest.mark.check
def test_the_loss_is_a_function_of_the_parameters_whose_gradient_jax_takes(problem, two):
    at = jnp.asarray(1.05 * two.TRUTH)
    value, gradient = jax.value_and_grad(problem)(at)
    expected = problem.gauss_newton(at)
    assert float(value) == pytest.approx(float(expected.value), rel=1e-12)
    np.testing.assert_allclose(gradient, expected.gradient, rtol=1e-9)
    along = jnp.asarray(1e-3 * two.TRUTH)
    ends = [problem(at + side * along) for side in (1, -1)]
    assert float(gradient @ along) == pytest.approx(float(ends[0] - ends[1]) / 2, rel=0.05)


@pytest.mark.check
def test_gauss_newton_steps_of_ones_own_end_where_the_fit_of_the_same_windows_does(problem, two):
    at = 2.0 * jnp.asarray(two.TRUTH)
    for _ in range(8):
        _, gradient, information = problem.gauss_newton(at)
        at = jnp.maximum(at - jnp.linalg.solve(information, gradient), 0.0)
    prepared = problem.prepared
    found = fit_windows(prepared.problem(), prepared.values, prepared.starts)
    errors = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert np.all(np.abs(at - found.values) < 0.1 * errors)


@pytest.mark.check
def test_a_loop_of_ones_own_finds_the_damping(problem, two, ten):
    """Adam on the two coefficients, each in units of its start value."""
    x, starts = problem.params / problem.scale, problem.starts
    optimizer = optax.adam(optax.cosine_decay_schedule(0.25, 20), b1=0.5, b2=0.9)
    state = optimizer.init(x)
    for i in range(20):
        _, gradient = problem.value_and_grad(x * problem.scale, starts)
        change, state = optimizer.update(gradient * problem.scale, state)
        x = jnp.maximum(optax.apply_updates(x, change), 0.0)
        starts = problem.best_starts(x * problem.scale, starts) if i % 5 == 0 else starts
    assert np.all(np.abs(x * problem.scale - two.TRUTH) < 3 * ten[0].uncertainty.std_error)


def run_docs(mark, **names):
    """What the program of docs/fits.md with these words leaves, for another scene and file."""
    text = re.findall(r"^```python\n(.*?)^```", (DOCS / "fits.md").read_text(), re.M | re.S)
    (text,) = (block for block in text if mark in block)
    for old, new in (('"dropper-release-a"', "scene"), ('"RUN.csv"', "file")):
        assert text.count(old) == 1
        text = text.replace(old, new)
    exec(compile(text, "fits.md", "exec"), names)
    return names


@pytest.fixture(scope="module")
def program(tmp_path_factory, chain):
    """The program of the docs after it ran on three links for 3 s, from ten times off."""
    effects = {"weight": {}, "linear_damping": {"b_l": 0.002}, "quadratic_damping": {"b_q": 0.001}}
    start = {"kind": "static", "release_nodes": [1], "release_force": [[0.0, 0.0, 0.6]]}
    scene = chain([0.15] * 3, [0.05] * 3, start, right=[0.25, 0.0, 0.0], effects=effects)
    file = tmp_path_factory.mktemp("program") / "RUN.csv"
    write_trace(file, observe(simulate_truth(scene, 3.0, 60.0, 8), Camera(rate=60.0, angle_noise=5e-4), 0))
    return run_docs("lax.scan", scene=scene, file=file)


@pytest.mark.check
def test_the_short_program_of_the_docs_ends_where_separate_windows_do_from_ten_times_off(program):
    begin = {"b_l": 0.02, "b_q": 0.01}
    settings = FitSettings(window=0.5)
    result = fit(program["file"], program["scene"], list(begin), method="windows", settings=settings, start=begin)
    errors = result.uncertainty.std_error
    assert np.all(np.abs(program["b"] - result.values) < 3 * errors)
    assert np.all(np.abs(np.asarray(program["b"]) - [0.002, 0.001]) < 3 * errors)
    assert np.all(10 * errors < [0.018, 0.009])  # the start is far off in these units
    assert float(program["rms"]) == pytest.approx(5e-4, rel=0.1)


@pytest.mark.check
def test_the_random_walk_of_the_docs_has_the_errors_of_the_fit(program):
    """Its 200 draws are worth about 25 independent ones."""
    problem = loss_of_trace(program["file"], program["scene"], ["b_l", "b_q"], settings=FitSettings(window=0.5))
    names = run_docs("log_density", scene=program["scene"], file=program["file"], problem=problem)
    result, draws = names["result"], np.array(names["draws"])
    error = result.uncertainty.std_error
    np.testing.assert_allclose((draws.mean(axis=0) - result.values) / error, 0.0, atol=0.7)
    np.testing.assert_allclose(draws.std(axis=0) / error, 1.0, atol=0.5)
    assert 0.1 < np.mean(np.any(np.diff(draws, axis=0) != 0, axis=1)) < 0.7


@pytest.mark.check
def test_a_release_whose_windows_have_no_start_is_refused(program, refusal):
    given = program["file"], program["scene"], ["b_l", "release.time"]
    found = refusal(loss_of_trace, *given, settings=FitSettings(window=0.5))
    assert "free: 'release.time.0' cannot be part of this loss. Use" in found


@pytest.mark.check
def test_its_step_is_that_of_the_dense_solver(program):
    model, start = dj.build(program["scene"])
    stepper = dj.make_stepper(model, "energy_momentum", "dense")
    ours, _ = dj.step(stepper, model, start, jnp.asarray(program["h"]))
    r, v, _ = program["step"](model, start.r, start.v, jnp.zeros(3))
    np.testing.assert_allclose(r, ours.r, atol=1e-12)
    np.testing.assert_allclose(v, ours.v, atol=1e-9)


def test_a_static_start_and_poses_at_rest_are_refused(monkeypatch, prepared, refusal):
    """Windows of a release have no start of their own, and a pose at rest would be left out silently."""
    released = replace(prepared, simulator=SimpleNamespace(release=object()))
    resting = replace(prepared, rest=object())
    for given, words in ((released, "static_start: cannot be part of this loss"), (resting, "rest: poses at rest")):
        monkeypatch.setattr("fitting.calibration.trace_loss.prepare", lambda *_, given=given: given)
        assert words in refusal(loss_of_trace, "run.csv", "scene.toml")
