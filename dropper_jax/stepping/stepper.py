"""Scheme, solver and settings of the stepping: rules for choosing or rejecting them; the report of a step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from functools import partial, wraps
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

from dropper_jax.backend.one_kernel import inside, is_inside
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.integrators import INTEGRATORS, OPTIONS
from dropper_jax.model import LimitsTimeStep, Model, State
from dropper_jax.residual import (
    CONVERGED,
    Implicit,
    Integrator,
    Unknowns,
    damped_newton,
    newton,
    newton_until,
)
from dropper_jax.solvers import SOLVERS

P = ParamSpec("P")
R = TypeVar("R")


def make_stepper(
    model: Model,
    integrator: str = "energy_momentum",
    solver: str = "auto",
    **settings: Any,
) -> Stepper:
    """Choose integrator and solver for a model; invalid combinations are rejected with the reason.

    `settings` are options of the scheme (gamma, rho_infinity; None for its default) and fields of `Stepper`
    (iterations, tolerance, extra, halvings, track_work). `auto` selects the condensed solver if it applies, else dense
    for few unknowns, else banded.

    Raises:
        SceneError: an unknown name, or a combination that cannot run the model.
    """
    check_names(integrator, solver)
    check_settings(settings, [*OPTIONS, *stepper_settings()])
    options = {key: settings.pop(key) for key in OPTIONS if key in settings}
    scheme = make_scheme(integrator, options).form_for(model)
    reason = scheme.refuse(model)
    if reason:
        raise SceneError(f"run.integrator: {integrator!r} cannot run this scene: {reason}")
    if not scheme.implicit:
        if solver != "auto":
            raise SceneError(f"run.solver: {solver!r} is given, but integrator {integrator!r} solves nothing; use auto")
        if settings.pop("iterations", None) is not None:
            raise SceneError(f"iterations: are given, but integrator {integrator!r} solves nothing. Leave them out")
        return Stepper(scheme, "none", "none", 0, **settings)
    if solver != "auto" and (reason := SOLVERS[solver].refuse(model, scheme)):
        raise SceneError(f"run.solver: {solver!r} cannot serve this scene: {reason}")
    chosen = _choose(model, scheme) if solver == "auto" else solver
    if model.geometry.branched:
        # maximum number of Newton corrections of a step of a system of lines; a step that needs more is halved
        settings = {"iterations": 16, "until_converged": True, **settings}
        return Stepper(scheme, chosen, chosen, settings.pop("iterations"), **settings)
    iterations = settings.pop("iterations", None)
    if iterations is None:
        iterations = scheme.condensed_iterations if chosen == "condensed" else scheme.iterations
        if settings.get("extra") == 0:  # no later stage follows
            iterations = max(iterations, scheme.iterations)
    if model.laws:  # more iterations do not help: which joints stick must be determined first (`follow`)
        settings.setdefault("extra", 0)
    return Stepper(scheme, chosen, _exact(model, scheme), iterations, **settings)


def make_scheme(name: str, options: Mapping[str, float | None]) -> Integrator:
    """The scheme of this name with its options; None means its default.

    Raises:
        SceneError: an option that the scheme does not have or that is out of range.
    """
    cls = INTEGRATORS[name]
    given = {key: value for key, value in options.items() if value is not None}
    for key, value in given.items():
        if key not in cls.options():
            why = f"is given, but integrator {name!r} has no such weight. Leave it out"
            raise SceneError(f"run.{key}: {value} {why}")
    return cls(**{key: float(value) for key, value in given.items()})


def check_names(integrator: str, solver: str) -> None:
    """Reject unknown names."""
    if integrator not in INTEGRATORS:
        raise SceneError(f"run.integrator: {integrator!r} is unknown; {nearest(integrator, INTEGRATORS)}")
    if solver != "auto" and solver not in SOLVERS:
        raise SceneError(f"run.solver: {solver!r} is unknown; {nearest(solver, [*SOLVERS, 'auto'])}")


def check_settings(settings: Iterable[str], known: Iterable[str]) -> None:
    """Reject unknown keywords of the functions that pass their further settings to `make_stepper`."""
    known = list(known)
    for name in settings:
        if name not in known:
            raise SceneError(f"{name}: unknown setting; {nearest(name, known)}")


def stepper_settings() -> list[str]:
    """Names of the fields of `Stepper` that can be set; integrator and solvers are chosen by their names."""
    return [field.name for field in fields(Stepper) if field.name not in ("integrator", "solver", "fallback")]


def _choose(model: Model, scheme: Implicit) -> str:
    return "condensed" if SOLVERS["condensed"].refuse(model, scheme) is None else _exact(model, scheme)


def _exact(model: Model, scheme: Implicit) -> str:
    sparse = next((name for name in ("network", "banded") if SOLVERS[name].refuse(model, scheme) is None), "dense")
    # number of unknowns below which LU of the full Jacobian is faster than block elimination (measured at 3 compound
    # links)
    return "dense" if sparse == "banded" and SOLVERS["dense"].size(model) <= 16 else sparse


#: Residual assigned to a step in which nodes moved farther than an effect can follow (`model.LimitsTimeStep`).
TOO_FAR = 1e30
FULL_STEP = -1  # level of a step that needed no retry


@dataclass(frozen=True)
class Stepper:
    """Static settings of the stepping.

    Attributes:
        integrator: the scheme.
        solver, fallback: names of the first and the last-resort linear solver.
        iterations: Newton iterations of every step.
        tolerance: maximum scaled residual of a converged step; None means that of the model's precision.
        extra: further iterations of the first solver before the fallback.
        halvings: maximum number of halvings of a step; 0 disables retries.
        track_work: count the work of each effect in `State.work`.
        until_converged: iterate each step until it has converged, at most `iterations` times, and halve it if it has
        not;
            for systems of lines.
        reverse: derivatives in both modes; False means forward mode only and leaves the transposed step out of all
        traces.
        batched: the step is in a batch: the library of the device solves its systems, or `lanes` those of all members
        at once, and not the form for one kernel.
        one_kernel: whether tridiagonal systems are solved in the form that one kernel can contain; None: where the
            stepping is traced by `dj.one_kernel`.
        follows: the iterations of a step follow its tangents (`newton_until`).
    """

    integrator: Integrator
    solver: str
    fallback: str
    iterations: int
    tolerance: float | None = None
    extra: int = 48
    halvings: int = 6
    track_work: bool = True
    until_converged: bool = False
    reverse: bool = True
    batched: bool = False
    one_kernel: bool | None = None
    follows: bool = False

    @property
    def plain(self) -> Stepper:
        """The same settings without fallback solvers: half of the code to compile."""
        return replace(self, extra=0, halvings=0) if self.iterations else self

    @property
    def as_traced(self) -> Stepper:
        """The same settings with the choice of `one_kernel` for what is being traced, as part of all cached traces."""
        return self if self.one_kernel is not None else replace(self, one_kernel=is_inside())

    def solving(self) -> AbstractContextManager[None]:
        """Trace the systems of a step in the chosen form."""
        return inside(False if self.batched else self.one_kernel)

    def limit(self, model: Model) -> float:
        """Maximum scaled residual row of a converged step.

        Rounding gives about 1e-14 (7 links) to 1e-12 (1000 links, nodes far from the origin) in float64; in float32
        about 1e-5.
        """
        default = {"float64": 1e-11, "float32": 1e-4}
        return default[str(jnp.dtype(model.dtype))] if self.tolerance is None else self.tolerance


class Report(NamedTuple):
    """Result of a step.

    Attributes:
        residual: maximum scaled row at its end (NaN if not finite).
        level: -1 if the step converged at once, k >= 0 if it needed 2^k substeps of the fallback solver.
    """

    residual: jax.Array
    level: jax.Array


def in_chosen_form(f: Callable[Concatenate[Stepper, P], R]) -> Callable[Concatenate[Stepper, P], R]:
    """`f` with the systems of a step traced as the stepper chooses (`Stepper.solving`)."""

    @wraps(f)
    def call(stepper: Stepper, *args: P.args, **kwargs: P.kwargs) -> R:
        with stepper.solving():
            return f(stepper, *args, **kwargs)

    return call


# Solve one step: check the residual, escalate, report. This code is never differentiated.
#
# Escalation, each stage only if the residual of the previous one is above tolerance (or NaN):
# 1. more iterations of the same solver;
# 2. damped iterations of the exact solver over the full step;
# 3. damped iterations over 2, 4, 8, ... substeps.
# Stages are in `while_loop`s without an iteration if the step converged, also under `vmap`.


@in_chosen_form
def solve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """End state, unknowns, residual and level of a step, without a derivative rule."""
    if stepper.until_converged:
        return _solve_or_halve(stepper, model, s, h, alive)
    problem = stepper.integrator.problem(model, s, h)
    solver, limit, seen = SOLVERS[stepper.solver], stepper.limit(model), None
    if model.laws:
        u, residual, seen = newton_until(problem, solver, problem.guess(), stepper.iterations, CONVERGED * limit)
    else:
        extra = jnp.where(alive, stepper.extra, 0) if stepper.extra else None
        u, residual = newton(problem, solver, problem.guess(), stepper.iterations, limit, extra)
    first = problem.finish(u, seen), residual, jnp.full((), FULL_STEP, jnp.int32)
    s1, residual, level = _halve(stepper, model, s, h, alive, first) if stepper.halvings else first
    return s1, u, residual, level


def _solve_or_halve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array) -> tuple[Any, ...]:
    """The full step, then 2, 4, 8, ... equal substeps, with a single copy of the step equations in the program.

    Used for systems of lines: a second copy of their equations would double the compile time.
    """
    if not stepper.halvings:
        return *substep(stepper, model, s, h), jnp.full((), FULL_STEP, jnp.int32)
    limit = stepper.limit(model)
    problem = stepper.integrator.problem(model, s, h)
    unsolved = jnp.full((), jnp.inf, model.dtype)
    start = jax.tree.map(jnp.asarray, s), problem.guess(), unsolved, jnp.full((), FULL_STEP - 1, jnp.int32)

    def resist(carry: tuple[Any, ...]) -> jax.Array:
        _, _, residual, level = carry
        return (level < FULL_STEP) | (~(residual <= limit) & (level < stepper.halvings) & alive)

    def attempt(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        level = jnp.where(carry[3] == FULL_STEP, 1, carry[3] + 1)  # one substep would repeat the full step
        pieces = 2 ** jnp.maximum(level, 0)

        def piece(i: jax.Array, inner: tuple[Any, ...]) -> tuple[Any, ...]:
            now, _, worst = inner
            now, u, residual = substep(stepper, model, now, h / pieces)
            return now, u, jnp.maximum(worst, residual)

        s1, u, worst = jax.lax.fori_loop(0, pieces, piece, (start[0], start[1], jnp.zeros_like(unsolved)))
        return s1, u, worst, level

    return jax.lax.while_loop(resist, attempt, start)


@in_chosen_form
def substep(stepper: Stepper, model: Model, s: State, h: jax.Array) -> tuple[State, Unknowns, jax.Array]:
    """One substep by the fallback solver, damped."""
    problem = stepper.integrator.problem(model, s, h)
    solver = SOLVERS[stepper.fallback]
    if stepper.until_converged:
        still = stepper.integrator.problem(*jax.lax.stop_gradient((model, s, h))) if stepper.follows else None
        limit = stepper.limit(model)
        u, residual, seen = newton_until(problem, solver, problem.guess(), stepper.iterations, limit, still)
        s1 = problem.finish(u, seen)
        return s1, u, limit_pace(*jax.lax.stop_gradient((model, s, s1)), residual)
    u, residual = damped_newton(problem, solver, problem.guess(), 3 * stepper.integrator.iterations)
    return problem.finish(u), u, residual


def limit_pace(model: Model, s: State, s1: State, residual: jax.Array) -> jax.Array:
    """The residual of a step from s to s1; `TOO_FAR` if nodes moved farther than an effect can follow."""
    watching = model.having(LimitsTimeStep)
    if not watching:
        return residual
    ends = tuple(model.kinematics(now.r, now.v, now.t) for now in (s, s1))
    far = jnp.any(jnp.stack([effect.too_far(*ends) for effect in watching]))
    return jnp.where(far, jnp.maximum(residual, TOO_FAR), residual)  # a NaN remains NaN


def _halve(stepper: Stepper, model: Model, s: State, h: jax.Array, alive: jax.Array, first: tuple[Any, ...]) -> Any:
    limit = stepper.limit(model)
    start = jax.tree.map(jnp.asarray, s)

    def go(carry: tuple[Any, ...]) -> jax.Array:
        _, residual, level = carry
        return ~(residual <= limit) & (level < stepper.halvings) & alive

    def retry(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        level = carry[2] + 1
        pieces = 2**level

        def piece(i: jax.Array, inner: tuple[State, jax.Array]) -> tuple[State, jax.Array]:
            now, worst = inner
            now, _, residual = substep(stepper, model, now, h / pieces)
            return now, jnp.maximum(worst, residual)

        done, worst = jax.lax.fori_loop(0, pieces, piece, (start, jnp.zeros_like(carry[1])))
        return done, worst, level

    return jax.lax.while_loop(go, retry, first)


solve_once = partial(jax.jit, static_argnums=0)(solve)


substep_once = partial(jax.jit, static_argnums=0)(substep)
