"""Derivatives of a bare step by every input of state and model and by h: both modes, differences, alone, together."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax import INTEGRATORS, build_model, load_scene, make_stepper, state
from dropper_jax.integrators.projected_runge_kutta import ProjectedRungeKutta
from dropper_jax.residual import Implicit
from dropper_jax.stepping.progress import begin

GEOMETRY = (".length", ".position", ".r", ".angles")
H = 0.01
#: Later than the jump with which the held point of `SHAKEN` begins to move.
T = 0.2
NODES = np.array([[0.0, 0.0, 0.0], [0.35, 0.1, -0.3], [0.75, 0.2, -0.35], [1.2, 0.0, 0.0]])
SIZES = np.linalg.norm(np.diff(NODES, axis=0), axis=1)
#: The system's two free points.
PLACES = np.array([[0.7, 0.2, -0.5], [0.8, 0.2, -1.4]])
VELOCITIES = np.array([[0.3, 0.2, -0.1], [0.1, -0.2, 0.3]])

WET = {"weight": {"gravity": 9.7}, "linear_damping": {"b_l": 0.3}, "quadratic_damping": {"b_q": 2.0}}
SHAKEN = WET | {"end_motion": {"point": "right", "amplitude": [0.02, 0.01, 0.03], "period": 1.3, "phase": 0.4}}
#: Joints turn at about 1 rad/s, which this dry torque slows by 3 % in a step: all slide, far from being held.
RUBBING = {"weight": {}, "joint_friction": {"dry": 0.02, "viscous": 0.01}}
RODS = {"centre_of_mass": [0.2, 0.2, 0.25], "inertia": [0.01, 0.01, 0.02]}
#: Taut by 5 %: no link goes slack, where a rope has no derivative.
STRETCHY = {"length": list(SIZES / 1.05), "axial": {"law": "elastic", "EA": 900.0, "damping": 2.0}}
ROPE = {"length": list(SIZES / 1.05), "axial": {"law": "rope", "EA": 900.0, "damping": 2.0}}


def line(effects=WET, **more):
    """Three links between two points, moving in space."""
    return {
        "run": {"dt": H, "duration": 1.0},
        "point": [{"name": name, "position": list(NODES[i])} for name, i in (("left", 0), ("right", -1))],
        "line": [
            {"name": "line", "from": "left", "to": "right", "links": 3, "length": list(SIZES), "mass": [0.4, 0.3, 0.5]}
            | more
        ],
        "effects": effects,
        "start": {"kind": "positions", "positions": NODES.tolist()},
    }


def system(**more):
    """A rope and another that hangs from its end; a weight at each free point."""
    points = [("a", "fixed", [0.0, 0.0, 0.0]), ("join", "free", list(PLACES[0])), ("weight", "free", list(PLACES[1]))]
    lines = [("a", "join", 0.8), ("join", "weight", 0.8)]
    return {
        "run": {"dt": H, "duration": 1.0},
        "line_type": [{"name": "rope", "mass": 0.5, "diameter": 0.03, "EA": 900.0, "damping": 2.0}],
        "point": [
            {"name": name, "kind": kind, "position": place} | ({"mass": 1.5} if kind == "free" else {})
            for name, kind, place in points
        ],
        "line": [
            {"name": f"{start}-{end}", "from": start, "to": end, "type": "rope", "length": length, "links": 1}
            for start, end, length in lines
        ],
        "effects": {"weight": {}, "linear_damping": {"b_l": 0.3}},
    } | more


#: The weight, 1 cm deep in the seabed, slides along it.
SLIDING = system(
    sea={"depth": 1.4},
    effects={"weight": {}, "seabed": {"stiffness": 1e5}, "seabed_friction": {"kinetic": 0.4}},
)
BREAKING = system(failure=[{"line": "join-weight", "load": 1e4}, {"line": "a-join", "link": 1, "time": 9.0}])
CASES = {
    "energy_momentum": (line(SHAKEN, **RODS), "energy_momentum", {}),
    "energy_momentum, friction": (line(RUBBING), "energy_momentum", {}),
    "energy_momentum, system": (system(), "energy_momentum", {}),
    "energy_momentum, sliding system": (SLIDING, "energy_momentum", {}),
    "energy_momentum_4": (line(), "energy_momentum_4", {}),
    "theta_midpoint": (line(), "theta_midpoint", {"gamma": 0.6}),
    "rattle": (line(), "rattle", {}),
    "rattle_4": (line(), "rattle_4", {}),
    "theta": (line(), "theta", {"gamma": 0.6}),
    "semi_implicit_euler": (line(), "semi_implicit_euler", {}),
    "semi_implicit_euler, elastic": (line(**STRETCHY), "semi_implicit_euler", {}),
    "thesis_angles": (line(), "thesis_angles", {}),
    "generalized_alpha, system": (system(), "generalized_alpha", {}),
    "rk2, rope": (line(**ROPE), "rk2", {}),
    "rk4, breaking system": (BREAKING, "rk4", {}),
}
#: What `make test` takes of them; `make check` takes all.
OFTEN = ("energy_momentum", "rattle")


def cases(*names, often=OFTEN):
    return [pytest.param(name, marks=[pytest.mark.slow if name in often else pytest.mark.check]) for name in names]


def start_of(name):
    """Stepper, model and start of a case."""
    source, scheme, choice = CASES[name]
    model = build_model(load_scene(source))
    stepper = make_stepper(model, scheme, **choice)
    if isinstance(stepper.integrator, Implicit):  # to rounding, so that differences are not limited by the tolerance
        stepper = replace(stepper, iterations=24, tolerance=1e-15, halvings=0)
    r = PLACES - [0.0, 0.0, 0.01] if "system" in name else NODES[1:-1]
    tension = np.linspace(4.0, 6.0, model.line.links)  # of the time before for some schemes, a guess for others
    return stepper, model, begin(stepper, model, state(model, r, VELOCITIES, tension, T)).state


def differentiated(stepper, model, s):
    """A step as a function of named arrays, and these: every floating array of model and state, and h.

    Its result is the end state less what is a guess for the next step, a constant by its documentation.
    """
    paths, tree = jax.tree_util.tree_flatten_with_path({"model": model, "s": s, "h": jnp.asarray(H)})
    leaves = {jax.tree_util.keystr(path): x for path, x in paths}
    guesses = {"law": ()} if stepper.integrator.name == "generalized_alpha" else {"law": (), "acceleration": ()}

    def function(values):
        inputs = jax.tree.unflatten(tree, [values.get(name, x) for name, x in leaves.items()])
        after = replace(dj.step(stepper, inputs["model"], inputs["s"], inputs["h"])[0], **guesses)
        return [a for a in jax.tree.leaves(after) if jnp.issubdtype(a.dtype, jnp.floating)]

    def moves(x):
        return jnp.issubdtype(x.dtype, jnp.floating) and bool(jnp.all(jnp.isfinite(x)))

    return function, {name: x for name, x in leaves.items() if moves(x)}


def directions(values):
    """A random direction for each input, with zeros for all others: rows (inputs, all numbers).

    As long as a difference along it should be, 1e-4 of the input's size: two differences, extrapolated, leave its
    fourth power, and rounding of 1e-12 (tensions of stiff links) about as much. Of places and lengths 3e-6, some
    2e-6 m: a rigid link makes it good within a step of 0.01 s (a stage of 0.004 s), by 5e-4 m/s, a thousandth of the
    velocities here.
    """
    rng = np.random.default_rng(5)
    rows = {name: jax.tree.map(np.zeros_like, values) for name in values}
    for name, x in values.items():
        share = 3e-6 if any(part in name for part in GEOMETRY) else 1e-4
        size = np.max(np.abs(x), initial=0.0) or 1.0
        rows[name] |= {name: share * size * rng.choice([-1.0, 1.0], x.shape) * rng.uniform(0.5, 1.0, x.shape)}
    return jnp.stack([ravel_pytree(row)[0] for row in rows.values()])


@pytest.mark.parametrize("name", cases(*CASES))
def test_forward_and_reverse_mode_and_differences_agree_in_every_input(name):
    function, values = differentiated(*start_of(name))
    x, unravel = ravel_pytree(values)
    along = directions(values)

    @jax.jit
    def all_ways(x):
        y, push = jax.linearize(lambda x: function(unravel(x)), x)
        (pulled,) = jax.linear_transpose(push, x)(y)
        sizes = jnp.asarray([1.0, -1.0, 2.0, -2.0])[:, None, None]
        near = jax.lax.map(lambda x: function(unravel(x)), (x + sizes * along).reshape(-1, x.size))
        return y, jax.lax.map(push, along), along @ pulled, near

    y, forward, reverse, near = all_ways(x)
    rest = np.asarray(reverse)
    for at, slope, f in zip(y, forward, near, strict=True):
        expected = np.tensordot([8 / 12, -8 / 12, -1 / 12, 1 / 12], f.reshape(4, *slope.shape), axes=1)
        for one, found, wanted in zip(values, slope, expected, strict=True):
            allowed = 1e-6 * np.max(np.abs(wanted), initial=0.0) + 1e-11 * np.max(np.abs(at), initial=1e-3)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=allowed, err_msg=one)
        rest = rest - np.asarray(slope).reshape(len(values), -1) @ np.ravel(at)
    np.testing.assert_allclose(rest, 0.0, atol=1e-10 * np.max(np.abs(reverse)))


@pytest.mark.parametrize(
    "name", cases("energy_momentum", "rattle", "theta", "energy_momentum, system", often=("rattle",))
)
def test_gradients_by_one_input_alone_are_those_by_all_together(name):
    """JAX refused to transpose a step of which an input is held."""
    function, values = differentiated(*start_of(name))

    def total(values):
        return sum(jnp.sum(a) for a in function(values))

    def alone(key):
        return jax.grad(lambda x: total(values | {key: x}))

    together, by_r = jax.jit(lambda x: (jax.grad(total)(values | {"['s'].r": x}), alone("['s'].r")(x)))(
        values["['s'].r"]
    )
    expected = together["['s'].r"]
    np.testing.assert_allclose(by_r, expected, rtol=0, atol=1e-10 * np.max(np.abs(expected)))
    for key in ("['s'].v", "['model'].lines[0].length", "['h']"):
        assert jax.eval_shape(alone(key), values[key]).shape == values[key].shape


def test_every_scheme_is_among_the_cases():
    of_one_step = {name for name, scheme in INTEGRATORS.items() if not issubclass(scheme, ProjectedRungeKutta)}
    assert {scheme for _, scheme, _ in CASES.values()} == of_one_step
