"""Statics of a system of lines: damped Newton descent from a rough guess to the stable pose.

    (K + kappa) dx = F(r),    r <- r + a dx

F holds all forces and the tensions of the links as they lie, K their stiffness, which tension-only lines, a seabed and
floats keep positive. The share a is the largest of a geometric series that does not overshoot: `F(r + a dx) . dx` may
not turn far negative (the line search of nonlinear finite elements; it needs no energy, so that a current may act).
kappa falls while whole steps are taken and rises when they are cut: descent far from rest, Newton near it. Descent ends
in stable poses. Host-side loop over one compiled round.
"""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.axial import AxialLaw
from dropper_jax.base.programs import kept
from dropper_jax.model import Graph, Model, State, state
from dropper_jax.residual import Unknowns
from dropper_jax.statics.rest_problem import SMALLEST, RestProblem, force_scale, rest_solver

#: Largest scaled unbalanced force of a pose that counts as found; rounding leaves more of stiff links.
TOLERANCE = 1e-10
#: Rounds until a pose counts as not found.
ROUNDS = 1000
#: Rounds that may pass without a pose better than the guess.
HOPELESS = 500
#: Largest move of a node in one round, in mean link lengths.
REACH = 1.0
#: Shares of a correction that are tried.
SHARES = tuple(0.5**i for i in range(14))
#: How far the force along a correction may turn against it, over its value at the start.
OVERSHOOT = 0.5
#: Shares of the axial stiffness that poses are found with on the way to a stiff one.
SOFTENING = (1e-5, 1e-3, 1e-1, 1.0)
#: Stretch of the springs that stand for rigid links.
GIVE = 1e-4
#: Factors on kappa after a whole, a good and a short step.
FALL, KEEP, RISE = 0.2, 0.7, 4.0


def rounding(model: Model, xp: ModuleType = jnp) -> jax.Array:
    """What rounding leaves of the scaled forces of stiff links and beds, a scalar; with NumPy on the host."""
    line = model.line
    length = xp.asarray(line.length)
    stiffness = xp.max(xp.asarray(line.axial.EA) / length)
    bed = model.effect("seabed")
    if bed is not None:
        contact = xp.max(xp.asarray(bed.stiffness)) * xp.max(xp.asarray(line.diameter) * length)
        stiffness = xp.maximum(stiffness, contact)
    extent = xp.max(xp.abs(xp.stack([xp.asarray(p.position) for p in model.points]))) + xp.max(length)
    return 10.0 * jnp.finfo(model.dtype).eps * stiffness * extent / force_scale(model, xp)


def system_tolerance(model: Model) -> float:
    """Largest scaled unbalanced force of an accepted pose: 1e-10, or what rounding leaves."""
    # on the host: each operation on arrays of JAX would be a program of its own
    return max(TOLERANCE, float(rounding(model, np)))


