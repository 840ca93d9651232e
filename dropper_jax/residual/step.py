"""A step is a residual: its solution by Newton's method, and the exact derivative of that solution.

    R(theta, u) = 0,    theta = (model, state, step)

The derivative follows from the implicit function theorem at the solution, never through the corrections:

    R_u du = -R_theta dtheta
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree

from dropper_jax.axial import SlackTangent
from dropper_jax.model import LimitsTimeStep, Model, State
from dropper_jax.residual.breaking import break_links, without_broken_links
from dropper_jax.residual.newton import Filter, Linear, Newton, correct_until_enough, newton, solve_smoothed
from dropper_jax.residual.problem import StepProblem, Unknowns
from dropper_jax.residual.scheme import Integrator

#: Residual assigned to a step in which nodes moved farther than an effect can follow (`model.LimitsTimeStep`).
TOO_FAR = 1e30
#: Largest scaled row of a converged step. Rounding gives 1e-14 (7 links) to 1e-12 (1000 links, nodes far from the
#: origin) in float64, and about 1e-5 in float32.
TOLERANCE = {"float64": 1e-11, "float32": 1e-4}

#: What a step depends on, theta: model, state at its start, length [s].
StepInputs = tuple[Model, State, Array]


@dataclass(frozen=True, kw_only=True)
class Stepper(Newton):
    """Static choices of a step: a scheme, and Newton's method on its equations.

    Attributes:
        integrator: the scheme.
        tolerance: maximum scaled row of a converged step; None: that of the model's precision (`TOLERANCE`).
        easing: whether a step with set-valued laws that does not converge is solved with smoothed laws.
        halvings: how often a step that does not converge is halved; 0: it is taken as it is, and reported.
        track_work: count the work of each effect in `State.work`.
        tangent: law of slack ropes in derivatives; None for that of the run.
    """

    integrator: Integrator
    tolerance: float | None = None
    easing: bool = False
    halvings: int = 0
    track_work: bool = True
    tangent: SlackTangent | None = None

    @property
    def plain(self) -> Stepper:
        """The same without halved steps: derivatives in both modes."""
        return replace(self, halvings=0)

    def limit(self, model: Model) -> float:
        """Maximum scaled row of a converged step."""
        if self.tolerance is None:
            return TOLERANCE[str(jnp.dtype(model.dtype))]
        return self.tolerance


def solve(stepper: Stepper, theta: StepInputs, filtering: Filter | None = None) -> tuple[Unknowns, Array, Array | None]:
    """The solution of a step, its largest scaled row, and what the matrix lets pass of the rows of `filtering`, (nodes,
    3); not differentiated."""
    model, s, h = jax.lax.stop_gradient(theta)
    problem = stepper.integrator.problem(model, s, h)
    tolerance = stepper.limit(model)
    filtered = None
    if filtering is None:
        u, row = newton(stepper, problem, tolerance)
    else:
        end = correct_until_enough(stepper, problem, tolerance, filtering)
        u, row, filtered = end.u, end.now, end.filtered
    if stepper.easing:
        u, row = jax.lax.cond(row <= tolerance, lambda: (u, row), lambda: solve_smoothed(stepper, problem))
    return u, row, filtered


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def solution(stepper: Stepper, theta: StepInputs, u: Unknowns) -> Unknowns:
    """u, which solves `R(theta, u) = 0`, as a function of theta."""
    return u


@partial(solution.defjvp, symbolic_zeros=True)
def _implicit_derivative(
    stepper: Stepper, primals: tuple[StepInputs, Unknowns], tangents: tuple[Any, Any]
) -> tuple[Unknowns, Unknowns]:
    theta, u = primals
    u = solution(stepper, theta, u)  # so that this rule can be differentiated again
    leaves, tree = jax.tree.flatten(theta)
    dots = jax.tree.leaves(tangents[0], is_leaf=lambda dot: isinstance(dot, SymbolicZero))
    moving = [i for i, dot in enumerate(dots) if not _is_zero(dot)]

    def problem_at(values: list[Array]) -> StepProblem:
        given = list(leaves)
        for i, value in zip(moving, values, strict=True):
            given[i] = value
        model, s, h = jax.tree.unflatten(tree, given)
        if stepper.tangent is not None:
            model = model.with_axial(model.line.axial.with_tangent(stepper.tangent))
        return stepper.integrator.problem(model, s, h)

    # reverse mode stores theta and u of a step, and takes the matrix again on its way back
    @jax.checkpoint
    def derivative(values: list[Array], u: Unknowns, dots: list[Array]) -> Unknowns:
        flat, unravel = ravel_pytree(u)

        def rows(values: list[Array], flat: Array) -> Array:
            return ravel_pytree(problem_at(values).residual(unravel(flat)))[0]

        def solve_by(matrix: Linear, scale: Array) -> Callable[..., Array]:
            return partial(refine, lambda b: ravel_pytree(matrix.apply(unravel(b)))[0], scale)

        problem = problem_at(values)
        matrix = stepper.linearise(problem, u)
        _, jacobian = jax.linearize(partial(rows, values), flat)
        _, change = jax.jvp(lambda values: rows(values, flat), (values,), (dots,))
        forward = solve_by(matrix, _flat_scale(problem.column_scale(), u))
        backward = solve_by(matrix.transpose(), 1.0 / _flat_scale(problem.row_scale(), u))
        # one flat vector: JAX transposes a linear solve only if its whole right side is linear in the tangents
        return unravel(jax.lax.custom_linear_solve(jacobian, -change, forward, backward))

    return u, derivative([leaves[i] for i in moving], u, [dots[i] for i in moving])


def _is_zero(dot: Any) -> bool:
    return isinstance(dot, SymbolicZero) or dot.dtype == jax.dtypes.float0


def _flat_scale(scale: Unknowns, like: Unknowns) -> Array:
    return ravel_pytree(jax.tree.map(lambda size, a: jnp.broadcast_to(size, a.shape), scale, like))[0]


def refine(
    apply: Callable[[Array], Array],
    scale: Array,
    product: Callable[[Array], Array],
    b: Array,
) -> Array:
    """`J x = b` with `apply` = P^-1 as preconditioner: `x <- x + P^-1 (b - J x)`, until x stops changing.

    It ends if a correction is below 1000 rounding errors of x, or no longer decreases. `scale` are sizes of x.
    """

    def size(x: Array) -> Array:
        return jnp.max(jnp.abs(x) / scale)

    def unsolved(carry: tuple[Array, ...]) -> Array:
        x, change, before, count = carry
        rounding = 1e3 * jnp.finfo(x.dtype).eps * size(x)
        # maximum number of corrections: the condensed solver needs about as many as Newton
        return (change > rounding) & (count < 200) & ((change < before) | (count < 8))

    def correct(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        x, change, _, count = carry
        dx = apply(b - product(x))
        return x + dx, size(dx), change, count + 1

    x = apply(b)
    change = size(x)
    start = x, change, jnp.full_like(change, jnp.inf), jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(unsolved, correct, start)[0]


# inlined in programs; called alone it is one, compiled once
@partial(jax.jit, static_argnames="stepper", inline=True)
def step(stepper: Stepper, model: Model, s: State, h: Array) -> tuple[State, Array]:
    """The state after a step of h [s], and the largest scaled row of its equations (NaN if it is not finite).

    A step above `stepper.limit(model)` has failed; it never raises. Differentiable in both modes by model, s and h.
    """
    h = jnp.asarray(h, model.dtype)
    integrator = stepper.integrator
    acting, start = without_broken_links(model, s)
    if not integrator.implicit:
        s1 = integrator.advance(acting.with_internal_state(start.own), start, h)
        row = explicit_row(acting, start, s1)
    elif len(integrator.stages) == 1:
        s1, row, _ = solve_and_finish(stepper, (acting, start, h))
    else:

        def stage(s: State, fraction: Array) -> tuple[State, Array]:
            return solve_and_finish(stepper, (acting, s, fraction * h))[:2]

        # a scan, not an unrolled loop: five copies of a step would take five times as long to compile
        s1, rows = jax.lax.scan(stage, jax.tree.map(jnp.asarray, start), jnp.asarray(integrator.stages, model.dtype))
        row = jnp.max(rows)
    return break_links(model, acting, s, s1), row


def step_and_filter(
    stepper: Stepper, model: Model, s: State, h: Array, filtering: Filter
) -> tuple[State, Array, Array]:
    """`step` of a scheme of one stage, and what its matrix lets pass of the rows of `filtering`, (nodes, 3)."""
    acting, start = without_broken_links(model, s)
    s1, row, filtered = solve_and_finish(stepper, (acting, start, h), filtering)
    return break_links(model, acting, s, s1), row, filtered


def solve_and_finish(stepper: Stepper, theta: StepInputs, filtering: Filter | None = None) -> tuple[State, Array, Any]:
    """The state after an implicit step, its largest scaled row, and what `solve` filters: (nodes, 3), None without
    `filtering`."""
    u, row, filtered = solve(stepper, theta, filtering)
    s1 = stepper.integrator.problem(*theta).finish(solution(stepper, theta, u))
    model, s, _ = theta
    return s1, mark_too_far(*jax.lax.stop_gradient((model, s, s1)), row), filtered


def explicit_row(model: Model, s: State, s1: State) -> Array:
    """The row of an explicit step from s to s1, which solves nothing: 0, or what is wrong with it."""
    finite = jnp.all(jnp.isfinite(s1.r)) & jnp.all(jnp.isfinite(s1.v))
    row = jnp.where(finite, 0.0, jnp.nan).astype(model.dtype)
    return mark_too_far(model, s, s1, row)


def mark_too_far(model: Model, s: State, s1: State, row: Array) -> Array:
    """The largest row of a step from s to s1; `TOO_FAR` if nodes moved farther than an effect can follow."""
    watching = model.effects_with(LimitsTimeStep)
    if not watching:
        return row
    ends = tuple(model.kinematics(now.r, now.v, now.t) for now in (s, s1))
    far = jnp.any(jnp.stack([effect.too_far(*ends) for effect in watching]))
    return jnp.where(far, jnp.maximum(row, TOO_FAR), row)  # a NaN remains NaN
