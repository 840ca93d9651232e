"""Static equilibrium as a function of model and loads, with exact derivatives.

    R(theta, u) = 0,    du = -R_u^-1 R_theta dtheta        (theta: model and loads, u: positions and tensions)

The equilibrium is solved on the host (`search`), or from a given nearby one in the compiled program. Its derivatives
follow from the implicit function theorem, by one linear solve at the equilibrium.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jax.flatten_util import ravel_pytree

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State, state
from dropper_jax.residual import largest_row
from dropper_jax.statics.descent import descend, unbalance
from dropper_jax.statics.equilibrium import Equilibrium
from dropper_jax.statics.loads import given_loads
from dropper_jax.statics.moves import moves_of
from dropper_jax.statics.rest_problem import MIN_KAPPA, RestProblem, rest, rest_tolerance, soft_scale, system_tolerance
from dropper_jax.statics.search import search
from dropper_jax.statics.static_friction import static_seabed_friction, with_static_seabed_friction
from dropper_jax.statics.tangent import Linear, solve_linear


def equilibrium(model: Model, loads: Array | None = None, t: float = 0.0, near: State | None = None) -> Equilibrium:
    """The equilibrium of the model at time t under additional nodal `loads` (free nodes, 3) [N].

    Works for hanging strings, slack loops, ends at different heights or at the same point, nearly taut loops, and
    lifted nodes. It is solved on the host.

    Differentiable in model and loads, forward and reverse, by the implicit function theorem (see `settle`): inside
    `grad`, `jvp` and `jacfwd` the equilibrium is also solved on the host; inside `jit` and `vmap` it is the one next to
    `near`. If a link is on the verge of going slack, or a node of touching the seabed, the derivative is one-sided.

    Args:
        loads: additional forces on the free nodes (free nodes, 3) [N].
        t: time [s], for ends that move.
        near: initial configuration, such as the equilibrium of another design: Newton from there, not on the host.

    Raises:
        SceneError: the shape of the line is undetermined (no weight); traced values without `near`.
    """
    if near is not None or _is_traced((model, loads)):
        return _differentiable(model, loads, t, near)
    return search(model.with_lengths(t, still=True), loads, t)


def _is_traced(tree: object) -> bool:
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def _differentiable(model: Model, loads: Array | None, t: float, near: State | None) -> Equilibrium:
    """The equilibrium next to a given one, or next to one solved on the host for the primal values."""
    is_equilibrium = near is None
    if near is None:
        near = _find_on_host(model, loads, t)
    near = replace(near, t=jnp.asarray(t, model.dtype))
    loads = given_loads(model, loads)
    still = model_at_rest(model, near, loads)
    s = _state_at_rest(model, equilibrium_near(still, near, loads, is_equilibrium))
    if _is_elastic(still):
        residual = unbalance(still, s, loads)
    else:
        problem = RestProblem(still, s, loads)
        residual = largest_row(problem.residual(problem.guess()), problem.row_scale())
    status = "ok"
    message = ""
    if _is_traced((model, s)):
        status = "traced"
    elif not float(residual) <= NEAR_TOLERANCE * system_tolerance(still):
        status = "not_converged"
        message = "no equilibrium found next to the given configuration"
    return Equilibrium(model.nodes(s.r, model.ends(s.t)), s.tension, residual, status, message, s)


def _find_on_host(model: Model, loads: Array | None, t: float) -> State:
    """The equilibrium of the primal values of a differentiated model and its loads."""
    primal = jax.lax.stop_gradient((model, loads))
    if _is_traced(primal):
        raise SceneError("near: missing inside jit or vmap. Use `equilibrium(...).state` of a similar design")
    found = equilibrium(*primal, t)
    if found.status != "ok":
        raise SceneError(f"equilibrium: {found.message}")
    return found.state


def settle(model: Model, near: State, loads: Array | None = None, is_equilibrium: bool = False) -> State:
    """The equilibrium next to `near`, as a differentiable, batchable function of model and loads.

    Newton from `near` (found once with `equilibrium`); derivatives by the implicit function theorem. Lines that stretch
    are solved in O(n); rigid ones, and rigid bodies, with dense matrices. Positions are NaN if no equilibrium is
    found. Derivatives are NaN if the change of the forces acts on an unconstrained motion.

    Args:
        near: initial configuration of Newton's method.
        loads: additional forces on the free nodes (free nodes, 3) [N].
        is_equilibrium: `near` is the equilibrium of this model: nothing moves, only derivatives are computed, in a
            smaller program.
    """
    loads = given_loads(model, loads)
    still = model_at_rest(model, near, loads)
    return _state_at_rest(model, equilibrium_near(still, near, loads, is_equilibrium))


def _state_at_rest(model: Model, pose: State) -> State:
    return state(model, pose.r, tension=pose.tension, t=pose.t)


#: Number of corrections of rigid lines, and the maximum number of those of other lines.
RIGID_CORRECTIONS = 12
NEAR_CORRECTIONS = 100
#: Residual of an equilibrium next to a given one over the tolerance of the search on the host, up to which it is one:
#: the two are computed by different programs.
NEAR_TOLERANCE = 2.0


def model_at_rest(full: Model, near: State, loads: Array) -> Model:
    """The model whose forces balance in the equilibrium: at rest, with the static friction of the seabed."""
    model = rest(full.with_lengths(near.t, still=True))
    friction = static_seabed_friction(full)
    if friction is None or not _is_elastic(model):
        return model
    without_friction = equilibrium_near(model, near, loads)
    return with_static_seabed_friction(model, without_friction, friction.kinetic)[0]


def _is_elastic(model: Model) -> bool:
    """Whether the lines stretch; those of a scene with rigid bodies do."""
    return bool(model.constraints) or model.line.axial.elastic


def equilibrium_near(model: Model, near: State, loads: Array, is_equilibrium: bool = False) -> State:
    """The equilibrium next to `near` of a model at rest, differentiable.

    With `is_equilibrium` it is `near` itself, which is not checked again: only its derivatives are computed.
    """
    if _is_elastic(model):
        return _elastic_near(model, near, loads, is_equilibrium)
    return _rigid_near(model, near, loads, is_equilibrium)


def _rigid_near(model: Model, near: State, loads: Array, is_equilibrium: bool) -> State:
    """The equilibrium of rigid lines next to `near`, by Newton's method with dense matrices; its positions are NaN if
    there is no equilibrium."""
    near = replace(jax.lax.stop_gradient(near), t=near.t)
    problem = RestProblem(model, near, loads)
    flat, unravel = ravel_pytree(problem.guess())

    def rows(x: Array) -> Array:
        return ravel_pytree(problem.residual(unravel(x)))[0]

    def find(rows: Linear, x: Array) -> Array:
        def correct(_: Array, y: Array) -> Array:
            return y - jnp.linalg.solve(jax.jacfwd(rows)(y), rows(y))

        if is_equilibrium:
            return x
        return jax.lax.fori_loop(0, RIGID_CORRECTIONS, correct, x)

    def tangent(linear: Linear, b: Array) -> Array:
        return jnp.linalg.solve(jax.jacfwd(linear)(jnp.zeros_like(b)), b)

    u = unravel(jax.lax.custom_root(rows, flat, find, tangent))
    r = near.r + u.x
    if not is_equilibrium:
        size = jax.lax.stop_gradient(largest_row(problem.residual(u), problem.row_scale()))
        r = jnp.where(size <= NEAR_TOLERANCE * rest_tolerance(model), r, jnp.nan)
    return replace(near, r=r, tension=u.y)


@partial(jax.jit, static_argnames="is_equilibrium", inline=True)
def _elastic_near(model: Model, near: State, loads: Array, is_equilibrium: bool) -> State:
    """The equilibrium of lines that stretch next to `near`; its positions are NaN if there is no equilibrium."""
    t = near.t
    near = jax.lax.stop_gradient(near)
    if not is_equilibrium:
        fixed, acting = jax.lax.stop_gradient((model, loads))
        tolerance = rest_tolerance(fixed)
        found, size = descend(fixed, near, acting, tolerance, MIN_KAPPA * soft_scale(fixed), NEAR_CORRECTIONS)
        near = replace(near, r=jnp.where(size <= tolerance, found.r, jnp.nan))
    moves = moves_of(model)
    near = replace(near, t=t)
    rows = partial(moves.rows, near, loads)
    kappa = jax.lax.stop_gradient(MIN_KAPPA * soft_scale(model))
    x = jax.lax.custom_root(rows, moves.zero_displacement, lambda _, x: x, partial(solve_linear, moves.tangent, kappa))
    return moves.move_pose(near, loads, x)
