"""Motions and tensions in irregular waves, in the frequency domain about its static pose.

    (K + i w (C + D) - w^2 M) x = F + D u,    D = -E[R(v) z'] L^-1,    v = L z ~ N(0, S),    S = E[v v'],  v = i w x - u

K, C, M are the exact derivatives of all forces by positions, velocities and accelerations, as in
`dropper_jax.linearised`. F is the exact derivative of all forces by the amplitude of a wave component: Froude-Krylov
force, added mass, waterline, drag of the mean current, ends that follow the sea. R(v) is what the force on nodes and
bodies with velocity v relative to the waves, in the mean current, has beyond its linear part at rest; C and F contain
the latter. u is the velocity of the waves. D is the stochastic linearisation (`sqrt(8/pi) b sigma` for `b |v| v`) of
each node and body: by Stein's lemma the mean derivative of R. S follows from the motion, so D is found by iteration.
The mean force changes by E[R], and positions and tensions shift by the static response to it.

The unknowns x are displacements of nodes, and six coordinates per rigid body. All sea states share one basis of
motions: responses solved in full at a few of them. Nodes on the seabed have the stiffness of contact and, where they
stick, of friction; sliding friction is left out. Inextensible links are springs that stretch by 0.01 %.

Source of the linearisation: Krolikowski and Gay (1980), for drag in irregular waves and a current.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import combinations, permutations, product
from math import gamma, sqrt
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import solve_triangular
from jax.scipy.sparse.linalg import gmres

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Model, State
from dropper_jax.model.slots import Prepared
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.bodies import BodyMoves, moves_of
from dropper_jax.statics.rest_problem import rest, with_static_seabed_friction
from dropper_jax.statics.search import outward
from dropper_jax.statics.tangent import Linear, NodeMoves, solve_matrix

#: D of the nodes (nodes, 3, 3) and bodies (bodies, 6, 6) [N s/m].
Drag = tuple[jax.Array, jax.Array]


class _Linear(NamedTuple):
    """Stiffness, damping and mass in the form of the tangent, and derivatives of tensions by link vectors and their
    rates (n, 3)."""

    stiffness: jax.Array
    damping: jax.Array
    mass: jax.Array
    stretch: jax.Array
    stretch_rate: jax.Array


class _Loads(NamedTuple):
    """Complex amplitudes by component: forces along the unknowns (c, *x) [N], tensions from moving ends (c, n) [N], and
    velocities of the water along the unknowns (c, *x) [m/s]."""

    force: jax.Array
    tension: jax.Array
    flow: jax.Array


class _Basis(NamedTuple):
    """Motions (m, *x), the matrices (m, m) along them, and tensions (m, n) by displacement and speed."""

    motions: jax.Array
    soft: jax.Array
    stiffness: jax.Array
    damping: jax.Array
    mass: jax.Array
    tension: jax.Array
    tension_rate: jax.Array


class _Solved(NamedTuple):
    """A state: amplitudes at the picked links (c, picked) [N] and nodes (c, picked, 3) [m], standard deviation and mean
    shift of all tensions (n,) [N], D of water and other effects, and its last relative change."""

    tension: jax.Array
    motion: jax.Array
    deviation: jax.Array
    shift: jax.Array
    drag: tuple[Drag, Drag]
    change: jax.Array


#: Change of the linearised drag in an iteration, over its size, at which it has converged.
TOLERANCE = 1e-3


def _normal_points(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 6) and weights (k,) of means over a standard normal vector of this size (3 or 6): two radii, exact for
    powers up to 3, and directions symmetric in every coordinate. The mean of |cos| is right within 3 % (3), 8 % (6)."""
    if size == 3:
        # the vector whose permutations and signs have the most even |cos|
        even = (0.878084, 0.235282, 0.416667, 0.0, 0.0, 0.0)
        directions = [
            np.array((*p, *even[3:])) * (*s, 1, 1, 1)
            for p in permutations(even[:3])
            for s in product((1, -1), repeat=3)
        ]
        shares = np.full(len(directions), 1.0 / len(directions))
    else:  # exact for powers up to 7 (one, two and six equal coordinates)
        one = [s * axis for axis in np.eye(6) for s in (1, -1)]
        two = [(a + s * b) * t for a, b in combinations(np.eye(6), 2) for s in (1, -1) for t in (1, -1)]
        six = [np.array(signs, float) for signs in product((1, -1), repeat=6)]
        directions = [x / np.linalg.norm(x) for x in (*one, *two, *six)]
        shares = np.repeat([1 / 240, 1 / 120, 9 / 1280], [len(one), len(two), len(six)])
    mean = sqrt(2.0) * gamma((size + 1) / 2) / gamma(size / 2)
    middle = mean / (size - mean**2)
    far, near = np.roots([1.0, -middle, mean * middle - size])
    share = (mean - near) / (far - near)
    return np.concatenate([far * np.array(directions), near * np.array(directions)]), np.concatenate(
        [share * shares, (1.0 - share) * shares]
    )


