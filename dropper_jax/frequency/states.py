"""Many sea states in the frequency domain, in one basis of motions: responses that are solved in full at a few of them.

The equations are those of `dropper_jax.frequency.linear_waves`.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.frequency.linear_drag import dragging_effects, iterate_drag, linear_drag, no_drag
from dropper_jax.frequency.linear_waves import (
    LinearMotion,
    WaveLoads,
    linearise,
    respond,
    static_matrix,
    static_shift,
    tension_changes,
    wave_loads,
)
from dropper_jax.model import Model, State
from dropper_jax.sea.waves import Waves
from dropper_jax.statics.tangent import Tangent


class _Basis(NamedTuple):
    """Motions (m, free, 3), the matrices (m, m) along them, and tensions (m, n) by displacement and speed."""

    motions: Array
    soft: Array
    stiffness: Array
    damping: Array
    mass: Array
    tension: Array
    tension_rate: Array


class SolvedStates(NamedTuple):
    """A state: amplitudes at the picked links (c, picked) [N] and nodes (c, picked, 3) [m], standard deviation and mean
    shift of all tensions (n,) [N], D (2, free, 3, 3) [N s/m] of water and other effects, its last relative change."""

    tension: Array
    motion: Array
    deviation: Array
    shift: Array
    drag: Array
    change: Array


#: Change of the linearised drag in an iteration, over its size, at which it has converged.
DRAG_TOLERANCE = 1e-3
#: States per call of the compiled program, so that any number of states uses the same one.
STATES_PER_CALL = 8
#: The basis has responses with the drag of nodes that do not move, and with this fraction of the flow.
FLOW_SHARES = (1.0, 0.1)


@cached_jit()
def _chunk_loads(still: Model, pose: State, waves: Waves) -> WaveLoads:
    """The loads of several states."""
    return jax.vmap(partial(wave_loads, still, pose))(waves)


@cached_jit()
def _fixed_drag(dragging: tuple[Model, Model], pose: State, flow: Array) -> tuple[Array, Array]:
    """D and the mean force of nodes that do not move."""
    return linear_drag(dragging, pose, jnp.zeros_like(flow), flow)


@cached_jit()
def _amplitudes(
    still: Model, linear: LinearMotion, drag: Array, constant: Array, loads: WaveLoads, omega: Array
) -> tuple[Array, Array]:
    """By the full equations: displacements per component and under a constant force (c + 1, free, 3), tensions (c,
    n)."""
    x = respond(still, linear, drag, loads, omega)
    tension = tension_changes(still, linear, x, 1j * omega[:, None, None] * x) + loads.tension
    return jnp.concatenate([x, static_shift(still, linear, omega, constant)[None]]), tension


@cached_jit()
def _project_basis(still: Model, linear: LinearMotion, motions: Array, omega: Array) -> _Basis:
    """The basis of these motions (m, free, 3); `omega`: of all states."""
    flat = motions.reshape(motions.shape[0], -1)

    def project(matrix: Array) -> Array:
        return flat @ jax.vmap(partial(Tangent.of(still).multiply, matrix))(motions).reshape(flat.shape).T

    none = jnp.zeros_like(motions)
    return _Basis(
        motions,
        soft=project(static_matrix(linear, omega)),
        stiffness=project(linear.stiffness),
        damping=project(linear.damping),
        mass=project(linear.mass),
        tension=tension_changes(still, linear, motions, none),
        tension_rate=tension_changes(still, linear, none, motions),
    )


@cached_jit()
def _solve_chunk(
    dragging: tuple[Model, Model],
    pose: State,
    basis: _Basis,
    picked: tuple[Array, Array],
    loads: WaveLoads,
    omega: Array,
) -> SolvedStates:
    """Several states in the basis, one after another; `picked` are links and nodes."""
    links, nodes = picked
    parts = basis.motions

    def project(d: Array) -> Array:
        """Matrices of the nodes (free, 3, 3) along the basis (m, m)."""
        return jnp.einsum("ani,nij,bnj->ab", parts, d, parts)

    def solve(state: tuple[WaveLoads, Array]) -> SolvedStates:
        loads, omega = state
        rate = 1j * omega[:, None]
        w = omega[:, None, None]
        push = jnp.einsum("ani,cni->ca", parts, loads.force)

        def motions(drag: Array) -> Array:
            right = push + jnp.einsum("ani,nij,cnj->ca", parts, drag[0], loads.flow)
            matrix = basis.stiffness + 1j * w * (basis.damping + project(drag[0] + drag[1])) - w**2 * basis.mass
            return jnp.linalg.solve(matrix, right[..., None])[..., 0]

        def drag_of(drag: Array, number: Array) -> tuple[Array, Array]:
            q = jnp.where(number > 0, motions(drag), 0.0)  # at first the drag of nodes that do not move
            return linear_drag(dragging, pose, jnp.tensordot(rate * q, parts, 1), loads.flow)

        drag, shift, change = iterate_drag(drag_of, no_drag(pose), DRAG_TOLERANCE)
        q = motions(drag)
        tension = q @ basis.tension + (rate * q) @ basis.tension_rate + loads.tension
        mean = jnp.linalg.solve(basis.soft, jnp.einsum("ani,ni->a", parts, shift)) @ basis.tension
        deviation = jnp.sqrt(0.5 * jnp.sum(jnp.abs(tension) ** 2, axis=0))
        return SolvedStates(tension[:, links], jnp.tensordot(q, parts[:, nodes], 1), deviation, mean, drag, change)

    return jax.lax.map(solve, (loads, omega))


def solve_states(
    still: Model, pose: State, waves: Waves, links: np.ndarray, nodes: np.ndarray
) -> tuple[SolvedStates, float]:
    """All states in one basis, and the error of the basis.

    Args:
        still: the model without waves, about whose equilibrium `pose` it moves.
        waves: with a leading axis of the states.
        links, nodes: whose amplitudes are returned.
    """
    linear = linearise(still, pose)
    dragging = dragging_effects(still)
    omega = np.asarray(waves.omega)
    chosen = _extreme_states(waves)
    loads = _loads_of(still, pose, waves, chosen)
    responses = _responses(still, pose, linear, dragging, loads, omega[chosen])
    motions = jnp.asarray(_basis_motions(still, linear, responses, omega))
    basis = _project_basis(still, linear, motions, waves.omega)
    picked = jnp.asarray(links), jnp.asarray(nodes)
    parts = []
    for states in np.split(np.arange(len(omega)), range(STATES_PER_CALL, len(omega), STATES_PER_CALL)):
        own = _chunk(waves, states)
        solved = _solve_chunk(dragging, pose, basis, picked, _chunk_loads(still, pose, own), own.omega)
        parts.append(solved)
    found = jax.tree.map(lambda *x: np.concatenate(x)[: len(omega)], *parts)  # the last chunk is filled up
    return found, _basis_error(still, linear, found, chosen, loads, omega)


def _chunk(waves: Waves, states: np.ndarray) -> Waves:
    """The waves of these states, repeated up to a full chunk."""
    return jax.tree.map(lambda x: x[np.resize(states, STATES_PER_CALL)], waves)


def _extreme_states(waves: Waves) -> np.ndarray:
    """The states with the lowest, highest, longest and shortest waves."""
    height = np.linalg.norm(waves.amplitude, axis=1)
    frequency = np.mean(waves.omega, axis=1)
    return np.unique([np.argmin(height), np.argmax(height), np.argmin(frequency), np.argmax(frequency)])


def _loads_of(still: Model, pose: State, waves: Waves, states: np.ndarray) -> list[WaveLoads]:
    """The loads of each of these states, at most a chunk."""
    force, tension, flow = map(np.asarray, _chunk_loads(still, pose, _chunk(waves, states)))
    return list(map(WaveLoads, force, tension, flow))[: len(states)]


def _responses(
    still: Model,
    pose: State,
    linear: LinearMotion,
    dragging: tuple[Model, Model],
    loads: list[WaveLoads],
    omega: np.ndarray,
) -> np.ndarray:
    """Displacements (k, free, 3) of states by the full equations, real and imaginary parts."""
    found = []
    for own, frequencies in zip(loads, omega, strict=True):
        for share in FLOW_SHARES:
            drag, constant = _fixed_drag(dragging, pose, share * own.flow)
            x, _ = _amplitudes(still, linear, drag, constant, own, jnp.asarray(frequencies))
            found += [np.real(x), np.imag(x)]
    return np.concatenate(found)


def _basis_error(
    still: Model,
    linear: LinearMotion,
    solved: SolvedStates,
    states: np.ndarray,
    loads: list[WaveLoads],
    omega: np.ndarray,
) -> float:
    """The largest error of the deviations of tension of these states, with their own linearised drag, over the largest
    deviation of the state by the full equations."""
    errors = []
    for state, own in zip(states, loads, strict=True):
        drag = jnp.asarray(solved.drag[state])
        no_force = jnp.zeros(own.flow.shape[1:], still.dtype)
        _, tension = _amplitudes(still, linear, drag, no_force, own, jnp.asarray(omega[state]))
        exact = np.sqrt(0.5 * np.sum(np.abs(tension) ** 2, axis=0))
        errors.append(np.max(np.abs(solved.deviation[state] - exact)) / np.max(exact))
    return float(max(errors))


#: Singular values of the responses that span the basis, relative to the largest one.
BASIS_SHARE = 1e-4


def _basis_motions(still: Model, linear: LinearMotion, shapes: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Motions (m, free, 3) that span displacements (k, free, 3): orthonormal in the sum of kinetic energies and squared
    changes of tension over their stiffness."""
    moved, tension = _sizes(still, linear, jnp.asarray(shapes))
    size = np.concatenate([np.mean(omega) * np.asarray(moved), np.asarray(tension)], axis=1).T
    scale = np.maximum(np.linalg.norm(size, axis=0), 1e-300)
    _, values, right = np.linalg.svd(size / scale, full_matrices=False)
    taken = values > BASIS_SHARE * values[0]
    return np.tensordot(right[taken] / values[taken, None], shapes / scale[:, None, None], 1)


@cached_jit()
def _sizes(still: Model, linear: LinearMotion, shapes: Array) -> tuple[Array, Array]:
    """Displacements of the nodes times the roots of their masses (k, 3 free), and tensions over their roots of
    stiffness (k, n)."""
    moved = shapes * jnp.sqrt(still.node_mass)[:, None]
    stiffness = jnp.sqrt(2.0) * jnp.linalg.norm(linear.stretch, axis=1)
    tension = tension_changes(still, linear, shapes, jnp.zeros_like(shapes))
    return moved.reshape(len(shapes), -1), tension / jnp.sqrt(jnp.maximum(stiffness, 1e-300))
