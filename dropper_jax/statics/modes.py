"""Natural periods and modes about a static pose, from the stiffness and mass matrices there."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import eigh

from dropper_jax.base.errors import SceneError
from dropper_jax.base.programs import kept
from dropper_jax.model import Model, State
from dropper_jax.statics.bodies import free_motions, generalised
from dropper_jax.statics.calm import rest
from dropper_jax.statics.tangent import unbalanced_rows

#: Stiffness over the largest one (per mass) that is rounding; swinging is 1e-11 of the axial stiffness of a chain.
ROUNDING = 1e-13


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
    _refuse_rigid(model)
    stiffness, mass, motions = (np.asarray(part) for part in _matrices(model, pose))
    value, vector = eigh(stiffness, mass)
    stiff = value > ROUNDING * value[-1]
    value, vector = value[stiff][:count], vector[:, stiff][:, :count]
    shape = (motions @ vector).T.reshape(len(value), -1, 3)
    largest = np.take_along_axis(
        shape.reshape(len(value), -1), np.argmax(np.abs(shape.reshape(len(value), -1)), axis=1)[:, None], axis=1
    )
    shape = shape / largest[:, :, None]
    return Modes(2 * np.pi / np.sqrt(value), shape, _of_bodies(model, pose, shape) if model.ties else None)


def natural_periods(model: Model, pose: State, count: int) -> jax.Array:
    """The longest natural periods (count,) [s] about a static pose, differentiable in model and pose.

    With `K x = omega^2 M x`, x'Mx = 1:  d(omega^2) = x'(dK - omega^2 dM) x, where K follows the pose. Take the pose
    from `equilibrium` or `settle` of the same model, so that it does. Of modes with equal periods only the sum of
    omega^2 has a derivative; NaN where there are not so many modes with a stiffness.

    Raises:
        SceneError: rigid links.
    """
    _refuse_rigid(model)
    stiffness, mass, _ = _symmetric(model, pose)
    lower = jnp.linalg.cholesky(jax.lax.stop_gradient(mass))
    solved = lambda a: jax.scipy.linalg.solve_triangular(lower, a, lower=True)  # noqa: E731
    value, vector = jnp.linalg.eigh(solved(solved(jax.lax.stop_gradient(stiffness)).T))
    number = jnp.sum(value <= ROUNDING * value[-1]) + jnp.arange(count)
    x = jax.scipy.linalg.solve_triangular(lower.T, vector, lower=False)[:, jnp.minimum(number, len(value) - 1)]
    square = jnp.sum(x * (stiffness @ x), axis=0) / jnp.sum(x * (mass @ x), axis=0)
    return 2 * jnp.pi / jnp.sqrt(jnp.where(number < len(value), square, jnp.nan))


def _refuse_rigid(model: Model) -> None:
    if not model.line.axial.elastic:
        raise SceneError("line.axial.law: 'rigid' has no axial stiffness; allowed for modes: elastic, rope, tabulated")


def _of_bodies(model: Model, pose: State, shape: np.ndarray) -> np.ndarray:
    """Moves and small turns of the bodies (modes, bodies, 6)."""
    tie = model.ties[0]
    axes = np.asarray(tie.pose(model, pose.r)[1])
    moved, rates = (np.asarray(part) for part in jax.vmap(lambda r: tie.pose(model, r))(jnp.asarray(shape)))
    spin = rates @ np.swapaxes(axes, -1, -2)
    turned = [spin[..., 2, 1] - spin[..., 1, 2], spin[..., 0, 2] - spin[..., 2, 0], spin[..., 1, 0] - spin[..., 0, 1]]
    return np.concatenate([moved, 0.5 * np.stack(turned, axis=-1)], axis=-1)


@kept(brief=True)
def _matrices(model: Model, pose: State) -> tuple[jax.Array, jax.Array, jax.Array]:
    return _symmetric(model, pose)


def _symmetric(model: Model, pose: State) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Stiffness and mass (k, k), made symmetric, and the motions of the free nodes (3 free, k) that they are of.

    With rigid bodies only motions that leave these rigid, what forces do as bodies turn included.
    """
    full, model = model, rest(model)
    size = 3 * model.free_nodes
    loads, none = jnp.zeros_like(pose.r), jnp.zeros(size, model.dtype)

    def inertia(a: jax.Array) -> jax.Array:
        k = model.instant(pose.r, jnp.zeros_like(pose.r), pose.t, model.ends(pose.t))
        return model.inertia(k, a.reshape(-1, 3)).ravel()

    mass = jax.jacfwd(inertia)(none)
    if model.ties:
        motions = free_motions(full, pose).reshape(size, -1)
        zero = jnp.zeros(motions.shape[1], model.dtype)
        stiffness = jax.jacfwd(lambda q: generalised(model, pose, loads, q))(zero)
        mass = motions.T @ mass @ motions
    else:
        motions = jnp.eye(size, dtype=model.dtype)
        rows = lambda x: unbalanced_rows(model, pose, loads, x.reshape(-1, 3)).ravel()  # noqa: E731
        stiffness = jax.jacfwd(rows)(none)
    return 0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T), motions