@kept(brief=True)
def unbalanced(model: Model, s: State, loads: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Unbalanced forces (free, 3) [N] at a pose, and the tensions there."""
    problem = RestProblem(model, s, loads)
    x = jnp.zeros_like(s.r)
    tension = problem.tension(x)
    return problem.residual(Unknowns(x, tension)).x, tension


@kept(brief=True)
def _round(
    model: Model, s: State, loads: jax.Array, kappa: jax.Array, reach: jax.Array
) -> tuple[State, jax.Array, jax.Array]:
    """One correction of the pose s; the next pose, its largest scaled unbalanced force, and the share."""
    problem = RestProblem(model, s, loads, kappa)
    solver = rest_solver(model)
    u = Unknowns(jnp.zeros_like(s.r), problem.tension(jnp.zeros_like(s.r)))
    rows = problem.residual(u)
    dx = -solver.apply(solver.factor(problem, u), rows).x
    dx = dx * jnp.minimum(1.0, reach / jnp.maximum(jnp.max(jnp.sqrt(jnp.sum(dx * dx, axis=1))), 1e-300))

    def tried(share: jax.Array) -> tuple[jax.Array, jax.Array]:
        return unbalanced(model, state(model, s.r + share * dx, t=s.t), loads)

    shares = jnp.asarray(SHARES, model.dtype)
    left, tension = jax.vmap(tried)(shares)
    good = -jnp.sum(left * dx, axis=(1, 2)) >= OVERSHOOT * jnp.sum(rows.x * dx)  # rows are minus the forces
    # what the share that is taken leaves stands there: the forces once more would be a quarter of the program
    i = jnp.argmax(good.at[-1].set(True))
    after = state(model, s.r + shares[i] * dx, tension=tension[i], t=s.t)
    return after, jnp.max(jnp.abs(left[i])) / force_scale(model), shares[i]


def guess(model: Model, t: float = 0.0) -> State:
    """Every line straight between its points, where the scene puts these."""
    geometry = model.geometry
    places = np.array([np.asarray(p.position, float) for p in model.points])
    moved = np.asarray(model.ends(jnp.asarray(t, model.dtype)).places, float)
    places[geometry.held_points] = moved
    r = np.zeros((geometry.free, 3))
    length = np.asarray(model.line.length, float)
    for member, path, span in zip(geometry.members, geometry.paths, geometry.spans, strict=True):
        along = np.concatenate([[0.0], np.cumsum(length[span])]) / np.sum(length[span])
        line = places[member.start] + along[:, None] * (places[member.end] - places[member.start])
        if np.array_equal(places[member.start], places[member.end]):  # a loop hangs below its point
            line[:, 2] -= 0.5 * np.sum(length[span]) * np.sin(np.pi * along)
        inner = (path >= 0) & (path < geometry.free)
        r[path[inner]] = line[inner]
    return state(model, jnp.asarray(r), t=t)


def find_rest(model: Model, s: State, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """The stable pose that descent from `s` reaches, and its largest scaled unbalanced force."""
    length, scale = float(np.mean(np.asarray(model.line.length))), float(force_scale(model, np))
    rows, tension = unbalanced(model, s, loads)
    s = state(model, s.r, tension=tension, t=s.t)
    residual = float(np.max(np.abs(np.asarray(rows)))) / scale
    first, best = s, (s, residual)
    kappa, reach = scale / length, jnp.asarray(REACH * length, model.dtype)
    reached = 0
    for count in range(ROUNDS):
        s, residual, share = _round(model, s, loads, jnp.asarray(kappa, model.dtype), reach)
        residual, share = float(residual), float(share)
        kappa *= FALL if share == 1.0 else KEEP if share >= 0.25 else RISE
        kappa = max(kappa, SMALLEST * scale / length)
        if residual < best[1]:
            best = (s, residual)
        reached = reached + 1 if residual <= tolerance else 0
        if not np.isfinite(residual) or reached > 1 or (count > HOPELESS and best[0] is first):
            break
    return best


def find_softened(model: Model, s: State, loads: jax.Array, tolerance: float) -> tuple[State, float]:
    """The pose by way of softer lines: where slack links tauten one after another, stiff ones cut every step short.

    A weightless line of 200 links in a current is found in seconds this way, and not in `ROUNDS` rounds without.
    """
    residual = np.inf
    for share in SOFTENING:
        s, residual = find_rest(with_axial(model, model.line.axial.softened(share)), s, loads, tolerance)
    return s, residual


def with_axial(model: Model, axial: AxialLaw) -> Model:
    """The model with another law of its links."""
    return replace(model, lines=(replace(model.line, axial=axial),))


def springy(model: Model) -> Model:
    """The model with stiff springs in place of rigid links: they stretch by about `GIVE` of their length."""
    weight = force_scale(model) * model.line.links / GIVE
    return with_axial(model, model.line.axial.springs(jnp.broadcast_to(weight, model.line.length.shape)))


def unsettled(model: Model, s: State, loads: jax.Array, residual: float) -> str:
    """Which node is farthest from balance in a pose that was not found, and why."""
    rows = np.asarray(unbalanced(model, s, loads)[0])
    node = int(np.argmax(np.max(np.abs(rows), axis=1)))
    if not np.all(np.isfinite(rows)):
        node = int(np.flatnonzero(~np.all(np.isfinite(rows), axis=1))[0])
    force = ", ".join(f"{x:.3g}" for x in rows[node])
    place = ", ".join(f"{x:.4g}" for x in np.asarray(s.r[node]))
    return (
        f"no equilibrium found in {ROUNDS} rounds: largest scaled unbalanced force {residual:.1e}, "
        f"{name_of(model, node)} at ({place}) m is left with ({force}) N"
    )


def name_of(model: Model, node: int) -> str:
    """A free node in words: its point, or its line and number."""
    graph = model.geometry
    if not isinstance(graph, Graph):
        return f"node {node + 1}"
    if node >= graph.inner:
        return f"point {model.points[int(graph.free_points[node - graph.inner])].name!r}"
    for member, path in zip(graph.members, graph.paths, strict=True):
        if node in path[1:-1]:
            return f"node {int(np.flatnonzero(path == node)[0])} of line {member.name!r}"
    return f"node {node}"
