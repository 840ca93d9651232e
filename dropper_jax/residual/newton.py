"""Newton's method on the equations of a step: corrections, how many, and each by which matrix.

    u <- u - P^-1 R(u)

P is the Jacobian that the solver takes from `jax.jacfwd`; a solver may leave something out. The scheme writes the
residual (`StepProblem`), the solver takes and factors the matrix (`Solver`); this module knows neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.numerics import store_once
from dropper_jax.model import Model
from dropper_jax.residual.problem import StepProblem, Unknowns
from dropper_jax.residual.scheme import Implicit

#: Rows within the tolerance that fall by less than this factor per correction are rounding. With 0.3, energy of a loop
#: of 1 g between 10 kg drifts by 1.2e-6 of its scale; with 0.6 by 3e-10.
FALLING = 0.6
#: Corrections from this one on are full: a link that changes between slack and taut may make the rows larger first.
#: Retried steps of a snapping chain fall from 36 to 0 with `generalized_alpha`, from 64 to 25 with `energy_momentum`.
FULL_FROM = 12
#: Smoothings of set-valued laws, one correction each, as fractions of the rate that friction stops within the step.
EASING = (1.0,) * 3 + tuple(0.4**k for k in range(1, 31)) + (0.0,) * 4


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
    filtered = None
    if filtering is not None:
        filtered = jnp.zeros_like(guess.x)
    # The guess is evaluated by a correction of zero, so that the rows are in the program once: with a second copy
    # systems of lines compile up to twice as long.
    far = jnp.full((), jnp.inf, guess.x.dtype)
    none = jnp.zeros((), jnp.int32)
    start = Corrections(guess, jax.tree.map(jnp.zeros_like, guess), far, far, none - 1, none, filtered)
    rule = _CorrectionRule(method, problem, problem.row_scale(), tolerance, filtering)
    return jax.lax.while_loop(rule.is_unsolved, rule.correct_with_one_matrix, start)


class _CorrectionRule(NamedTuple):
    """How a step is corrected, and until when.

    Attributes:
        scale: of the rows.
        tolerance: maximum scaled row of a converged step.
    """

    method: Newton
    problem: StepProblem
    scale: Unknowns
    tolerance: Array | float
    filtering: Filter | None

    def is_unsolved(self, c: Corrections) -> Array:
        """Whether another correction is needed and may help."""
        method = self.method
        # a NaN compares false: no correction removes it
        falling = (c.now > self.tolerance) | (c.now < FALLING * c.before)
        enough = self.tolerance * (method.enough or 0.0)
        wanted = (c.now > enough) & falling & (c.count < method.iterations)
        return (c.count < method.least) | wanted

    def correct_with_one_matrix(self, c: Corrections) -> Corrections:
        """Corrections with the matrix taken here, as long as it serves."""
        method = self.method
        matrix = method.linearise(self.problem, c.u)
        first = c.count

        def serves(c: Corrections) -> Array:
            # rows below the tolerance fall slowly because they are rounding, which no other matrix removes
            fast = c.now < method.renew * jnp.maximum(c.before, self.tolerance)
            still_good = (c.count == 0) | fast | (c.halved > 0)
            return (c.count == first) | (self.is_unsolved(c) & still_good)

        end = jax.lax.while_loop(serves, partial(self.correct, matrix), c)
        if self.filtering is not None:
            end = end._replace(filtered=matrix.apply(self.filtering(self.problem, end.u)).x)
        return end

    def correct(self, matrix: Linear, c: Corrections) -> Corrections:
        """One correction; one that does not make the rows smaller is taken back and halved, if the method may."""
        method = self.method
        fraction = 1.0
        if method.shortened:
            fraction = jnp.asarray(0.5, c.now.dtype) ** c.halved
        u = subtract(c.u, matrix.apply(c.rows), fraction)
        rows = store_once(self.problem.residual(u))
        row = largest_row(rows, self.scale)
        after = Corrections(u, rows, row, c.now, c.count + 1, jnp.zeros_like(c.halved), c.filtered)
        if not method.shortened:
            return after
        may_shorten = (c.halved < method.shortened) & (c.count < FULL_FROM)
        worse = may_shorten & ~((after.now < c.now) | (after.now <= self.tolerance))
        shorter = c._replace(count=c.count + 1, halved=c.halved + 1)
        return jax.tree.map(partial(jnp.where, worse), shorter, after)


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
