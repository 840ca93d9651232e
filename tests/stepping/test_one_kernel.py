"""Runs as one kernel: what the compiler made of them, with the flags that the command line sets."""

import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dropper_jax as dj
from dropper_jax import scatter_add
from dropper_jax.backend import tridiagonal
from dropper_jax.backend.one_kernel import is_inline
from dropper_jax.study.march import march_with_accuracy

PROGRAM = """
import json, sys
import dropper_jax as dj
import jax

found = {}
for case in sys.argv[1:]:
    name, scheme, kind = case.split(":")
    scene = dj.load_scene(name)
    model, s = dj.build(scene)
    stepper = dj.make_stepper(model, scheme, track_work=False).plain
    run = lambda m, s: dj.integrate(stepper, m, s, scene.run.step, 50)[0].r.sum()
    run = dj.one_kernel(jax.value_and_grad(run, allow_int=True) if kind == "gradient" else run)
    text = run.lower(model, s).compile().as_text()
    entry = text[text.index("ENTRY"):].splitlines()
    loops = [line for line in entry if " while(" in line]
    small = [line for line in entry if " call(" in line and "xla_cpu_small_call" in line]
    called = [line.strip() for line in text.splitlines() if "custom-call(" in line]
    found[case] = {"loops": len(loops), "small": len(small), "called": called}
print(json.dumps(found))
"""
FORWARD = [
    "dropper-release-a:energy_momentum:value",
    "dropper-release-a:rattle:value",
    "dropper-north-sea:energy_momentum:value",
    "paper-case-1:energy_momentum:value",
]
LARGE = ["edulis-longline:energy_momentum:value", "dropper-farm-10:energy_momentum:value"]
GRADIENT = ["dropper-release-a:rattle:gradient"]


def compiled(*cases):
    # LLVM, whose work comes after the operations looked at here, does not optimise
    flags = [flag for flag in os.environ.get("XLA_FLAGS", "").split() if "optimization_level" in flag]
    environment = {**os.environ, "XLA_FLAGS": " ".join(flags)}
    call = [sys.executable, "-c", PROGRAM, *cases]
    return json.loads(subprocess.run(call, env=environment, capture_output=True, check=True, text=True).stdout)


@pytest.mark.check
def test_runs_of_packaged_scenes_are_one_small_call():
    found = compiled(*FORWARD, *GRADIENT)
    for case in FORWARD:
        assert found[case] == {"loops": 0, "small": 1, "called": []}, case
    for case in GRADIENT:
        assert found[case]["loops"] == 0, case
        assert not found[case]["called"], case


@pytest.mark.parametrize("scheme", ["tsit5", "dop853"])
def test_runs_with_an_embedded_error_consist_of_operations_that_compile_to_one_kernel(scheme):
    model, start = dj.build("dropper-release-a")
    stepper = dj.make_stepper(model, scheme)

    def run(model, s, grid, accuracy):
        return march_with_accuracy.__wrapped__(stepper, model, s, grid, accuracy, 5)

    assert is_inline(jax.make_jaxpr(run)(model, start, 0.1, 1e-2).jaxpr)


@pytest.mark.check
@pytest.mark.parametrize("case", LARGE)
def test_runs_of_longlines_and_farms_are_one_small_call(case):
    assert compiled(case)[case] == {"loops": 0, "small": 1, "called": []}


def system(rows, seed, ratio=1.0, taut=0.0):
    """`G M^-1 G'` of a line of random directions: masses over a range of `ratio`, straight where `taut` is 1."""
    random = np.random.default_rng(seed)
    light = ratio ** random.uniform(-0.5, 0.5, rows + 1)
    d = random.normal(size=(rows, 3)) * (1 - taut) + np.array([1.0, 0.0, 0.0]) * taut
    d /= np.linalg.norm(d, axis=1)[:, None]
    off = -light[1:-1] * np.sum(d[1:] * d[:-1], axis=1)
    zero = np.zeros(1)
    return np.concatenate([zero, off]), light[1:] + light[:-1], np.concatenate([off, zero]), random.normal(size=rows)


def dense(lower, diagonal, upper):
    return np.diag(diagonal) + np.diag(lower[1:], -1) + np.diag(upper[:-1], 1)


reduced = jax.jit(tridiagonal.solve_tridiagonal)


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 7, 18, 100, 128, 129, 1000])
@pytest.mark.parametrize(("ratio", "taut"), [(1.0, 0.0), (1e4, 0.0), (1.0, 1.0), (1e4, 1.0)])
def test_cyclic_reduction_is_as_exact_as_the_matrix_allows(rows, ratio, taut):
    lower, diagonal, upper, rhs = system(rows, rows, ratio, taut)
    matrix = dense(lower, diagonal, upper)
    x = np.asarray(reduced(*map(jnp.asarray, (lower, diagonal, upper, rhs))))
    # backward error: the solution of a system that differs by rounding
    size = np.abs(matrix) @ np.abs(x) + np.abs(rhs)
    assert np.max(np.abs(matrix @ x - rhs) / size) < 1e-14
    single = np.asarray(reduced(*(jnp.asarray(a, jnp.float32) for a in (lower, diagonal, upper, rhs))))
    assert single.dtype == np.float32
    assert np.max(np.abs(matrix @ single - rhs) / size) < 1e-5


def test_several_columns_and_derivatives_are_those_of_the_matrix():
    arrays = tuple(map(jnp.asarray, system(150, 3)))
    lower, diagonal, upper, rhs = arrays
    columns = jnp.stack([rhs, 2.0 * rhs], axis=1)
    np.testing.assert_allclose(reduced(lower, diagonal, upper, columns)[:, 1], 2.0 * reduced(*arrays), rtol=1e-12)

    def by_matrix(lower, diagonal, upper, rhs):
        matrix = jnp.diag(diagonal) + jnp.diag(lower[1:], -1) + jnp.diag(upper[:-1], 1)
        return jnp.sum(jnp.linalg.solve(matrix, rhs) ** 2)

    value = lambda *a: jnp.sum(reduced(*a) ** 2)  # noqa: E731
    expected = jax.jit(jax.grad(by_matrix, argnums=(0, 1, 2, 3)))(*arrays)
    for derivative in (jax.grad, jax.jacfwd):
        for a, b in zip(jax.jit(derivative(value, argnums=(0, 1, 2, 3)))(*arrays), expected, strict=True):
            # entries outside the matrix are no part of it
            np.testing.assert_allclose(a[1:-1], b[1:-1], rtol=1e-8, atol=1e-10 * float(jnp.max(jnp.abs(b))))


@pytest.mark.parametrize("where", [[], [2], [0, 1, 2, 3], [3, 1, 2, 0], [1, 1, 3, 1]])
def test_sums_at_places_are_those_of_a_scatter(where):
    values = np.random.default_rng(1).normal(size=(len(where), 3))
    expected = np.zeros((4, 3))
    np.add.at(expected, np.array(where, int), values)
    np.testing.assert_allclose(scatter_add(np.array(where, int), jnp.asarray(values), 4), expected, rtol=1e-15)
