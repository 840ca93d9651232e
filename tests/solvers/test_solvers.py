"""The three linear solvers: the same runs, the same solves as a dense matrix, and refusals with their reasons."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_scenes import SINGLE_LINES
from jax.flatten_util import ravel_pytree

import dropper_jax as dj
from dropper_jax import Model, build_model
from dropper_jax.residual import Unknowns
from dropper_jax.solvers import SOLVERS

SLACK = {"weight": {}, "linear_damping": {"b_l": 0.02}, "quadratic_damping": {"b_q": 0.3}}
VISCOUS = {"weight": {}, "joint_friction": {"viscous": 0.004}}
DRY = {"weight": {}, "joint_friction": {"dry": 0.001}}
ROD = {"centre_of_mass": 0.07, "inertia": 2e-4}
STRETCHY = {"axial": {"law": "elastic", "EA": 300.0, "damping": 0.5}}


#: What `make test` takes of them.
OFTEN = (
    *("conical-pendulum", "double-pendulum-chaotic", "dropper-release-a", "dropper-release-3d"),
    "dropper-release-a-compound",
)


@pytest.mark.parametrize(
    "scene", [pytest.param(name, marks=[] if name in OFTEN else pytest.mark.check) for name in SINGLE_LINES]
)
def test_all_solvers_give_the_same_positions_over_two_seconds(march, scene):
    model, s = dj.build(scene)
    steps = round(2.0 / dj.load_scene(scene).run.step)
    found = {}
    for name, solver in SOLVERS.items():
        if solver.refuse(model, dj.INTEGRATORS["energy_momentum"]()) is None:
            stepper = dj.make_stepper(model, solver=name, halvings=0, track_work=False)
            found[name] = march(stepper, model, s, 2.0, steps, 10)[0]
    assert set(found) == {"dense", "banded"} | ({"condensed"} if "compound" not in scene else set())
    for r in found.values():
        np.testing.assert_allclose(r, found["dense"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("integrator", ["rattle", "theta"])
def test_all_solvers_give_the_same_positions_with_the_other_schemes(march, integrator):
    model, s = dj.build("dropper-release-b")
    found = [
        march(dj.make_stepper(model, integrator, name, halvings=0, track_work=False), model, s, 0.5, 256, 4)[0]
        for name in ("dense", "banded", "condensed")
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], rtol=0, atol=1e-9)


def hanging(chain, links, held, effects, line):
    """A slack loop or a hanging string of unequal links, bent by hand so that no two links are parallel."""
    length = 0.1 + 0.01 * np.arange(links)
    mass = (0.03 + 0.002 * np.arange(links)).tolist()
    right = [0.55 * length.sum(), 0.0, 0.02] if held else None
    start = {"kind": "static"}
    return dj.build(chain(length, mass, start, right=right, effects=effects, **line))


def random_step(model, s, seed, h=0.01):
    """A random state near the pose with positive tensions, and the change of its first guess to look at."""
    rng = np.random.default_rng(seed)
    shape = s.r.shape
    moved = replace(
        s,
        r=s.r + 0.01 * rng.normal(size=shape),
        v=jnp.asarray(0.5 * rng.normal(size=shape)),
        tension=jnp.asarray(rng.uniform(0.2, 2.0, s.tension.shape)),
        acceleration=jnp.asarray(rng.normal(size=shape)),
    )
    return moved, jnp.asarray(0.01 * h * rng.normal(size=shape)), h


def matrix(function, like):
    """Columns of a linear map on unknowns."""
    flat, unravel = ravel_pytree(like)
    return jax.vmap(lambda e: ravel_pytree(function(unravel(e)))[0], out_axes=1)(jnp.eye(flat.size))


@partial(jax.jit, static_argnames=("integrator", "solver"))
def solver_matrices(model, step, integrator, solver):
    """The Jacobian, the solver's inverse and its transposed inverse, each (N, N)."""
    s, change, h = step
    problem = dj.INTEGRATORS[integrator]().problem(model, s, jnp.asarray(h))
    u = problem.guess()
    u = Unknowns(u.x + change, u.y, u.z)
    linear = SOLVERS[solver].linearise(problem, u)
    return (
        matrix(lambda du: jax.jvp(problem.residual, (u,), (du,))[1], u),
        matrix(lambda b: linear.apply(b), u),
        matrix(lambda b: linear.transpose().apply(b), u),
    )


CASES = {
    "loop": (7, True, SLACK, {}, "energy_momentum"),
    "string": (6, False, SLACK, {}, "energy_momentum"),
    "one link": (1, False, SLACK, {}, "energy_momentum"),
    "two links": (2, True, SLACK, {}, "energy_momentum"),
    "three links": (3, False, SLACK, {}, "energy_momentum"),
    "compound loop": (7, True, SLACK, ROD, "energy_momentum"),
    "compound string": (5, False, SLACK, ROD, "energy_momentum"),
    "viscous loop": (7, True, VISCOUS, {}, "energy_momentum"),
    "viscous string": (5, False, VISCOUS, {}, "energy_momentum"),
    "viscous compound loop": (6, True, VISCOUS, ROD, "energy_momentum"),
    "elastic loop": (5, True, SLACK, STRETCHY, "energy_momentum"),
    "rattle": (6, True, SLACK, {}, "rattle"),
    "rattle viscous": (6, True, VISCOUS, {}, "rattle"),
    "theta": (5, False, SLACK, {}, "theta"),
}