def check_no_bodies(model: Model) -> None:
    """Reject rigid bodies: tensions of two moored spars are 12 to 14 % below those of runs, 10 % allowed."""
    if model.constraints:
        raise SceneError("body: rigid bodies are not accurate in the frequency domain. Use a run in time")


class _Moving(NamedTuple):
    """A model at rest with its unknowns: `spread` gives velocities of nodes (free, 3), `pull` forces along unknowns."""

    model: Model
    pose: State

    @property
    def moves(self) -> NodeMoves | BodyMoves:
        return moves_of(self.model)

    def spread(self, y: jax.Array) -> jax.Array:
        moves = self.moves
        return jax.jvp(partial(moves.positions, self.pose), (moves.none,), (y,))[1]

    def pull(self, force: jax.Array) -> jax.Array:
        moves = self.moves
        return jax.vjp(partial(moves.positions, self.pose), moves.none)[1](force)[0]


def _complex(linear: Callable[[jax.Array], jax.Array], x: jax.Array) -> jax.Array:
    """A real linear map of complex x (k, ...)."""
    return jax.vmap(linear)(x.real) + 1j * jax.vmap(linear)(x.imag)


@cached_jit(brief=True)
def _linearise(still: Model, pose: State) -> _Linear:
    """The matrices about an equilibrium without waves."""
    moves, line, none = moves_of(still), still.line, moves_of(still).none
    ends = still.ends(pose.t)

    def rows(x: jax.Array, v: jax.Array, a: jax.Array) -> jax.Array:
        r, back = jax.vjp(partial(moves.positions, pose), x)
        spread = lambda y: jax.jvp(partial(moves.positions, pose), (x,), (y,))[1]  # noqa: E731
        k = still.instant(r, spread(v), pose.t, ends)
        tension = line.axial.tension(k.links, k.link_velocities, line.length)
        direction = line.axial.direction(k.links, k.links, k.links, line.length)
        return back(still.inertia(k, spread(a)) - still.force(k) - still.tension_force(tension, direction))[0]

    linear = jax.linearize(rows, none, none, none)[1]
    of = lambda shares: moves.tangent.matrix(lambda d: linear(*(share * d for share in shares)), none)  # noqa: E731
    tension = lambda d, rate: jnp.sum(line.axial.tension(d, rate, line.length))  # noqa: E731
    links = still.links(pose.r, ends)
    return _Linear(*jax.vmap(of)(jnp.eye(3)), *jax.grad(tension, argnums=(0, 1))(links, jnp.zeros_like(links)))


def _components(waves: Waves, together: bool) -> Waves:
    """Each component as waves, with a leading axis; `together`: as all components, of which one has an amplitude."""
    size = waves.size
    if together:
        each = jax.tree.map(lambda x: jnp.broadcast_to(x, (size, *x.shape)), waves)
        return replace(each, amplitude=jnp.diag(waves.amplitude))
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (size,))[:, None], replace(waves, ramp=None))


