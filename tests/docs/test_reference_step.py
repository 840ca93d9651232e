"""The steps written out on the page on physics against the package's own, and other schemes under the page's loop."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax import build_model, load_scene, make_stepper, state
from dropper_jax.stepping.progress import begin

PAGE = Path(__file__).parents[2] / "docs" / "physics.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.M | re.S)
STEPS, DT = 20, 0.005
NODES = np.array([[0.0, 0.0, 0.0], [0.35, 0.1, -0.3], [0.75, 0.2, -0.35], [1.2, 0.0, 0.0]])
SIZES = np.linalg.norm(np.diff(NODES, axis=0), axis=1)
DRAG = {"weight": {}, "linear_damping": {"b_l": 0.3}, "quadratic_damping": {"b_q": 0.2}}
WATER = {"weight": {}, "morison_drag": {"cdn": 1.2, "cdt": 0.1}}
WAVES = {"depth": 20.0, "waves": {"kind": "regular", "amplitude": 0.4, "period": 4.0}}


def scene(stretch=0.0, effects=DRAG, more=None, **line):
    """Three links between held points; links are longer than unstretched by the share `stretch`."""
    return {
        "run": {"dt": DT, "duration": 1.0},
        "point": [{"name": name, "position": list(NODES[i])} for name, i in (("left", 0), ("right", -1))],
        "line": [
            {"name": "line", "from": "left", "to": "right", "links": 3, "length": list(SIZES / (1 + stretch))}
            | {"mass": [0.4, 0.3, 0.5]}
            | line
        ],
        "effects": effects,
        **(more or {}),
    }


def stretchy(EA, damping=2.0, **more):
    return scene(0.01, axial={"law": "elastic", "EA": EA, "damping": damping}, **more)


RIGID = {"drag": scene(), "waves": scene(effects=WATER, more={"sea": WAVES}, diameter=0.03)}
STRETCHY = {
    "elastic": stretchy(900.0),
    "elastic, stiff": stretchy(1e6, 20.0),
    "elastic, waves": stretchy(900.0, effects=WATER, more={"sea": WAVES}, diameter=0.03),
}


@pytest.fixture(scope="module")
def page():
    """What the page's code defines."""
    names = {}
    for text in BLOCKS:
        exec(compile(text, PAGE.name, "exec"), names)
    return names


def start_of(source, scheme, **choice):
    """Stepper, model and a start at rest, as the scheme begins."""
    model = build_model(load_scene(source))
    stepper = make_stepper(model, scheme, **choice)
    return stepper, model, begin(stepper, model, state(model, NODES[1:-1])).state


@partial(jax.jit, static_argnums=0)
def run(stepper, model, s):
    """States after each step by `dj.step`, and the largest residual."""

    def step(s, _):
        s, row = dj.step(stepper, model, s, DT)
        return s, (s, row)

    _, (path, residuals) = jax.lax.scan(step, s, None, length=STEPS)
    return path, jnp.max(residuals)


def check_same(found, expected, within=1e-10):
    """Equal to this part of the largest entry, and something has moved."""
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=within * np.max(np.abs(b)))
        assert np.max(np.abs(b[-1] - b[0])) > 1e-3 * np.max(np.abs(b))


def test_each_step_on_the_page_has_at_most_forty_lines():
    assert len(BLOCKS) == 3
    assert all(len(text.splitlines()) <= 40 for text in BLOCKS)


#: The page leaves out the ringing force of steps that do not resolve axial vibrations.
RESOLVED = {**RIGID, "elastic": STRETCHY["elastic"], "elastic, waves": STRETCHY["elastic, waves"]}


@pytest.mark.parametrize("source", RESOLVED.values(), ids=RESOLVED)
def test_energy_momentum_on_the_page_makes_the_steps_of_the_package(page, source):
    stepper, model, s = start_of(source, "energy_momentum")

    def step(carry, t):
        carry = page["energy_momentum"](model, *carry, t, DT)
        return carry, carry

    found = jax.lax.scan(step, (s.r, s.v, s.tension), DT * jnp.arange(STEPS))[1]
    path, residual = run(stepper, model, s)
    assert residual < 1e-11
    check_same(found, (path.r, path.v, path.tension))


@pytest.mark.parametrize("rho", [0.5, 0.9])
@pytest.mark.parametrize("source", [STRETCHY["elastic"], STRETCHY["elastic, stiff"]], ids=["elastic", "stiff"])
def test_generalized_alpha_on_the_page_makes_the_steps_of_the_package(page, source, rho):
    stepper, model, s = start_of(source, "generalized_alpha", rho_infinity=rho)

    def step(carry, t):
        *carry, tension = page["generalized_alpha"](model, *carry, t, DT, rho)
        return tuple(carry), (*carry, tension)

    found = jax.lax.scan(step, (s.r, s.v, s.acceleration), DT * jnp.arange(STEPS))[1]
    path, residual = run(stepper, model, s)
    assert residual < 1e-11
    check_same(found, (path.r, path.v, path.acceleration, path.tension))


OTHERS = [
    ("energy_momentum_4", {}),
    ("theta_midpoint", {"gamma": 0.6}),
    ("rattle", {}),
    ("rattle_4", {}),
    ("theta", {"gamma": 0.6}),
    ("semi_implicit_euler", {}),
    ("thesis_angles", {"gamma": 0.6}),
]


@pytest.mark.check
@pytest.mark.parametrize(("scheme", "choice"), OTHERS, ids=[name for name, _ in OTHERS])
def test_other_implicit_schemes_make_the_same_steps_under_the_loop_of_the_page(page, scheme, choice):
    stepper, model, s = start_of(RIGID["drag"], scheme, **choice)
    stepper = replace(stepper, iterations=24, tolerance=1e-15)  # what a correction leaves grows over the steps

    def stage(s, h):
        problem = stepper.integrator.problem(model, s, h)
        guess, unravel = ravel_pytree(problem.guess())
        u = page["newton"](lambda u: ravel_pytree(problem.residual(unravel(u)))[0], guess)
        return problem.finish(unravel(u)), None

    @jax.jit
    def plain(s):
        stages = DT * jnp.asarray(stepper.integrator.stages)
        return jax.lax.scan(lambda s, _: (jax.lax.scan(stage, s, stages)[0],) * 2, s, None, length=STEPS)[1]

    path, residual = run(stepper, model, s)
    assert residual < 1e-11
    found = plain(s)
    # tensions of the third stage of a composition, which goes backwards, grow rounding most
    within = 1e-9 if len(stepper.integrator.stages) > 1 else 1e-10
    check_same((found.r, found.v, found.tension), (path.r, path.v, path.tension), within)
