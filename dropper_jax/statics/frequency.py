"""Motions and tensions in irregular waves, in the frequency domain about its static pose.

    (K + i w (C + D) - w^2 M) x = F + D u,    D = E[-dP/dv] - D_0,    v ~ N(0, S),    S = E[v v'],  v = i w x - u

K, C, M are those of `dropper_jax.linearised`. F is the exact derivative of all forces by the amplitude of a wave
component: Froude-Krylov force, added mass, waterline, drag of the mean current, ends that follow the sea. P(v) is the
force on nodes with velocity v relative to the waves, in the mean current, and u the velocity of the waves. D is its
stochastic linearisation (`sqrt(8/pi) b sigma` for `b |v| v`) beyond D_0, the part at rest that C and F contain. S
follows from the motion, so D is found by iteration. The mean force changes by E[P] - P(0), and positions and tensions
shift by the static response to it.

All sea states share one basis of motions: responses solved in full at a few of them. Nodes on the seabed have the
stiffness of contact and, where they stick, of friction; sliding friction is left out. Inextensible links are springs
that stretch by 0.01 %.

Source of the linearisation: Krolikowski and Gay (1980), for drag in irregular waves and a current.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.backend.programs import cached_jit
from dropper_jax.effects.seabed import Seabed
from dropper_jax.model import Model, State
from dropper_jax.model.slots import Prepared
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.modes import linearised_about


class _Basis(NamedTuple):
    """The matrices (m, m) along the motions (3 free, m) of the basis, and tensions (n, m) by displacement and speed."""

    motions: jax.Array
    soft: jax.Array
    stiffness: jax.Array
    damping: jax.Array
    mass: jax.Array
    tension: jax.Array
    tension_rate: jax.Array


class _Solved(NamedTuple):
    """A state: amplitudes at the picked links (c, picked) [N] and nodes (c, picked, 3) [m], standard deviation and mean
    shift of all tensions (n,) [N], D (2, free, 3, 3) [N s/m], and its last relative change."""

    tension: jax.Array
    motion: jax.Array
    deviation: jax.Array
    shift: jax.Array
    damping: jax.Array
    change: jax.Array


#: Change of the linearised drag in an iteration, over its size, at which it has converged.
TOLERANCE = 1e-3


def _normal_points() -> tuple[np.ndarray, np.ndarray]:
    """Points (k, 3) and weights (k,) of means over a standard normal vector: two radii, exact for powers up to 3, and
    directions on a spiral, whose mean of |cos| is right within 2 %."""
    mean, count = 2.0 * np.sqrt(2.0 / np.pi), 48
    far, near = np.roots([1.0, -mean / (3.0 - mean**2), mean**2 / (3.0 - mean**2) - 3.0])
    share = (mean - near) / (far - near)
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    directions = np.stack([np.sqrt(1.0 - z**2) * np.cos(angle), np.sqrt(1.0 - z**2) * np.sin(angle), z], axis=1)
    weights = np.repeat([share / count, (1.0 - share) / count], count)
    return np.concatenate([far * directions, near * directions]), weights


def _dragging(still: Model) -> tuple[Model, Model]:
    """The model with the effects of the water, without contact, and with those that do not know the waves."""
    bed, prepared = ({e.name for e in still.having(kind)} for kind in (Seabed, Prepared))
    effects = [e for e in still.effects if e.name not in bed]
    wet = tuple(e for e in effects if e.needs_water or e.name in prepared)
    other = tuple(e for e in effects if not (e.needs_water or e.name in prepared))
    return replace(still, effects=wet), replace(still, effects=other)


def _covariance(v: jax.Array, flow: jax.Array) -> jax.Array:
    """Of the velocities (c, free, 3) relative to the water, and of the velocities themselves (2, free, 3, 3)."""
    each = jnp.stack([v - flow, v])
    return 0.5 * jnp.einsum("kcni,kcnj->knij", each, each.conj()).real


def _linear_drag(dragging: tuple[Model, Model], pose: State, covariance: jax.Array) -> tuple[jax.Array, jax.Array]:
    """D (2, free, 3, 3) [N s/m] of the water and of the other effects, and the change of the mean force (free, 3) [N],
    for velocities of this covariance (2, free, 3, 3)."""
    drag, force = zip(*(_mean_derivative(m, pose, c) for m, c in zip(dragging, covariance, strict=True)), strict=True)
    return jnp.stack(drag), force[0] + force[1]


def _mean_derivative(model: Model, pose: State, covariance: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The same of one model (free, 3, 3), (free, 3)."""
    ends, still = model.ends(pose.t), jnp.zeros_like(pose.r)

    def force(v: jax.Array) -> jax.Array:
        return model.force(model.instant(pose.r, v, pose.t, ends))

    def derivative(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        axes = jnp.broadcast_to(jnp.eye(3)[:, None], (3, *v.shape))
        value, columns = jax.vmap(lambda axis: jax.jvp(force, (v,), (axis,)), out_axes=(None, 2))(axes)
        return value, -columns

    # the root of a covariance of plane motion needs a small one in the third direction
    size = jnp.trace(covariance, axis1=1, axis2=2)[:, None, None]
    root = jnp.linalg.cholesky(covariance + (1e-9 * size + 1e-12) * jnp.eye(3))
    points, weights = _normal_points()
    value, drag = jax.vmap(lambda x: derivative(jnp.einsum("nij,j->ni", root, x)))(jnp.asarray(points))
    value_0, drag_0 = derivative(still)
    mean = lambda x: jnp.tensordot(jnp.asarray(weights), x, 1)  # noqa: E731
    return mean(drag) - drag_0, mean(value) - value_0


def _wave_loads(model: Model, pose: State, waves: Waves) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Complex amplitudes by component: forces (c, 3 free) [N], tensions from moving ends (c, n) [N], and velocities of
    the water (c, free, 3) [m/s]."""
    still = jnp.zeros_like(pose.r)

    def of(amplitude: jax.Array, phase: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        sea = replace(model.sea, waves=replace(waves, amplitude=amplitude, phase=phase, ramp=None))
        moved = replace(model, sea=sea)
        k = moved.instant(pose.r, still, pose.t)
        tension = moved.line.axial.tension(k.links, k.link_velocities, moved.line.length)
        direction = moved.line.axial.direction(k.links, k.links, k.links, moved.line.length)
        inertia = moved.inertia(k, still, moved.end_acceleration(pose.t))
        force = moved.force(k) + moved.tension_force(tension, direction) - inertia
        return force.ravel(), tension, sea.at(pose.r, pose.t).velocity

    zero = jnp.zeros_like(waves.amplitude)
    # a quarter period later by the phase: Re(H exp(i w t)) there is -Im(H)
    real, later = (jax.jacfwd(lambda a, e=e: of(a, zero + e))(zero) for e in (0.0, -0.5 * jnp.pi))
    size = waves.amplitude * jnp.exp(-1j * waves.phase)
    return tuple(jnp.moveaxis((a - 1j * b) * size, -1, 0) for a, b in zip(real, later, strict=True))


@cached_jit(brief=True)
def _batch(
    model: Model,
    dragging: tuple[Model, Model],
    pose: State,
    basis: _Basis,
    links: jax.Array,
    nodes: jax.Array,
    waves: Waves,
) -> _Solved:
    """All states, one after another; `dragging` as in `_dragging`."""
    free = pose.r.shape[0]

    def solve(waves: Waves) -> _Solved:
        force, end_tension, flow = _wave_loads(model, pose, waves)
        rate = 1j * waves.omega[:, None]
        by_node = basis.motions.reshape(free, 3, -1)

        def motions(drag: jax.Array) -> jax.Array:
            extra = jnp.einsum("nia,nij,njb->ab", by_node, drag[0] + drag[1], by_node)
            right = force @ basis.motions + jnp.einsum("nia,nij,cnj->ca", by_node, drag[0], flow)
            w = waves.omega[:, None, None]
            matrix = basis.stiffness + 1j * w * (basis.damping + extra) - w**2 * basis.mass
            return jnp.linalg.solve(matrix, right[..., None])[..., 0]

        def drag_of(q: jax.Array) -> tuple[jax.Array, jax.Array]:
            v = ((rate * q) @ basis.motions.T).reshape(flow.shape)
            return _linear_drag(dragging, pose, _covariance(v, flow))

        def keep_iterating(carry: tuple[jax.Array, ...]) -> jax.Array:
            return (carry[1] > TOLERANCE) & (carry[2] < 60)

        def correct(carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
            drag, _, count, share, before = carry
            after = drag_of(motions(drag))[0]
            left = after - drag
            # Aitken's share of the correction: the root of the secant through this residual and the one before
            turn = left - before
            share = jnp.where(count > 0, -share * jnp.sum(before * turn) / jnp.maximum(jnp.sum(turn**2), 1e-300), share)
            share = jnp.clip(share, 0.1, 1.0)
            change = jnp.linalg.norm(left) / jnp.maximum(jnp.linalg.norm(after), 1e-300)
            return drag + share * left, change, count + 1, share, left

        start = drag_of(jnp.zeros((flow.shape[0], basis.mass.shape[0]), complex))[0]
        carry = start, jnp.inf, 0, 0.5, jnp.zeros_like(start)
        drag, change, *_ = jax.lax.while_loop(keep_iterating, correct, carry)
        q = motions(drag)
        tension = q @ basis.tension.T + (rate * q) @ basis.tension_rate.T + end_tension
        mean = jnp.linalg.solve(basis.soft, basis.motions.T @ drag_of(q)[1].ravel())
        deviation = jnp.sqrt(0.5 * jnp.sum(jnp.abs(tension) ** 2, axis=0))
        moved = (q @ basis.motions.T).reshape(flow.shape)[:, nodes]
        return _Solved(tension[:, links], moved, deviation, basis.tension @ mean, drag, change)

    return jax.lax.map(solve, waves)


_jit_loads, _jit_drag = cached_jit(brief=True)(_wave_loads), cached_jit(brief=True)(_linear_drag)


def solve_states(
    still: Model, pose: State, loads: jax.Array, waves: Waves, links: np.ndarray, nodes: np.ndarray
) -> tuple[_Solved, float]:
    """All states in one basis, and the error of the basis.

    Args:
        still: the model without waves, about whose equilibrium `pose` under `loads` it moves.
        waves: with a leading axis of the states.
        links, nodes: whose amplitudes are returned.
    """
    from scipy.sparse import bsr_array, csc_array  # noqa: PLC0415
    from scipy.sparse.linalg import splu  # noqa: PLC0415

    linear, f, count = linearised_about(still, pose, loads), 3 * still.free_nodes, still.free_nodes
    stiffness, damping, mass = (csc_array(x) for x in (linear.stiffness, linear.damping, linear.mass))
    # static shifts with a stiffness of 1e-6 of the inertia: a slack line on the bed has none across itself
    soft = stiffness + 1e-6 * float(np.min(waves.omega)) ** 2 * mass
    by_position, by_speed = linear.tension_by_place[:, :f], linear.tension_by_speed[:, :f]
    dragging = _dragging(still)
    one = lambda i: jax.tree.map(lambda x: x[i], waves)  # noqa: E731

    def amplitudes(state: int, drag: np.ndarray, constant: np.ndarray) -> np.ndarray:
        """Displacements (c + 1, 3 free) by the full equations: under a constant force, and per component."""
        own = one(state)
        force, _, flow = (np.asarray(x) for x in _jit_loads(still, pose, own))
        water, other = (bsr_array((d, np.arange(count), np.arange(count + 1)), shape=(f, f)) for d in np.asarray(drag))
        right = np.concatenate([np.ravel(constant)[None], force + flow.reshape(-1, f) @ water.T])
        total = damping + water + other
        matrices = (
            soft + 0j * mass,
            *(stiffness + 1j * w * total - w**2 * mass for w in np.asarray(own.omega).tolist()),
        )
        return np.array([splu(csc_array(a)).solve(b.astype(complex)) for a, b in zip(matrices, right, strict=True)])

    # the basis: responses of the lowest, highest, shortest and longest seas, with the drag of fixed nodes and a tenth
    height, length = np.linalg.norm(waves.amplitude, axis=1), -np.mean(waves.omega, axis=1)
    chosen = np.unique([pick(x) for x in (height, length) for pick in (np.argmin, np.argmax)])
    found = []
    for state in chosen:
        flow = _jit_loads(still, pose, one(state))[2]
        for share in (1.0, 0.1):
            x = amplitudes(state, *_jit_drag(dragging, pose, _covariance(share * flow, 0.0 * flow)))
            found += [x.real, x.imag]
    shapes = np.concatenate(found).T
    inertia = np.mean(waves.omega) * np.sqrt(np.abs(linear.mass.diagonal()))
    stretch = 1.0 / np.sqrt(np.maximum(np.linalg.norm(by_position, axis=1), 1e-300))
    size = np.concatenate([inertia[:, None] * shapes, stretch[:, None] * (by_position @ shapes)])
    scale = np.maximum(np.linalg.norm(size, axis=0), 1e-300)
    _, values, right = np.linalg.svd(size / scale, full_matrices=False)
    # singular values of the responses that span the basis, relative to the largest one
    taken = values > 1e-4 * values[0]
    phi = (shapes / scale) @ (right[taken].T / values[taken])
    project = lambda a: phi.T @ (a @ phi)  # noqa: E731
    basis = _Basis(phi, *(project(a) for a in (soft, stiffness, damping, mass)), by_position @ phi, by_speed @ phi)
    solved = _batch(still, dragging, pose, jax.tree.map(jnp.asarray, basis), links, nodes, waves)
    errors = []
    for state in chosen:
        x = amplitudes(state, solved.damping[state], np.zeros(f))[1:]
        tension = x @ by_position.T + 1j * np.asarray(one(state).omega)[:, None] * (x @ by_speed.T)
        tension = tension + np.asarray(_jit_loads(still, pose, one(state))[1])
        exact, own = np.sqrt(0.5 * np.sum(np.abs(tension) ** 2, axis=0)), np.asarray(solved.deviation[state])
        errors.append(np.max(np.abs(own - exact)) / np.max(exact))
    return solved, float(max(errors))