def _wave_loads(model: Model, pose: State, waves: Waves) -> _Loads:
    """The loads of all components; the model is without waves."""
    still, at = jnp.zeros_like(pose.r), _Moving(model, pose)

    def of(own: Waves, later: jax.Array) -> tuple[jax.Array, ...]:
        def loads(amplitude: jax.Array) -> tuple[jax.Array, ...]:
            sea = replace(model.sea, waves=replace(own, amplitude=amplitude, phase=own.phase + later, ramp=None))
            moved = replace(model, sea=sea)
            k = moved.instant(pose.r, still, pose.t)
            tension = moved.line.axial.tension(k.links, k.link_velocities, moved.line.length)
            direction = moved.line.axial.direction(k.links, k.links, k.links, moved.line.length)
            inertia = moved.inertia(k, still, moved.end_acceleration(pose.t))
            force = moved.force(k) + moved.tension_force(tension, direction) - inertia
            return at.pull(force), tension, at.moves.from_nodes(pose, sea.at(pose.r, pose.t).velocity)

        return jax.jvp(loads, (jnp.zeros_like(own.amplitude),), (own.amplitude,))[1]

    # effects that know every component of the waves
    each = _components(replace(waves, ramp=None), model.effect("vessel_motion") is not None)
    # a quarter period later by the phase: Re(H exp(i w t)) there is -Im(H)
    both = jax.vmap(jax.vmap(of, (0, None)), (None, 0))(each, jnp.array([0.0, -0.5 * jnp.pi]))
    return _Loads(*(x[0] - 1j * x[1] for x in both))


def _dragging(still: Model) -> tuple[Model, Model]:
    """The model with the effects of the water, without contact, and with those that do not know the waves."""
    bed, prepared = ({e.name for e in still.having(kind)} for kind in (Seabed, Prepared))
    effects = [e for e in still.effects if e.name not in bed]
    wet = tuple(e for e in effects if e.needs_water or e.name in prepared)
    other = tuple(e for e in effects if not (e.needs_water or e.name in prepared))
    return replace(still, effects=wet), replace(still, effects=other)


def _linear_drag(at: _Moving, dragging: tuple[Model, Model], v: jax.Array, flow: jax.Array) -> tuple:
    """D of the water and of the other effects, and the change of the mean force, for complex velocities (c, *x)."""
    moves, groups = at.moves, jax.vmap(at.moves.groups)
    points, weights = (jnp.asarray(x) for x in _normal_points(6 if at.model.constraints else 3))

    def of(model: Model, velocity: jax.Array) -> tuple[Drag, jax.Array]:
        ends = model.ends(at.pose.t)
        parts = [0.5 * jnp.einsum("cni,cnj->nij", x, x.conj()).real for x in groups(velocity)]
        # the root of a covariance of plane motion needs a small one in the third direction
        size = [jnp.trace(x, axis1=1, axis2=2)[:, None, None] for x in parts]
        roots = [
            jnp.linalg.cholesky(x + (1e-9 * s + 1e-12) * jnp.eye(x.shape[-1])) for x, s in zip(parts, size, strict=True)
        ]

        def force(x: jax.Array) -> jax.Array:
            return at.pull(model.force(model.instant(at.pose.r, at.spread(x), at.pose.t, ends)))

        at_rest, linear = jax.linearize(force, moves.none)

        def beyond(z: jax.Array) -> jax.Array:
            x = moves.from_groups(*(root @ z[: root.shape[-1]] for root in roots))
            return force(x) - at_rest - linear(x)

        found = jax.vmap(beyond)(points)
        weighted = weights[:, None] * points
        drag = []
        for part, root in zip(groups(found), roots, strict=True):
            moment = jnp.einsum("kni,kj->nji", part, weighted[:, : root.shape[-1]])
            drag.append(-jnp.swapaxes(solve_triangular(jnp.swapaxes(root, 1, 2), moment), 1, 2))
        return tuple(drag), jnp.tensordot(weights, found, 1)

    (water, shift), (other, shift_2) = (of(m, x) for m, x in zip(dragging, (v - flow, v), strict=True))
    return (water, other), shift + shift_2