@pytest.mark.parametrize("case", CASES)
def test_banded_solve_and_its_transpose_are_those_of_the_dense_jacobian(chain, case):
    *shape, integrator = CASES[case]
    model, s = hanging(chain, *shape)
    for seed in range(3):
        full, forward, backward = solver_matrices(model, random_step(model, s, seed), integrator, "banded")
        inverse = np.linalg.inv(full)
        np.testing.assert_allclose(forward, inverse, atol=1e-10 * np.abs(inverse).max())
        np.testing.assert_allclose(backward, inverse.T, atol=1e-10 * np.abs(inverse).max())


@pytest.mark.parametrize("case", ["loop", "string", "two links", "elastic loop", "rattle", "theta"])
def test_condensed_transposed_apply_is_the_transpose_of_its_apply(chain, case):
    *shape, integrator = CASES[case]
    model, s = hanging(chain, *shape)
    full, forward, backward = solver_matrices(model, random_step(model, s, 1), integrator, "condensed")
    np.testing.assert_allclose(backward, forward.T, atol=1e-12 * np.abs(forward).max())
    if integrator == "rattle":  # nothing is left out there
        np.testing.assert_allclose(forward @ full, np.eye(len(full)), atol=1e-8)


@pytest.mark.parametrize("case", ["loop", "compound loop", "viscous loop", "viscous compound loop"])
def test_declared_reach_covers_the_coupling_of_the_jacobian(chain, case):
    """Blocks of nodes beyond it are zero; a solver may rely on it. Tensions couple neighbours in any case."""
    *shape, integrator = CASES[case]
    model, s = hanging(chain, *shape)
    full = np.abs(solver_matrices(model, random_step(model, s, 0), integrator, "banded")[0])
    nodes = model.free_nodes
    blocks = full[: 3 * nodes, : 3 * nodes].reshape(nodes, 3, nodes, 3).max(axis=(1, 3))
    far = np.abs(np.subtract.outer(np.arange(nodes), np.arange(nodes)))
    assert np.all(blocks[far > max(model.reach, 1)] == 0)
    assert np.all(blocks[far == 1] > 0)


@pytest.mark.parametrize(
    ("solver", "integrator", "effects", "line", "reason"),
    [
        ("condensed", "energy_momentum", SLACK, ROD, "compound links couple neighbouring nodes"),
        ("condensed", "energy_momentum", VISCOUS, {}, "a force in the scene couples neighbouring nodes"),
        ("condensed", "energy_momentum", DRY, {}, "joint_friction.*its own unknowns"),
        ("banded", "energy_momentum", DRY, {}, "joint_friction.*its own unknowns"),
        ("banded", "thesis_angles", SLACK, {}, "couples all links in each row"),
        ("condensed", "thesis_angles", SLACK, {}, "does not offer the pieces"),
        ("dense", "rk4", SLACK, STRETCHY, "solves nothing"),
        ("auto", "rk4", SLACK, {}, "links are rigid"),
        ("auto", "rk2", SLACK, {}, "links are rigid"),
        ("auto", "rattle", SLACK, STRETCHY, "the line is elastic"),
        ("auto", "theta", SLACK, ROD, "compound links couple"),
        ("auto", "semi_implicit_euler", SLACK, ROD, "compound links couple"),
        ("auto", "rattle", DRY, {}, "set-valued law"),
        ("auto", "thesis_angles", SLACK, ROD, "compound links couple"),
        ("lapack", "energy_momentum", SLACK, {}, "'lapack' is unknown"),
        ("auto", "energy_momentun", SLACK, {}, "energy_momentum"),
    ],
)
def test_pairings_that_make_no_sense_are_refused_with_their_reason(chain, solver, integrator, effects, line, reason):
    model, _ = hanging(chain, 4, True, effects, line)
    with pytest.raises(dj.SceneError, match=reason) as error:
        dj.make_stepper(model, integrator, solver)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("integrator", "gamma"), [("energy_momentum", 0.5), ("theta", 1.2), ("theta_midpoint", 0.4), ("thesis_angles", 0.0)]
)
def test_weights_that_a_scheme_does_not_take_are_refused(integrator, gamma):
    with pytest.raises(dj.SceneError, match=r"run\.gamma"):
        dj.make_stepper(build_model(dj.load_scene("string")), integrator, gamma=gamma)


def test_auto_takes_the_cheapest_solver_that_applies(chain):
    shapes = {"loop": "condensed", "compound loop": "banded", "viscous loop": "banded", "one link": "condensed"}
    for case, expected in shapes.items():
        *shape, _ = CASES[case]
        assert dj.make_stepper(hanging(chain, *shape)[0]).solver_name == expected
    assert dj.make_stepper(hanging(chain, 7, True, DRY, {})[0]).solver_name == "dense"


def test_a_model_without_effects_reaches_its_own_nodes_only(chain):
    model, _ = hanging(chain, 4, True, SLACK, {})
    assert Model(model.points, model.lines, ()).reach == 0
