"""Natural periods and modes about a static pose, from the stiffness and mass matrices there."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import eigh

from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from dropper_jax.statics.bodies import Coordinates, free_motions, generalised
from dropper_jax.statics.static_pose import rest
from dropper_jax.statics.system import RestProblem


@dataclass(frozen=True)
class Modes:
    """Free vibrations of small amplitude, undamped.

    Attributes:
        period: natural periods (modes,) [s], the longest first.
        shape: moves of the free nodes (modes, nodes, 3), largest component 1; of rigid bodies those of four corners
            each, the last ones.
        bodies: moves of the bodies' reference points [m] and turns about x, y, z [rad] (modes, bodies, 6); or None.
    """

    period: np.ndarray
    shape: np.ndarray
    bodies: np.ndarray | None = None

    @property
    def omega(self) -> np.ndarray:
        """Angular frequencies (modes,) [rad/s]."""
        return 2 * np.pi / self.period


def natural_modes(model: Model, pose: State, count: int | None = None) -> Modes:
    """Solve `K x = omega^2 M x` about the static pose of an elastic model.

    K is minus the derivative of all static forces with the tensions that belong to the links' lengths, made symmetric
    (drag of a current is not); M holds the masses and the added mass of the water at rest. Damping is left out.

    Args:
        pose: `equilibrium(...).state`.
        count: how many of the slowest modes; all by default. Modes without stiffness are left out.

    Raises:
        SceneError: rigid links, whose tensions do not follow from lengths.
    """
    if not model.line.axial.elastic:
        raise SceneError("line.axial.law: 'rigid' has no axial stiffness; allowed for modes: elastic, rope, tabulated")
    stiffness, mass = _matrices(rest(model), pose)
    motions = None
    if model.ties:  # only motions that leave bodies rigid
        motions = np.asarray(free_motions(model, pose)).reshape(len(mass), -1)
        mass, stiffness = motions.T @ mass @ motions, _turning(rest(model), pose)
    value, vector = eigh(stiffness, mass)
    stiff = value > 1e-13 * value[-1]  # rounding; swinging is 1e-11 of the axial stiffness of a chain
    value, vector = value[stiff][:count], vector[:, stiff][:, :count]
    shape = (vector if motions is None else motions @ vector).T.reshape(len(value), -1, 3)
    largest = np.take_along_axis(
        shape.reshape(len(value), -1), np.argmax(np.abs(shape.reshape(len(value), -1)), axis=1)[:, None], axis=1
    )
    shape = shape / largest[:, :, None]
    return Modes(2 * np.pi / np.sqrt(value), shape, _of_bodies(model, pose, shape) if model.ties else None)


def _turning(model: Model, pose: State) -> np.ndarray:
    """Stiffness in the coordinates of `statics.bodies`, what forces do as bodies turn included."""
    loads, zero = jnp.zeros_like(pose.r), jnp.zeros(Coordinates.of(model).size, model.dtype)
    found = np.asarray(jax.jit(jax.jacfwd(lambda q: generalised(model, pose, loads, q)))(zero))
    return 0.5 * (found + found.T)


def _of_bodies(model: Model, pose: State, shape: np.ndarray) -> np.ndarray:
    """Moves and small turns of the bodies (modes, bodies, 6)."""
    tie = model.ties[0]
    axes = np.asarray(tie.pose(model, pose.r)[1])
    moved, rates = (np.asarray(part) for part in jax.vmap(lambda r: tie.pose(model, r))(jnp.asarray(shape)))
    spin = rates @ np.swapaxes(axes, -1, -2)
    turned = [spin[..., 2, 1] - spin[..., 1, 2], spin[..., 0, 2] - spin[..., 2, 0], spin[..., 1, 0] - spin[..., 0, 1]]
    return np.concatenate([moved, 0.5 * np.stack(turned, axis=-1)], axis=-1)


def _matrices(model: Model, pose: State) -> tuple[np.ndarray, np.ndarray]:
    size = 3 * model.free_nodes
    problem = RestProblem(model, pose, jnp.zeros_like(pose.r), jnp.zeros((), model.dtype))

    def force(x: jax.Array) -> jax.Array:
        x = x.reshape(-1, 3)
        d = problem.link_vectors(x)
        return (problem.node_rows(x, ())[0] - model.gather(problem.link_rows(d, problem.tension(x))[0])).ravel()

    def inertia(a: jax.Array) -> jax.Array:
        k = problem.place(jnp.zeros_like(pose.r))
        return model.inertia(k, a.reshape(-1, 3)).ravel()

    zero = jnp.zeros(size, model.dtype)
    stiffness = np.asarray(jax.jit(jax.jacfwd(force))(zero))
    mass = np.asarray(jax.jit(jax.jacfwd(inertia))(zero))
    return 0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T)