def _times(moves: NodeMoves | BodyMoves, drag: Drag, x: jax.Array) -> jax.Array:
    """The forces of D at velocities x."""
    return moves.from_groups(
        *(jnp.einsum("nij,nj->ni", d, part) for d, part in zip(drag, moves.groups(x), strict=True))
    )


def _tensions(at: _Moving, linear: _Linear, x: jax.Array, v: jax.Array) -> jax.Array:
    """Changes of the tensions (k, n) [N] at displacements and velocities (k, *x)."""

    def along(slope: jax.Array) -> Callable[[jax.Array], jax.Array]:
        return lambda y: jnp.sum(slope * at.model.rates(at.spread(y), None), axis=-1)

    return _complex(along(linear.stretch), x) + _complex(along(linear.stretch_rate), v)


def _respond(at: _Moving, linear: _Linear, drag: tuple[Drag, Drag], loads: _Loads, omega: jax.Array) -> jax.Array:
    """Displacements (c, *x) by the full equations."""
    moves = at.moves
    extra = moves.tangent.matrix(lambda d: _times(moves, drag[0], d) + _times(moves, drag[1], d), moves.none)
    right = loads.force + _complex(partial(_times, moves, drag[0]), loads.flow)

    def solve(w: jax.Array, b: jax.Array) -> jax.Array:
        matrix = linear.stiffness + 1j * w * (linear.damping + extra) - w**2 * linear.mass
        return solve_matrix(moves.tangent, matrix, b)

    return jax.vmap(solve)(omega, right)


def _static_shift(at: _Moving, linear: _Linear, omega: jax.Array, force: jax.Array) -> jax.Array:
    """Displacement *x under a constant force."""
    return solve_matrix(at.moves.tangent, _soft(linear, omega), force)


def _soft(linear: _Linear, omega: jax.Array) -> jax.Array:
    # static shifts with a stiffness of 1e-4 of the inertia: a slack line on the bed has none across itself
    return linear.stiffness + 1e-4 * jnp.min(omega) ** 2 * linear.mass


