"""The equations of static equilibrium, and Newton's method on them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.axial import STRETCHING_LAWS
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.numerics import trace_once
from dropper_jax.base.records import names_of
from dropper_jax.effects.point_bodies import PointBodies
from dropper_jax.effects.seabed import Seabed
from dropper_jax.effects.spar_buoys import SparBuoys
from dropper_jax.model import Kinematics, Law, Model, State, state
from dropper_jax.residual import GRAVITY_SCALE, Newton, Solver, StepProblem, Unknowns, largest_row, newton, subtract
from dropper_jax.solvers import SOLVERS, Dense

#: Minimum kappa over the weight per length: prevents drift of unconstrained parts (a float in calm water).
MIN_KAPPA = 1e-9


def rest(model: Model) -> Model:
    """The model without set-valued laws and without waves.

    Dry friction allows many equilibria; the frictionless one is used. Waves are left out, a current is included.
    """
    sea = None
    if model.sea is not None:
        sea = model.sea.without_waves()
    return replace(model.without_slot(Law), sea=sea)


def require_stretching_links(model: Model) -> None:
    """Raise `SceneError` for rigid links, whose tensions do not follow from lengths."""
    if not model.line.axial.elastic:
        raise SceneError(f"line.axial.law: 'rigid' has no axial stiffness; allowed: {STRETCHING_LAWS}")


class RestProblem(StepProblem):
    """Unknowns: x = r - (the state's r), y = T, at rest at the state's time.

    kappa [N/m] makes the matrix of corrections stiffer and does not change the rows: `K + kappa` of one correction.
    """

    def __init__(self, model: Model, s: State, loads: Array, kappa: Array | float = 0.0) -> None:
        super().__init__(model, s, jnp.ones((), model.dtype))
        self.loads = loads
        self.kappa = kappa
        self.ends = model.ends(s.t)

    def guess(self) -> Unknowns:
        return Unknowns(jnp.zeros_like(self.s.r), self.s.tension)

    def instant(self, x: Array) -> Kinematics:
        return self.model.instant(self.s.r + x, jnp.zeros_like(x), self.s.t, self.ends)

    def node_rows(self, x: Array, z: tuple[Array, ...]) -> tuple[Array, tuple[Array, ...]]:
        stiffer = self.kappa * (x - jax.lax.stop_gradient(x))
        return stiffer - self.model.force(self.instant(x)) - self.loads, ()

    def link_vectors(self, x: Array) -> Array:
        return self.model.links(self.s.r + x, self.ends)

    def link_rows(self, d: Array, y: Array) -> tuple[Array, Array]:
        line = self.model.line
        force = y[:, None] * line.axial.direction(d, d, d, line.length)
        return force, line.axial.at_rest(d, y, line.length)

    def tension(self, x: Array) -> Array:
        """Tensions from the lengths of links (n,) [N]."""
        line = self.model.line
        d = self.link_vectors(x)
        return line.axial.tension(d, jnp.zeros_like(d), line.length)

    def row_scale(self) -> Unknowns:
        weight = force_scale(self.model) * jnp.ones((self.model.free_nodes, 1), self.model.dtype)
        return Unknowns(weight, self.model.line.length)


#: Fraction of the weight of the heaviest body that scales residual forces.
BODY_SHARE = 1e-2


def force_scale(model: Model, xp: ModuleType = jnp) -> Array:
    """Scale of residual forces, a scalar [N]: the mean weight of a link, or 1 % of that of a body.

    NumPy on the host: each operation on JAX arrays would be a separate program.
    """
    mass = xp.mean(xp.asarray(model.line.mass))
    if model.constraints:
        mass = xp.maximum(mass, BODY_SHARE * xp.max(xp.asarray(model.constraints[0].mass)))
    return GRAVITY_SCALE * mass


def soft_scale(model: Model, xp: ModuleType = jnp) -> Array:
    """Scale of stiffness, a scalar [N/m]: the mean weight of a link per its length. NumPy on the host."""
    return force_scale(model, xp) / xp.mean(xp.asarray(model.line.length))


#: Minimum rounding error of scaled rows, in units of the last place.
ROUNDING_UNITS = 1e4


def rest_tolerance(model: Model, xp: ModuleType = jnp) -> Array:
    """Maximum scaled row (forces by m g, elongations by L) of a converged equilibrium, a scalar.

    It is 1e-10, or 1e-9 with bodies, whose buoyancies are large, or the rounding error of stiff lines or of the weight
    of points. NumPy on the host.
    """
    tolerance = 1e-9 if model.constraints else 1e-10
    line = model.line
    length = xp.asarray(line.length)
    stiffness = 0.0
    if line.axial.elastic:
        stiffness = xp.max(xp.asarray(line.axial.axial_stiffness()) / length)
    bed = model.effect("seabed")
    if isinstance(bed, Seabed):
        contact = xp.max(xp.asarray(bed.stiffness)) * xp.max(xp.asarray(line.diameter) * length)
        stiffness = xp.maximum(stiffness, contact)
    extent = xp.max(xp.abs(xp.stack([xp.asarray(p.position) for p in model.points]))) + xp.max(length)
    largest = stiffness * extent
    for effect in model.effects:
        if isinstance(effect, PointBodies | SparBuoys):
            largest = xp.maximum(largest, GRAVITY_SCALE * xp.max(xp.asarray(effect.mass)))
    units = xp.maximum(ROUNDING_UNITS, 10.0 * largest / force_scale(model, xp))
    return xp.maximum(tolerance, jnp.finfo(model.dtype).eps * units)


def system_tolerance(model: Model) -> float:
    """The tolerance as a Python number."""
    return float(rest_tolerance(model, np))


@cached_jit()
def unbalanced(model: Model, s: State, loads: Array) -> tuple[Array, Array]:
    """Unbalanced forces (free, 3) [N] in a configuration, and the tensions there."""
    return unbalanced_at(model, s, loads, jnp.zeros_like(s.r))


def balanced(model: Model, s: State, loads: Array) -> State:
    """The state with tensions from its lengths."""
    return state(model, s.r, tension=RestProblem(model, s, loads).tension(jnp.zeros_like(s.r)), t=s.t)


@trace_once  # a program that searches for an equilibrium uses it five times
def unbalanced_at(model: Model, s: State, loads: Array, x: Array) -> tuple[Array, Array]:
    """Unbalanced forces, minus F (free, 3) [N], at positions s.r + x, and the tensions of the links there."""
    problem = RestProblem(model, s, loads)
    tension = problem.tension(x)
    return problem.residual(Unknowns(x, tension)).x, tension


#: Maximum number of unknowns for LU of the full Jacobian.
MAX_DENSE_UNKNOWNS = 200


def rest_solver(model: Model) -> Solver:
    """The cheapest solver of the exact Jacobian for the model; the network solver is for systems."""
    if not model.geometry.is_path:
        if model.node_reach > 0:
            return SOLVERS["dense"]
        return SOLVERS["network"]
    if Dense().size(model) <= MAX_DENSE_UNKNOWNS:
        return SOLVERS["dense"]
    return SOLVERS["banded"]


@cached_jit(static=("iterations", "damped"))
def polish(
    model: Model, s: State, loads: Array, kappa: Array, iterations: int = 25, damped: bool = True
) -> tuple[State, Array]:
    """The equilibrium near `s`, and its maximum scaled row: Newton on positions and tensions together.

    Tensions are unknowns, which rigid links require. kappa [N/m] stiffens the corrections: a small value fixes free
    motions (rotation of a line with its ends on one vertical), a large value gives small steps of a descent.
    """
    problem = RestProblem(model, s, loads, kappa)
    if damped:
        u, residual = _search_along_corrections(problem, rest_solver(model), iterations)
    else:
        u, residual = newton(Newton(rest_solver(model), iterations), problem, rest_tolerance(model))
    return state(model, s.r + u.x, tension=u.y, t=s.t), residual


#: Fractions of a correction that are tried.
CORRECTION_FRACTIONS = (1.0, 0.5, 0.2, 0.05)


def _search_along_corrections(problem: RestProblem, solver: Solver, iterations: int) -> tuple[Unknowns, Array]:
    """The unknowns after corrections of which each is as long as makes the rows smallest, and their largest scaled row.

    A start may be far from the equilibrium, and the fraction with the smallest rows is taken even if they grow: the
    corrections of `newton`, which are halved until the rows fall, end in other equilibria of lifted droppers.
    """
    guess = problem.guess()
    scale = problem.row_scale()
    fractions = jnp.asarray(CORRECTION_FRACTIONS, guess.x.dtype)
    never = jnp.full((), jnp.inf, guess.x.dtype)

    def correct(now: tuple[Unknowns, ...], _: None) -> tuple[tuple[Unknowns, ...], None]:
        u, rows = now
        du = solver.linearise(problem, u).apply(rows)

        def try_fraction(k: Array, best: tuple[Any, ...]) -> tuple[Any, ...]:
            moved = subtract(u, du, fractions[k])
            rows = problem.residual(moved)
            size = largest_row(rows, scale)
            better = size < best[-1]  # false where they are not finite
            return jax.tree.map(partial(jnp.where, better), (moved, rows, size), best)

        # a loop, not a batch: one more copy of the rows in the program instead of three
        u, rows, _ = jax.lax.fori_loop(0, len(CORRECTION_FRACTIONS), try_fraction, (u, rows, never))
        return (u, rows), None

    (u, rows), _ = jax.lax.scan(correct, (guess, problem.residual(guess)), None, length=iterations)
    return u, largest_row(rows, scale)


def solve_statics(model: Model, s: State, loads: Array) -> tuple[State, float]:
    """`polish` on the host."""
    found, residual = polish(model, s, loads, MIN_KAPPA * soft_scale(model, np))
    return found, float(residual)


def check_point_names(names: Sequence[str], known: Collection[str]) -> None:
    """Raise `SceneError` for a name that is unknown or given twice."""
    for i, name in enumerate(names):
        if name not in known:
            raise SceneError(f"points: {name!r} is not a point of the scene; {nearest(name, known)}")
        if name in names[:i]:
            raise SceneError(f"points: {name!r} is given twice; allowed: every point once")


def held_names(model: Model) -> list[str]:
    """The names of the fixed points, in the order of their nodes."""
    return [model.points[i].name for i in model.geometry.held_points]


def name_of(model: Model, node: int) -> str:
    """The name of a free node: its point, or its line and number."""
    return model.geometry.name_of_node(node, names_of(model.points))
