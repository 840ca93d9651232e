"""Functions as one kernel by a tag: right values everywhere, and no call that the compiler ends the process for.

The cases run in a process of their own, because the compiler aborts where a parameter of a tagged call has no reader.
A process that ends with a case fails that case; the next one goes on with the cases after it.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

START = """
import json
import jax, jax.numpy as jnp, numpy as np
import dropper_jax as dj

x, y, n = jnp.arange(5.0) + 1, jnp.arange(7.0), jnp.arange(3)
loop = lambda x: jax.lax.scan(lambda k, _: (jnp.sin(k) + 0.1 * k, None), x, None, length=9)[0]
total = lambda x: jnp.sum(loop(x) ** 2)
"""
END = """
function, plain, args = case
program = jax.jit(function).lower(*args).compile()
found, expected = jax.tree.leaves(program(*args)), jax.tree.leaves(plain(*args))
np.testing.assert_allclose(found[0], expected[0], rtol=1e-13)
for a, b in zip(found, expected, strict=True):
    np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)
print("\\n" + json.dumps(program.as_text().count('inlineable="false"')), "tags", flush=True)
"""
CASES = """
import json, sys, traceback
import jax
for code in json.load(sys.stdin):
    jax.clear_caches()
    try:
        exec(code, {})
    except Exception:
        print("\\n" + json.dumps(traceback.format_exc()), "tags", flush=True)
"""
TAGGED = {
    "plain": "case = dj.one_kernel(loop), loop, (x,)",
    "trees and keywords": """
f = lambda a, scale: {"r": loop(a["x"]) * scale, "none": None}
g = lambda a, s: dj.one_kernel(f)(a, scale=s)
case = g, lambda a, s: f(a, s), ({"x": x}, jnp.asarray(2.0))
""",
    "dead argument": """
f = lambda x, c: jax.lax.while_loop(lambda k: k[2] < 9, lambda k: (jnp.sin(k[0]), k[1], k[2] + 1), (x, c, 0))[0]
case = dj.one_kernel(f), f, (x, y)
""",
    "dead integers": "f = lambda x, n: loop(x) + jnp.sum(n[:0]); case = dj.one_kernel(f), f, (x, n)",
    "all arguments dead": "f = lambda x: loop(jnp.ones(5)) + jnp.sum(x[:0]); case = dj.one_kernel(f), f, (x,)",
    "empty arrays": "f = lambda x, e: (loop(x), e * 2); case = dj.one_kernel(f), f, (x, jnp.zeros((0, 3)))",
    "constants": """
f = lambda x: loop(x) * np.arange(5.0) + jnp.asarray(np.arange(5.0) + 3); case = dj.one_kernel(f), f, (x,)
""",
    "closure over an outer trace": "f = lambda x, y: dj.one_kernel(lambda x: loop(x) * y[:5])(x)\n"
    "case = f, lambda x, y: loop(x) * y[:5], (x, y)",
    "types": """
f = lambda *a: (loop(a[0]), *(v * 2 for v in a[1:-1]), ~a[-1], a[1])
args = x, jnp.int32(-3), jnp.arange(3) - 2**62, jnp.uint64(2**63 + 5), jnp.float32(0.1), jnp.array([True, False])
case = dj.one_kernel(f), f, args
""",
    "minus zero": """
f = lambda x: jnp.signbit(-0.0 * x) + loop(x) * 0; g = lambda x: (-0.0 * x + loop(x) * -0.0, )
case = dj.one_kernel(g), g, (jnp.zeros(5),)
""",
    "searching": "f = lambda x, y: y[jnp.searchsorted(y, 3 * loop(x))]; case = dj.one_kernel(f), f, (x, y)",
    "of grad": "case = dj.one_kernel(jax.grad(total)), jax.grad(total), (x,)",
    "of value and grad": "f = jax.value_and_grad(total); case = dj.one_kernel(f), f, (x,)",
    "of grad of": "case = dj.one_kernel(jax.grad(dj.one_kernel(total))), jax.grad(total), (x,)",
    "of vmap": "f = jax.vmap(loop); case = dj.one_kernel(f), f, (jnp.stack([x, x * 0.1]),)",
    "of Hessian": "f = jax.hessian(total); case = dj.one_kernel(f), f, (x,)",
    "inside another": "f = lambda x: dj.one_kernel(loop)(x) * 2; case = dj.one_kernel(f), lambda x: loop(x) * 2, (x,)",
    "inside another after a call alone": """
g = dj.one_kernel(loop); g(x); f = lambda x: g(x) * 2
case = dj.one_kernel(f), lambda x: loop(x) * 2, (x,)
""",
    "only integer results used": """
f = lambda x, n: (jnp.sin(x), jax.lax.while_loop(lambda k: k[1] < 9, lambda k: (k[0] + 1, k[1] + 1), (n, 0))[0])
case = (lambda x, n: dj.one_kernel(f)(x, n)[1]), (lambda x, n: f(x, n)[1]), (x, n)
""",
    "functions of one number": """