def _iterate(
    drag_of: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]],
    start: jax.Array,
    shift: jax.Array,
    tolerance: float,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Flat D with `drag_of(D, number of the iteration) = D`, the change of the mean force, and the last relative change
    of D."""

    def keep_iterating(carry: tuple[jax.Array, ...]) -> jax.Array:
        return (carry[2] > tolerance) & (carry[3] < 60)

    def correct(carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        drag, _, _, count, share, before = carry
        after, shift = drag_of(drag, count)
        left = after - drag
        # Aitken's share of the correction: the root of the secant through this residual and the one before
        turn = left - before
        slope = jnp.sum(before * turn) / jnp.maximum(jnp.sum(turn**2), 1e-300)
        share = jnp.where(count > 1, jnp.clip(-share * slope, 0.1, 1.0), jnp.where(count > 0, 0.5, 1.0))
        change = jnp.linalg.norm(left) / jnp.maximum(jnp.linalg.norm(after), 1e-300)
        return drag + share * left, shift, change, count + 1, share, left

    carry = start, shift, jnp.inf, 0, jnp.ones(()), jnp.zeros_like(start)
    drag, shift, change, *_ = jax.lax.while_loop(keep_iterating, correct, carry)
    return drag, shift, change


@cached_jit(brief=True)
def _jit_loads(still: Model, pose: State, waves: Waves) -> _Loads:
    """The loads of several states."""
    return jax.vmap(partial(_wave_loads, still, pose))(waves)


@cached_jit(brief=True)
def _fixed_drag(still: Model, dragging: tuple[Model, Model], pose: State, flow: jax.Array) -> tuple:
    """D and the mean force of nodes that do not move."""
    return _linear_drag(_Moving(still, pose), dragging, jnp.zeros_like(flow), flow)


@cached_jit(brief=True)
def _amplitudes(
    still: Model,
    pose: State,
    linear: _Linear,
    drag: tuple[Drag, Drag],
    constant: jax.Array,
    loads: _Loads,
    omega: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """By the full equations: displacements per component and under a constant force (c + 1, *x), tensions (c, n)."""
    at = _Moving(still, pose)
    x = _respond(at, linear, drag, loads, omega)
    rate = 1j * omega.reshape(-1, *(1,) * (x.ndim - 1))
    tension = _tensions(at, linear, x, rate * x) + loads.tension
    return jnp.concatenate([x, _static_shift(at, linear, omega, constant)[None]]), tension


@cached_jit(brief=True)
def _projected(still: Model, pose: State, linear: _Linear, motions: jax.Array, omega: jax.Array) -> _Basis:
    """The basis of these motions (m, *x); `omega`: of all states."""
    at = _Moving(still, pose)
    flat = motions.reshape(motions.shape[0], -1)

    def project(matrix: jax.Array) -> jax.Array:
        return flat @ jax.vmap(partial(at.moves.tangent.multiply, matrix))(motions).reshape(flat.shape).T

    still_motion = jnp.zeros_like(motions)
    tensions = [_tensions(at, linear, *both).real for both in ((motions, still_motion), (still_motion, motions))]
    matrices = (_soft(linear, omega), linear.stiffness, linear.damping, linear.mass)
    return _Basis(motions, *(project(matrix) for matrix in matrices), *tensions)


@cached_jit(brief=True)
def _batch(
    still: Model,
    dragging: tuple[Model, Model],
    pose: State,
    basis: _Basis,
    picked: tuple[jax.Array, jax.Array],
    loads: _Loads,
    omega: jax.Array,
) -> _Solved:
    """Several states in the basis, one after another; `picked` are links and nodes."""
    at, (links, nodes) = _Moving(still, pose), picked
    moves = at.moves
    parts = jax.vmap(moves.groups)(basis.motions)
    seen = jax.vmap(at.spread)(basis.motions)[:, nodes]

    def along(drag: Drag) -> jax.Array:
        return sum(jnp.einsum("ani,nij,bnj->ab", x, d, x) for x, d in zip(parts, drag, strict=True))

    def solve(state: tuple[_Loads, jax.Array]) -> _Solved:
        loads, omega = state
        rate, w = 1j * omega[:, None], omega[:, None, None]
        flow = jax.vmap(moves.groups)(loads.flow)
        flat = lambda x: x.reshape(x.shape[0], -1)  # noqa: E731
        push = flat(loads.force) @ flat(basis.motions).T
        combine = lambda q: jnp.tensordot(q, basis.motions, 1)  # noqa: E731

        def motions(drag: tuple[Drag, Drag]) -> jax.Array:
            moved = [jnp.einsum("nij,cnj->cni", d, u) for d, u in zip(drag[0], flow, strict=True)]
            right = push + sum(jnp.einsum("ani,cni->ca", x, y) for x, y in zip(parts, moved, strict=True))
            matrix = basis.stiffness + 1j * w * (basis.damping + along(drag[0]) + along(drag[1])) - w**2 * basis.mass
            return jnp.linalg.solve(matrix, right[..., None])[..., 0]

        start, unravel = _no_drag(parts)

        def drag_of(drag: jax.Array, number: jax.Array) -> tuple[jax.Array, jax.Array]:
            q = jnp.where(number > 0, motions(unravel(drag)), 0.0)  # at first the drag of nodes that do not move
            found, shift = _linear_drag(at, dragging, combine(rate * q), loads.flow)
            return ravel_pytree(found)[0], shift

        drag, shift, change = _iterate(drag_of, start, jnp.zeros_like(moves.none), TOLERANCE)
        drag = unravel(drag)
        q = motions(drag)
        tension = q @ basis.tension + (rate * q) @ basis.tension_rate + loads.tension
        mean = jnp.linalg.solve(basis.soft, flat(basis.motions) @ shift.ravel()) @ basis.tension
        deviation = jnp.sqrt(0.5 * jnp.sum(jnp.abs(tension) ** 2, axis=0))
        return _Solved(tension[:, links], jnp.tensordot(q, seen, 1), deviation, mean, drag, change)

    return jax.lax.map(solve, (loads, omega))


def _no_drag(parts: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Callable[[jax.Array], tuple[Drag, Drag]]]:
    """D = 0 for these parts of motions, as a flat array, and the function that restores its form."""
    zero = tuple(jnp.zeros((*x.shape[1:], x.shape[-1])) for x in parts)
    return ravel_pytree((zero, zero))


#: States per call of the compiled program, so that any number of states uses the same one.
CHUNK = 8


def solve_states(
    still: Model, pose: State, waves: Waves, links: np.ndarray, nodes: np.ndarray
) -> tuple[_Solved, float]:
    """All states in one basis, and the error of the basis.

    Args:
        still: the model without waves, about whose equilibrium `pose` it moves.
        waves: with a leading axis of the states.
        links, nodes: whose amplitudes are returned.
    """
    linear, dragging, every = _linearise(still, pose), _dragging(still), np.asarray(waves.omega)

    def chunk(states: np.ndarray) -> Waves:
        """The waves of these states, repeated up to a full chunk."""
        return jax.tree.map(lambda x: x[np.resize(states, CHUNK)], waves)

    # the basis: responses of the lowest, highest, shortest and longest seas, with the drag of fixed nodes and a tenth
    height, length = np.linalg.norm(waves.amplitude, axis=1), -np.mean(every, axis=1)
    chosen = np.unique([pick(x) for x in (height, length) for pick in (np.argmin, np.argmax)])
    loads = jax.tree.map(np.asarray, _jit_loads(still, pose, chunk(chosen)))
    loads = [jax.tree.map(lambda x, i=i: x[i], loads) for i in range(len(chosen))]
    found = []
    for own, omega in zip(loads, every[chosen], strict=True):
        for share in (1.0, 0.1):
            drag, constant = _fixed_drag(still, dragging, pose, share * own.flow)
            x = np.asarray(_amplitudes(still, pose, linear, drag, constant, own, omega)[0])
            found += [x.real, x.imag]
    basis = _projected(
        still, pose, linear, jnp.asarray(_basis_motions(still, pose, linear, np.concatenate(found), every)), every
    )

    def solve(states: np.ndarray) -> _Solved:
        own = chunk(states)
        solved = _batch(still, dragging, pose, basis, (links, nodes), _jit_loads(still, pose, own), own.omega)
        return jax.tree.map(lambda x: np.asarray(x)[: len(states)], solved)

    chunks = np.split(np.arange(len(every)), range(CHUNK, len(every), CHUNK))
    solved = jax.tree.map(lambda *x: np.concatenate(x), *(solve(chunk) for chunk in chunks))
    errors = []
    for state, own in zip(chosen, loads, strict=True):
        drag = jax.tree.map(lambda x, i=state: jnp.asarray(x[i]), solved.drag)
        tension = _amplitudes(still, pose, linear, drag, jnp.zeros_like(constant), own, every[state])[1]
        exact = np.sqrt(0.5 * np.sum(np.abs(tension) ** 2, axis=0))
        errors.append(np.max(np.abs(solved.deviation[state] - exact)) / np.max(exact))
    return solved, float(max(errors))


def _basis_motions(still: Model, pose: State, linear: _Linear, shapes: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Motions (m, *x) that span displacements (k, *x): orthonormal in the sum of kinetic energies and squared changes
    of tension over their stiffness."""
    moved, tension = _sizes(still, pose, linear, shapes)
    size = np.concatenate([np.mean(omega) * np.asarray(moved), np.asarray(tension)], axis=1).T
    scale = np.maximum(np.linalg.norm(size, axis=0), 1e-300)
    _, values, right = np.linalg.svd(size / scale, full_matrices=False)
    # singular values of the responses that span the basis, relative to the largest one
    taken = values > 1e-4 * values[0]
    return np.tensordot(right[taken] / values[taken, None], shapes / scale.reshape(-1, *(1,) * (shapes.ndim - 1)), 1)


