"""Derivatives of a bare step by every input, alone and together, in both modes, against each other and differences."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax.integrators import INTEGRATORS
from dropper_jax.load.source import load_scene
from dropper_jax.model import state
from dropper_jax.run.build import build_model
from dropper_jax.stepping.choose import make_stepper
from dropper_jax.stepping.integrate import begin

NODES = np.array([[0.0, 0.0, 0.0], [0.35, 0.1, -0.3], [0.75, 0.2, -0.35], [1.2, 0.0, 0.0]])
SIZES = np.linalg.norm(np.diff(NODES, axis=0), axis=1)
#: Gravity of its own, so that no other effect shares the array.
WET = {"weight": {"gravity": 9.7}, "linear_damping": {"b_l": 0.3}, "quadratic_damping": {"b_q": 2.0}}
STRETCHY = {"axial": {"law": "elastic", "EA": 900.0, "damping": 2.0}}
ROPE = {"axial": {"law": "rope", "EA": 900.0, "damping": 2.0}}


def line(stretch=0.0, effects=None, **more):
    """Three links between held points, moving in space; links are longer than unstretched by the share `stretch`."""
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "point": [{"name": name, "position": list(NODES[i])} for name, i in (("left", 0), ("right", -1))],
        "line": [
            {"name": "line", "from": "left", "to": "right", "links": 3, "length": list(SIZES / (1 + stretch))}
            | {"mass": [0.4, 0.3, 0.5]}
            | more
        ],
        "effects": WET if effects is None else effects,
        "start": {"kind": "positions", "positions": NODES.tolist()},
    }


def rods(**effects):
    return line(effects=WET | effects, centre_of_mass=[0.2, 0.2, 0.25], inertia=[0.01, 0.01, 0.02])


def breaking():
    """A weight on a rope of two links, of which one may break, at a load and at a time."""
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [{"name": "rope", "mass": 0.5, "diameter": 0.03, "EA": 900.0, "damping": 2.0}],
        "point": [
            {"name": "top", "position": [0.0, 0.0, 0.0]},
            {"name": "weight", "kind": "free", "position": [0.5, 0.0, -0.8], "mass": 2.0},
        ],
        "line": [{"name": "line", "from": "top", "to": "weight", "type": "rope", "length": 0.9, "links": 2}],
        "effects": WET,
        "failure": [{"line": "line", "load": 1e4}, {"line": "line", "link": 2, "time": 9.0}],
    }


def system():
    """Two ropes and a third that hangs from where they meet, a weight at each free point."""
    places = {"a": [0.0, 0.0, 0.0], "b": [1.6, 0.1, 0.0]}
    free = {"join": [0.7, 0.2, -0.5], "weight": [0.8, 0.2, -1.4]}
    lines = [("a", "join", 0.8, 2), ("join", "b", 1.0, 2), ("join", "weight", 0.8, 1)]
    return {
        "run": {"dt": 0.01, "duration": 1.0},
        "line_type": [{"name": "rope", "mass": 0.5, "diameter": 0.03, "EA": 900.0, "damping": 2.0}],
        "point": [{"name": name, "position": place} for name, place in places.items()]
        + [{"name": name, "kind": "free", "position": place, "mass": 1.5} for name, place in free.items()],
        "line": [
            {"name": f"{start}-{end}", "from": start, "to": end, "type": "rope", "length": length, "links": links}
            for start, end, length, links in lines
        ],
        "effects": WET,
    }


SHAKEN = WET | {"end_motion": {"point": "right", "amplitude": [0.02, 0.01, 0.03], "period": 1.3, "phase": 0.4}}
CASES = {
    "energy_momentum": (line(), "energy_momentum", {}),
    "energy_momentum, moving end": (line(effects=SHAKEN), "energy_momentum", {}),
    "energy_momentum, rods": (rods(), "energy_momentum", {"solver": "banded"}),
    "energy_momentum, friction": (rods(joint_friction={"dry": 0.02, "viscous": 0.01}), "energy_momentum", {}),
    "energy_momentum, breaking": (breaking(), "energy_momentum", {}),
    "energy_momentum, system": (system(), "energy_momentum", {}),
    "energy_momentum_4": (line(), "energy_momentum_4", {}),
    "theta_midpoint": (line(), "theta_midpoint", {"gamma": 0.6}),
    "rattle": (line(), "rattle", {}),
    "rattle_4": (line(), "rattle_4", {}),
    "theta": (line(), "theta", {"gamma": 0.6}),
    "semi_implicit_euler": (line(), "semi_implicit_euler", {}),
    "semi_implicit_euler, elastic": (line(0.01, **STRETCHY), "semi_implicit_euler", {}),
    "thesis_angles": (line(), "thesis_angles", {}),
    "generalized_alpha": (line(0.01, **STRETCHY), "generalized_alpha", {}),
    "generalized_alpha, system": (system(), "generalized_alpha", {}),
    "rk2, rope": (line(0.01, **ROPE), "rk2", {}),
    "rk4": (line(0.01, **STRETCHY), "rk4", {}),
    "rk4, breaking": (breaking(), "rk4", {}),
    "rk4, system": (system(), "rk4", {}),
}
H = 0.01

#: Inner nodes of the system's lines, then its free points; the last two are the nodes of the rope that may break.
PLACES = np.array([[0.35, 0.1, -0.26], [1.15, 0.15, -0.26], [0.7, 0.2, -0.5], [0.8, 0.2, -1.4]])
BROKEN = np.array([[0.26, 0.0, -0.41], [0.5, 0.0, -0.83]])
DRIFT = np.array([[0.3, 0.2, -0.1], [0.1, -0.2, 0.3], [-0.2, 0.1, 0.2], [0.1, 0.3, -0.1]])
H = 0.01


def begun(name):
    """Stepper, model and start of a case, tensions and guesses being those that a first step leaves."""
    source, scheme, choice = CASES[name]
    model = build_model(load_scene(source))
    stepper = make_stepper(model, scheme, **choice)
    stepper = replace(stepper, iterations=24, halvings=0) if stepper.integrator.implicit else stepper
    r = {"breaking": BROKEN, "system": PLACES}.get(name.rpartition(", ")[2], NODES[1:-1])
    s = begin(stepper, model, state(model, r, DRIFT[: len(r)])).state
    return stepper, model, jax.jit(partial(dj.step, stepper))(model, s, H)[0]


def differentiated(stepper, model, s):
    """A step as a function of a list of arrays, that list, and the arrays' names.

    In: every floating array of model and state, and h. Out: the state less what is a guess for the next step, which
    is a constant by its documentation.
    """
    paths, tree = jax.tree_util.tree_flatten_with_path((model, s, jnp.asarray(H)))
    leaves = [x for _, x in paths]
    moving = [i for i, x in enumerate(leaves) if jnp.issubdtype(x.dtype, jnp.floating) and jnp.all(jnp.isfinite(x))]
    guesses = {"law": ()} if stepper.integrator.name == "generalized_alpha" else {"law": (), "acceleration": ()}

    def function(values):
        changed = list(leaves)
        for i, value in zip(moving, values, strict=True):
            changed[i] = value
        after = replace(dj.step(stepper, *jax.tree.unflatten(tree, changed))[0], **guesses)
        return [a for a in jax.tree.leaves(after) if jnp.issubdtype(a.dtype, jnp.floating)]

    return function, [leaves[i] for i in moving], [jax.tree_util.keystr(paths[i][0]) for i in moving]


def differences(function, x, steps):
    """Central differences of two step sizes, extrapolated, with a last axis for the entries of x."""
    sizes = jnp.asarray([1.0, -1.0, 2.0, -2.0])
    points = x + (sizes[:, None, None] * jnp.diag(steps)).reshape(-1, x.size)
    weights = jnp.asarray([8.0, -8.0, -1.0, 1.0])[:, None] / (12.0 * steps)

    def combine(f):
        return jnp.einsum("ij,ij...->...j", weights, f.reshape(4, x.size, *f.shape[1:]))

    return jax.tree.map(combine, jax.lax.map(function, points))


def step_of_differences(name, value):
    """Small in what a step is curved in, large in what it is all but linear in: rounding is divided by it."""
    if any(part in name for part in ("length", "position", ".r", "angles", "centre_of_mass", "inertia", "[2]")):
        return 1e-5
    if any(part in name for part in ("mass", ".v", "amplitude", "period", "phase", ".t", "dry", "viscous")):
        return 1e-4
    if any(part in name for part in ("b_l", "b_q", "gravity")):
        return 0.3 * float(value)
    return 1e-2 * max(1.0, float(jnp.max(jnp.abs(value))))


@pytest.mark.parametrize("name", CASES)
def test_forward_and_reverse_mode_and_differences_agree_in_all_inputs_together(name):
    function, values, names = differentiated(*begun(name))
    x, unravel = ravel_pytree(values)
    sizes = [value.size for value in values]
    steps = np.repeat([step_of_differences(*one) for one in zip(names, values, strict=True)], sizes)

    @jax.jit
    def all_ways(x):
        flat = lambda x: function(unravel(x))  # noqa: E731
        return flat(x), jax.jacfwd(flat)(x), jax.jacrev(flat)(x), differences(flat, x, steps)

    for out, *derivatives in zip(*all_ways(x), strict=True):
        forward, reverse, expected = (np.asarray(d).reshape(out.size, x.size) for d in derivatives)
        rounding = 1e-12 * np.max(np.abs(out), initial=0.0) / steps
        for one, where in zip(names, np.split(np.arange(x.size), np.cumsum(sizes)[:-1]), strict=True):
            f, b, d, floor = forward[:, where], reverse[:, where], expected[:, where], rounding[where][0]
            size = np.max(np.abs(f), initial=0.0)
            np.testing.assert_allclose(b, f, rtol=0, atol=1e-9 * size, err_msg=one)
            np.testing.assert_allclose(d, f, rtol=0, atol=1e-6 * size + floor, err_msg=one)


def alone(function, values, i):
    """The sum of all results as a function of one input."""
    return lambda x: sum(jnp.sum(a) for a in function([*values[:i], x, *values[i + 1 :]]))


@pytest.mark.parametrize("name", CASES)
def test_every_input_alone_has_derivatives_in_both_modes(name):
    """Traced only: JAX refused to transpose a step of which an input is held; values are below."""
    function, values, names = differentiated(*begun(name))
    for i, value in enumerate(values):
        one = alone(function, values, i)
        assert jax.eval_shape(jax.grad(one), value).shape == value.shape, names[i]
        assert jax.eval_shape(partial(jax.jvp, one), (value,), (value,))[1].shape == (), names[i]


@pytest.mark.parametrize("name", ["energy_momentum", "energy_momentum, system"])
def test_gradients_by_one_input_alone_are_those_by_all_together_also_in_batches(name):
    function, values, names = differentiated(*begun(name))
    chosen = [names.index(one) for one in ("[0].lines[0].length", "[1].r", "[2]")]

    @jax.jit
    def both_ways(values):
        together = jax.grad(lambda values: sum(jnp.sum(a) for a in function(values)))(values)
        apart = {i: jax.grad(alone(function, values, i)) for i in chosen}
        pair = {i: jnp.stack([values[i], 1.001 * values[i]]) for i in chosen}
        batched = {i: jax.vmap(apart[i])(pair[i])[0] for i in chosen}
        return together, {i: apart[i](values[i]) for i in chosen}, batched

    together, single, batched = both_ways(values)
    for i in chosen:
        for found in (single[i], batched[i]):
            np.testing.assert_allclose(found, together[i], rtol=1e-9, atol=1e-9 * np.max(np.abs(together[i])))


@pytest.mark.parametrize("held", ["r", "v"])
def test_a_pushed_step_of_which_one_direction_is_held_can_be_transposed(held):
    """The transposed map by hand: what is held comes in as a constant zero, not as one that JAX knows to be zero."""
    stepper, model, s = begun("energy_momentum")
    moved = {"r": "v", "v": "r"}[held]

    def end(values):
        return dj.step(stepper, model, replace(s, **values), H)[0].r

    def push(dot):
        at = {"r": s.r, "v": s.v}
        return jax.jvp(end, (at,), ({moved: dot, held: jnp.zeros_like(s.r)},))[1]

    out = jnp.asarray(DRIFT[:2])
    (back,) = jax.linear_transpose(push, s.r)(out)
    expected = jax.grad(lambda x: jnp.sum(out * end({moved: x})))(getattr(s, moved))
    np.testing.assert_allclose(back, expected, rtol=1e-12)


def test_every_scheme_is_among_the_cases():
    assert {scheme for _, scheme, _ in CASES.values()} == set(INTEGRATORS)
