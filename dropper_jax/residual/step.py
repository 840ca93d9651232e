"""A step is a residual: Newton's method on it, and the exact derivative of its solution.

    R(theta, u) = 0,    u <- u - P^-1 R(u),    theta = (model, state, step)

P is the Jacobian that the solver takes from `jax.jacfwd`; a solver may leave something out. The derivative follows from
the implicit function theorem at the solution, never through the corrections:

    R_u du = -R_theta dtheta

The scheme writes the residual (`StepProblem`), the solver takes and factors the matrix (`Solver`); this module knows
neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree

from dropper_jax.axial import SlackTangent
from dropper_jax.base.numerics import store_once
from dropper_jax.model import LimitsTimeStep, Model, State
from dropper_jax.residual.breaking import break_links, without_broken_links
from dropper_jax.residual.problem import StepProblem, Unknowns
from dropper_jax.residual.scheme import Implicit, Integrator

#: Rows within the tolerance that fall by less than this factor per correction are rounding. With 0.3, energy of a loop
#: of 1 g between 10 kg drifts by 1.2e-6 of its scale; with 0.6 by 3e-10.
FALLING = 0.6
#: Corrections from this one on are full: a link that changes between slack and taut may make the rows larger first.
#: Retried steps of a snapping chain fall from 36 to 0 with `generalized_alpha`, from 64 to 25 with `energy_momentum`.
FULL_FROM = 12
#: Residual assigned to a step in which nodes moved farther than an effect can follow (`model.LimitsTimeStep`).
TOO_FAR = 1e30
#: Smoothings of set-valued laws, one correction each, as fractions of the rate that friction stops within the step.
EASING = (1.0,) * 3 + tuple(0.4**k for k in range(1, 31)) + (0.0,) * 4
#: Largest scaled row of a converged step. Rounding gives 1e-14 (7 links) to 1e-12 (1000 links, nodes far from the
#: origin) in float64, and about 1e-5 in float32.
TOLERANCE = {"float64": 1e-11, "float32": 1e-4}

#: What a step depends on, theta: model, state at its start, length [s].
StepInputs = tuple[Model, State, Array]


class Linear(Protocol):
    """A factored matrix."""

    def apply(self, rows: Unknowns) -> Unknowns:
        """`P^-1 rows`."""

    def transpose(self) -> Linear:
        """The transposed matrix, factored."""


class Solver(Protocol):
    """Takes a matrix from the residual; it may be approximate."""

    @property
    def name(self) -> str:
        """Its name in `[run]`."""

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        """Why it cannot solve the model with a scheme, or None."""

    def linearise(self, problem: StepProblem, u: Unknowns) -> Linear:
        """The factored matrix at the unknowns."""


@dataclass(frozen=True)
class Newton:
    """Newton's method: a solver, and how corrections are counted.

    Attributes:
        solver: takes the matrix; None where nothing is solved.
        iterations: number of corrections, or, with `enough`, their maximum number.
        enough: corrections end if the rows are below this fraction of the tolerance, or below the tolerance and no
            longer falling. None: a fixed number of corrections, each with a matrix of its own.
        least: minimum number of corrections. With 0 a guess below the tolerance is left alone.
        renew: the matrix is taken again if a correction leaves more than this fraction of the rows, or of the tolerance
            where that is larger; 0: every time.
        shortened: how often in turn a correction is halved that does not make the rows smaller, among the first
            `FULL_FROM`.
    """

    solver: Solver | None
    iterations: int = 4
    enough: float | None = None
    least: int = 1
    renew: float = 0.0
    shortened: int = 0

    @property
    def solver_name(self) -> str:
        """Name of the solver in `[run]`; `none` without one."""
        if self.solver is None:
            return "none"
        return self.solver.name

    def linearise(self, problem: StepProblem, u: Unknowns) -> Linear:
        """The factored matrix of the solver at the unknowns."""
        if self.solver is None:
            raise ValueError("solver: None is that of an explicit scheme, which solves nothing")
        return self.solver.linearise(problem, u)


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


def largest_row(rows: Unknowns, scale: Unknowns) -> Array:
    """The largest scaled row, a scalar; NaN if any row is."""
    pairs = zip(jax.tree.leaves(rows), jax.tree.leaves(scale), strict=True)
    return jnp.max(jnp.stack([jnp.max(jnp.abs(row) / size) for row, size in pairs]))


def subtract(u: Unknowns, du: Unknowns, factor: Array | float = 1.0) -> Unknowns:
    """u - factor du."""
    return jax.tree.map(lambda a, b: a - factor * b, u, du)


class Corrections(NamedTuple):
    """Newton's method between two corrections.

    Attributes:
        u, rows: the unknowns and their rows.
        now, before: the largest scaled row, and that before the last correction.
        count: number of corrections, -1 before the guess is evaluated.
        halved: how often the next correction is halved.
        filtered: see `Filter`, by the last matrix; None without one.
    """

    u: Unknowns
    rows: Unknowns
    now: Array
    before: Array
    count: Array
    halved: Array
    filtered: Array | None = None


#: Rows b of a problem and its unknowns: `P^-1 b` is what its matrix lets pass of them, such as an error of the step.
Filter = Callable[[StepProblem, Unknowns], Unknowns]


def newton(method: Newton, problem: StepProblem, tolerance: Array | float) -> tuple[Unknowns, Array]:
    """The unknowns after the corrections `u <- u - P^-1 R(u)`, and their largest scaled row.

    With `enough` None it is a scan of a fixed number of corrections, each with a matrix of its own. Otherwise the
    corrections end by `enough`, and a matrix serves the next ones as long as the rows fall fast (`renew`).
    """
    if method.enough is not None:
        end = correct_until_enough(method, problem, tolerance)
        return end.u, end.now

    def correct_once(u: Unknowns, _: None) -> tuple[Unknowns, None]:
        return subtract(u, method.linearise(problem, u).apply(problem.residual(u))), None

    u, _ = jax.lax.scan(correct_once, problem.guess(), None, length=method.iterations)
    return u, largest_row(problem.residual(u), problem.row_scale())


def correct_until_enough(
    method: Newton, problem: StepProblem, tolerance: Array | float, filtering: Filter | None = None
) -> Corrections:
    """Newton's method with `enough`; `filtering` uses its last matrix once more."""
    guess = problem.guess()
    scale = problem.row_scale()
    enough = tolerance * (method.enough or 0.0)

    def unsolved(c: Corrections) -> Array:
        # a NaN compares false: no correction removes it
        falling = (c.now > tolerance) | (c.now < FALLING * c.before)
        wanted = (c.now > enough) & falling & (c.count < method.iterations)
        return (c.count < method.least) | wanted

    def correct(matrix: Linear, c: Corrections) -> Corrections:
        fraction = 1.0
        if method.shortened:
            fraction = jnp.asarray(0.5, c.now.dtype) ** c.halved
        u = subtract(c.u, matrix.apply(c.rows), fraction)
        rows = store_once(problem.residual(u))
        after = Corrections(u, rows, largest_row(rows, scale), c.now, c.count + 1, jnp.zeros_like(c.halved), c.filtered)
        if not method.shortened:
            return after
        may_shorten = (c.halved < method.shortened) & (c.count < FULL_FROM)
        worse = may_shorten & ~((after.now < c.now) | (after.now <= tolerance))
        shorter = c._replace(count=c.count + 1, halved=c.halved + 1)
        return jax.tree.map(partial(jnp.where, worse), shorter, after)

    def correct_with_one_matrix(c: Corrections) -> Corrections:
        matrix = method.linearise(problem, c.u)
        first = c.count

        def serves(c: Corrections) -> Array:
            # rows below the tolerance fall slowly because they are rounding, which no other matrix removes
            fast = c.now < method.renew * jnp.maximum(c.before, tolerance)
            still_good = (c.count == 0) | fast | (c.halved > 0)
            return (c.count == first) | (unsolved(c) & still_good)

        end = jax.lax.while_loop(serves, partial(correct, matrix), c)
        if filtering is not None:
            end = end._replace(filtered=matrix.apply(filtering(problem, end.u)).x)
        return end

    # The guess is evaluated by a correction of zero, so that the rows are in the program once: with a second copy
    # systems of lines compile up to twice as long.
    far = jnp.full((), jnp.inf, guess.x.dtype)
    none = jnp.zeros((), jnp.int32)
    filtered = None
    if filtering is not None:
        filtered = jnp.zeros_like(guess.x)
    start = Corrections(guess, jax.tree.map(jnp.zeros_like, guess), far, far, none - 1, none, filtered)
    return jax.lax.while_loop(unsolved, correct_with_one_matrix, start)


def solve_smoothed(method: Newton, problem: StepProblem) -> tuple[Unknowns, Array]:
    """The same for set-valued laws whose active set is unknown: a scan of corrections with ever less smoothed laws.

    Newton on the laws themselves cycles if several joints stop at once. The primal-dual form of the smoothed law (Chan,
    Golub and Mulet 1999) allows full corrections while its unknowns are admissible.
    """
    laws = problem.model.laws

    def correct(u: Unknowns, easing: Array) -> tuple[Unknowns, None]:
        smoothed = problem.with_smoothing(easing)
        u = subtract(u, method.linearise(smoothed, u).apply(smoothed.residual(u)))
        admissible = tuple(law.admissible(z) for law, z in zip(laws, u.z, strict=False))
        return u._replace(z=admissible + u.z[len(laws) :]), None  # multipliers of constraints follow those of laws

    guess = problem.guess()
    u, _ = jax.lax.scan(correct, guess, jnp.asarray(EASING, guess.x.dtype))
    return u, largest_row(problem.residual(u), problem.row_scale())


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