names = "sin cos tan asin acos atan sinh cosh tanh exp exp2 expm1 log log1p sqrt rsqrt cbrt logistic erf floor abs"
f = lambda x: [getattr(jax.lax, name)(0.1 * loop(x) + 0.3) for name in names.split()]
case = dj.one_kernel(f), f, (x,)
""",
    "indices and reductions": """
def move(c, i):
    X = jnp.outer(c, c)
    v = X[i[0]] + X[::-1][0] + X.T[1] + jnp.pad(X, 2)[2, 2:7] + jnp.tile(c, 3)[5:10] + jnp.stack([c, c])[i[1] - 1]
    v += jnp.argmax(X, 1) + X.sum(0) + X.max() + X.prod() + (X > 1).all() + X[:, i].sum(1) + X[(0, 3), (1, 1)].sum()
    return jnp.sin(v + jax.lax.dynamic_update_slice(c, c[:2], (i[0],)) + jnp.roll(c, 2)), i
f = lambda x, i: jax.lax.fori_loop(0, 4, lambda _, c: move(*c), (x, i))[0]
case = dj.one_kernel(f), f, (x, n)
""",
    "inside a loop": """
f = lambda x: jax.lax.scan(lambda c, _: (dj.one_kernel(loop)(c), None), x, None, length=3)[0]
case = jax.jit(f), lambda x: loop(loop(loop(x))), (x,)
""",
    "two call sites": """
g = dj.one_kernel(loop); case = jax.jit(lambda x: g(x) + g(x * 0.5)), lambda x: loop(x) + loop(x * 0.5), (x,)
""",
    "export": """
import jax.export
e = jax.export.export(dj.one_kernel(loop), platforms=["cpu"])(jax.ShapeDtypeStruct((5,), jnp.float64))
case = e.call, loop, (x,)
""",
    "inside shard_map": """
from jax.sharding import PartitionSpec as P
mesh = jax.make_mesh((2,), ("b",), axis_types=(jax.sharding.AxisType.Auto,))
f = jax.shard_map(dj.one_kernel(jax.vmap(loop)), mesh=mesh, in_specs=P("b"), out_specs=P("b"))
case = jax.jit(f), jax.vmap(loop), (jnp.stack([x, x * 2, x * 3, x * 4]),)
""",
}
PLAIN = {
    "export for two platforms": """
import jax.export
e = jax.export.export(dj.one_kernel(loop), platforms=["cpu", "cuda"])(jax.ShapeDtypeStruct((5,), jnp.float64))
case = e.call, loop, (x,)
""",
    "export for all sizes": """
import jax.export
e = jax.export.export(dj.one_kernel(loop))(jax.ShapeDtypeStruct(jax.export.symbolic_shape("n"), jnp.float64))
case = e.call, loop, (x,)
""",
    "grad of": "case = jax.grad(dj.one_kernel(total)), jax.grad(total), (x,)",
    "grad by one of several": """
f = lambda x, n, y: jnp.sum(loop(x) ** 2) * n[1] + jnp.sum(y); case = jax.grad(dj.one_kernel(f)), jax.grad(f), (x, n, y)
""",
    "a library call in a branch": """
f = lambda x: jax.lax.cond(x[0] > 0, lambda x: jnp.linalg.solve(jnp.eye(5) * 2, x), lambda x: x, loop(x))
case = dj.one_kernel(f), f, (x,)
""",
    "grad of grad of": """
case = jax.grad(lambda x: jnp.sum(jax.grad(dj.one_kernel(total))(x) ** 2)), \
    jax.grad(lambda x: jnp.sum(jax.grad(total)(x) ** 2)), (x,)
""",
    "Hessian of": "case = jax.jacfwd(jax.jacfwd(dj.one_kernel(total))), jax.hessian(total), (x,)",
    "vmap of": "case = jax.vmap(dj.one_kernel(loop)), jax.vmap(loop), (jnp.stack([x, x * 0.1]),)",
    "vmap of an indexed update": """
f = lambda x, i: jax.lax.dynamic_update_index_in_dim(x, 3.0, i, 0)
case = jax.vmap(dj.one_kernel(f)), jax.vmap(f), (jnp.stack([x, x]), jnp.array([1, 2]))
""",
    "no float among the results": "f = lambda x: loop(x) > 0; case = dj.one_kernel(f), f, (x,)",
    "no arguments": "f = lambda: loop(jnp.ones(5)); case = dj.one_kernel(f), f, ()",
    "LAPACK": "f = lambda x: jnp.linalg.solve(jnp.eye(5) * 2 + jnp.outer(x, x), x); case = dj.one_kernel(f), f, (x,)",
    "sorting": "f = lambda x: jnp.sort(-loop(x)); case = dj.one_kernel(f), f, (x,)",
    "a scatter": "f = lambda x: loop(x).at[jnp.array([1, 1])].add(1.0); case = dj.one_kernel(f), f, (x,)",
    "fft": "f = lambda x: jnp.abs(jnp.fft.fft(x)); case = dj.one_kernel(f), f, (x,)",
    "a large product": "f = lambda a: a @ a; case = dj.one_kernel(f), f, (jnp.ones((99, 99)),)",
    "a print": "f = lambda x: (jax.debug.print('{x}', x=x[0]), loop(x))[1]; case = dj.one_kernel(f), loop, (x,)",
    "a callback": """