@cached_jit(brief=True)
def _sizes(still: Model, pose: State, linear: _Linear, shapes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Displacements of the nodes times the roots of their masses (k, 3 free), and tensions over their roots of
    stiffness (k, n)."""
    at = _Moving(still, pose)
    moved = jax.vmap(at.spread)(shapes) * jnp.sqrt(still.node_mass)[:, None]
    stiffness = jnp.sqrt(2.0) * jnp.linalg.norm(linear.stretch, axis=1)
    tension = _tensions(at, linear, shapes, jnp.zeros_like(shapes)).real
    return moved.reshape(len(shapes), -1), tension / jnp.sqrt(jnp.maximum(stiffness, 1e-300))


def _krylov(linear: Linear, b: jax.Array) -> jax.Array:
    """The solution of `linear(x) = b`; a change of D changes itself by less than its size, so GMRES needs few steps."""
    return gmres(linear, b, tol=1e-12, restart=60, maxiter=4, solve_method="batched")[0]


def tension_deviation(model: Model, pose: State, loads: jax.Array | None = None) -> tuple[jax.Array, jax.Array]:
    """Mean and standard deviation of all tensions (n,) [N] in the irregular waves of the model, by the full equations.

    Differentiable in model and configuration, forward and reverse: the linearised drag D = g(D) has the derivative
    `(1 - g_D)^-1 g_theta` (implicit function theorem). Use the configuration of `equilibrium` of the same model, which
    has the required derivatives. Compiled with `jax.jit`, or as it is.

    Args:
        pose: `equilibrium(...).state`.
        loads: additional forces of the equilibrium (free nodes, 3) [N].

    Raises:
        SceneError: rigid links or bodies, or no irregular waves.
    """
    check_no_bodies(model)
    if not model.line.axial.elastic:
        raise SceneError("line.axial.law: 'rigid' has no axial stiffness; allowed: elastic, rope, tabulated")
    waves = None if model.sea is None else model.sea.waves
    if waves is None or waves.size < 2:
        raise SceneError("sea.waves: is not an irregular linear sea. Use kind 'spectrum'")
    still, friction = rest(model), outward(model)
    if friction is not None:
        still = with_static_seabed_friction(still, pose, friction.kinetic)[0]
    at, linear, dragging = _Moving(still, pose), _linearise(still, pose), _dragging(still)
    of_waves = _wave_loads(still, pose, waves)
    rate = 1j * waves.omega.reshape(-1, *(1,) * (of_waves.flow.ndim - 1))
    start, unravel = _no_drag(jax.vmap(at.moves.groups)(of_waves.flow))

    def drag_of(drag: jax.Array, number: jax.Array | None = None) -> tuple[jax.Array, jax.Array]:
        x = _respond(at, linear, unravel(drag), of_waves, waves.omega)
        x = x if number is None else jnp.where(number > 0, x, 0.0)
        found, shift = _linear_drag(at, dragging, rate * x, of_waves.flow)
        return ravel_pytree(found)[0], shift

    # derivatives follow from the fixed point itself, so it is solved to rounding
    drag = jax.lax.custom_root(
        lambda drag: drag_of(drag)[0] - drag,
        start,
        lambda _, start: jax.lax.stop_gradient(_iterate(drag_of, start, jnp.zeros_like(at.moves.none), 1e-12)[0]),
        lambda linear, b: jax.lax.custom_linear_solve(linear, b, _krylov, _krylov),
    )
    x, (_, shift) = _respond(at, linear, unravel(drag), of_waves, waves.omega), drag_of(drag)
    tension = _tensions(at, linear, x, rate * x) + of_waves.tension
    moved = _static_shift(at, linear, waves.omega, shift)[None]
    mean = pose.tension + _tensions(at, linear, moved, jnp.zeros_like(moved))[0].real
    return mean, jnp.sqrt(0.5 * jnp.sum(jnp.abs(tension) ** 2, axis=0))