f = lambda x: jax.pure_callback(lambda v: np.asarray(v) * 2, jax.ShapeDtypeStruct((5,), jnp.float64), x)
case = dj.one_kernel(f), lambda x: x * 2, (x,)
""",
    "a collective": """
from jax.sharding import PartitionSpec as P
mesh = jax.make_mesh((2,), ("b",), axis_types=(jax.sharding.AxisType.Auto,))
f = lambda x: jax.lax.psum(jnp.sum(loop(x)), "b")
f = jax.shard_map(dj.one_kernel(f), mesh=mesh, in_specs=P("b"), out_specs=P())
case = jax.jit(f), lambda x: jnp.sum(loop(x)), (jnp.arange(6.0),)
""",
    "sharded arguments": """
from jax.sharding import NamedSharding, PartitionSpec as P
mesh = jax.make_mesh((2,), ("b",), axis_types=(jax.sharding.AxisType.Auto,))
X = jax.device_put(jnp.stack([x, x * 2, x * 3, x * 4]), NamedSharding(mesh, P("b")))
case = dj.one_kernel(jax.vmap(loop)), jax.vmap(loop), (X,)
""",
}


#: Cases of each test run, one of each kind; the others are left to `make check`.
FIRST = {"plain", "dead argument", "dead integers", "all arguments dead", "constants", "of grad", "two call sites"}
FIRST |= {"inside shard_map", "grad of", "vmap of", "LAPACK", "a scatter", "a collective", "a callback"}


def names(cases):
    return [name if name in FIRST else pytest.param(name, marks=pytest.mark.check) for name in cases]


SCENE = """
import json, sys
import dropper_jax as dj
dj.store_programs(sys.argv[2])
found = dj.simulate("dropper-release-a", duration=0.5, **json.loads(sys.argv[1]))
again = dj.simulate("dropper-release-a", duration=0.5, **json.loads(sys.argv[1]))
assert found.status == again.status == "ok"
print(json.dumps([found.positions[-1].tolist(), again.positions[-1].tolist()]))
"""


def run(program, text="", *words, **environment):
    """A Python program in a process of its own, without the flags of the tests."""
    given = {key: value for key, value in os.environ.items() if not key.startswith(("XLA_FLAGS", "DROPPER_"))}
    call = [sys.executable, "-c", program, *words]
    return subprocess.run(call, env=given | environment, input=text, capture_output=True, check=False, text=True)


def output(program, *words, **environment):
    """The JSON object that a program prints last."""
    done = run(program, "", *words, **environment)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1].removesuffix(" tags"))


@pytest.fixture(scope="module")
def tags(request):
    """Number of tagged calls in each case, whose values are compared with the plain function's; or its error."""
    found = {}
    asked = {item.callspec.params.get("name") for item in request.session.items if hasattr(item, "callspec")}
    for devices in (1, 2):
        flags = f"--xla_force_host_platform_device_count={devices}"
        cases = {name: code for name, code in (TAGGED | PLAIN).items() if name in asked}
        cases = {name: code for name, code in cases.items() if ("make_mesh" in code) == (devices == 2)}
        while cases:
            done = run(CASES, json.dumps([START + code + END for code in cases.values()]), XLA_FLAGS=flags)
            answers = [json.loads(line[:-5]) for line in done.stdout.splitlines() if line.endswith(" tags")]
            if len(answers) < len(cases):
                answers.append(done.stderr[-2000:])
            found |= dict(zip(cases, answers, strict=False))
            cases = dict(list(cases.items())[len(answers) :])
    return found


@pytest.mark.check
@pytest.mark.parametrize("name", names(TAGGED))
def test_a_tagged_function_has_the_values_of_the_plain_one(tags, name):
    assert isinstance(tags[name], int), tags[name]
    assert tags[name] > 0


def test_the_plain_backend_has_no_tags():
    assert output(START + TAGGED["of value and grad"] + END, DROPPER_BACKEND="plain") == 0


@pytest.mark.parametrize("name", names(PLAIN))
def test_what_cannot_be_one_kernel_is_the_plain_function(tags, name):
    assert tags[name] == 0, tags[name]


@pytest.mark.check
@pytest.mark.parametrize("solver", ["auto", "dense"])  # the second has no tag
def test_runs_are_the_same_with_tags_stored_programs_and_none_of_them(solver, tmp_path):
    settings = json.dumps({"solver": solver}), str(tmp_path)
    plain = output(SCENE, *settings, DROPPER_BACKEND="plain")[0]
    first, second = output(SCENE, *settings), output(SCENE, *settings)
    assert any(tmp_path.iterdir())
    assert first[0] == first[1] == second[0]
    np.testing.assert_allclose(first[0], plain, rtol=0, atol=1e-11)
