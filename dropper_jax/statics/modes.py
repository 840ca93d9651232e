"""Natural periods, modes and damping of small motions about an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.linalg import solve_triangular

from dropper_jax.axial import STRETCHING_LAWS
from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from dropper_jax.statics.pose_stability import stiffness_and_motions, stiffness_of_motions
from dropper_jax.statics.rest_problem import rest
from dropper_jax.statics.tangent import AnyArray

#: Stiffness relative to the maximum (per mass) that is rounding; that of swinging is 1e-11 of the axial stiffness of a
#: chain.
ROUNDING = 1e-13


@dataclass(frozen=True)
class Modes:
    """Free vibrations of small amplitude, and the damping of each.

    Attributes:
        period: natural periods (modes,) [s], the longest first.
        shape: displacements of the free nodes (modes, nodes, 3), maximum component 1; the last ones are the corners of
            rigid bodies, four each.
        mass: modal masses (modes,) [kg], of the shape: `x'Mx`.
        damping_ratio: at zero amplitude (modes,), relative to `critical_damping`: includes `b_l`, but not `b_q`.
        bodies: displacements of the reference points [m] and rotations about x, y, z [rad] (modes, bodies, 6).
        body_share: fraction of the kinetic energy of each mode in each body (modes, bodies).
    """

    period: np.ndarray
    shape: np.ndarray
    mass: np.ndarray
    damping_ratio: np.ndarray
    bodies: np.ndarray
    body_share: np.ndarray

    def pick(self, which: np.ndarray) -> Modes:
        """The modes with these indices."""
        return Modes(*(part[which] for part in vars(self).values()))

    @property
    def omega(self) -> np.ndarray:
        """Angular frequencies (modes,) [rad/s]."""
        return 2 * np.pi / self.period

    @property
    def critical_damping(self) -> np.ndarray:
        """Critical modal damping (modes,) [kg/s], `2 omega mass`: the thesis' (2.5), `b_cr = 2 sqrt(k m)`."""
        return 2 * self.omega * self.mass


def natural_modes(model: Model, pose: State, count: int | None = None) -> Modes:
    """Solve `K x = omega^2 M x` about an equilibrium.

    K is minus the derivative of all static forces, including tensions that follow from the lengths of links. It is
    symmetrised, since drag in a current is not symmetric. M contains the masses and the added mass of the water at
    rest. Inextensible links keep their tension T to first order and allow motions x with `G x = 0`, G being the
    derivative of the lengths. For these K is the second derivative of the potential and of `T` times the lengths.

    Damping ratios are `x'Cx / (2 omega x'Mx)`, C being minus the derivative of all forces by the velocities. They are
    exact to first order in C, and for modes without coupling by damping. Dry friction is left out.

    Args:
        pose: `equilibrium(...).state`.
        count: number of the slowest modes; all by default. Modes without stiffness are left out.
    """
    still = rest(model)
    stiffness, motions = stiffness_of_motions(still, pose)
    inertia = np.asarray(_mass(still, pose))
    square, vector = _slowest_modes(_symmetric(stiffness), _symmetric(motions.T @ inertia @ motions), count)
    shape = (motions @ vector).T
    largest = np.take_along_axis(shape, np.argmax(np.abs(shape), axis=1)[:, None], axis=1)
    shape = (shape / largest).reshape(len(square), -1, 3)
    mass = 1.0 / np.ravel(largest) ** 2
    omega = np.sqrt(square)
    ratio = np.asarray(_damping(model, pose, jnp.asarray(shape))) / (2 * omega * mass)
    bodies = np.zeros((len(square), 0, 6))
    share = np.zeros((len(square), 0))
    if model.constraints:
        bodies, energy = _of_bodies(model, pose, inertia, shape)
        share = energy / mass[:, None]
    return Modes(2 * np.pi / omega, shape, mass, ratio, bodies, share)


def _slowest_modes(stiffness: np.ndarray, mass: np.ndarray, count: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the angular frequencies (modes,) and eigenvectors (k, modes) of modes with a stiffness, x'Mx = 1."""
    from scipy.linalg import eigh  # noqa: PLC0415 - 0.12 s of the start of programs that need no modes

    square, vector = eigh(stiffness, mass)
    stiff = square > ROUNDING * square[-1]
    return square[stiff][:count], vector[:, stiff][:, :count]


def damping_at(model: Model, pose: State, modes: Modes, amplitude: float) -> np.ndarray:
    """Damping ratios (modes,) at an amplitude [m] of the maximum component, including quadratic drag.

    `ratio = D / (4 pi E)` with the energy D dissipated by all forces in a period of `x = A shape sin(omega t)` about
    the equilibrium, and `E = omega^2 A^2 mass / 2`. For `b_q |v| v` on one mass the ratio is `4 b_q A / (3 pi m)`.
    """
    speed = amplitude * jnp.asarray(modes.omega[:, None, None] * modes.shape)
    lost = -np.asarray(_mean_power(model, pose, speed)) * modes.period
    return lost / (4 * np.pi * 0.5 * modes.omega**2 * amplitude**2 * modes.mass)


def natural_periods(model: Model, pose: State, count: int) -> Array:
    """The longest natural periods (count,) [s] about an equilibrium, differentiable in model and configuration.

    With `K x = omega^2 M x`, x'Mx = 1:  d(omega^2) = x'(dK - omega^2 dM) x, where K depends on the configuration. Use
    that of `equilibrium` or `settle` of the same model, which has the required derivatives. Of modes with equal periods
    only the sum of omega^2 has a derivative. Missing modes (fewer than `count` with a stiffness) are NaN.

    Raises:
        SceneError: rigid links.
    """
    if not model.line.axial.elastic:
        raise SceneError(
            "line.axial.law: the modes of 'rigid' links depend on the configuration: periods have no derivative here; "
            f"allowed: {STRETCHING_LAWS}"
        )
    still = rest(model)
    stiffness, motions = stiffness_and_motions(still, pose)
    stiffness = _symmetric(stiffness)
    mass = _symmetric(motions.T @ _mass(still, pose) @ motions)
    lower = jnp.linalg.cholesky(jax.lax.stop_gradient(mass))
    solve_lower = partial(solve_triangular, lower, lower=True)
    value, vector = jnp.linalg.eigh(solve_lower(solve_lower(jax.lax.stop_gradient(stiffness)).T))
    number = jnp.sum(value <= ROUNDING * value[-1]) + jnp.arange(count)
    x = solve_triangular(lower.T, vector, lower=False)[:, jnp.minimum(number, len(value) - 1)]
    square = jnp.sum(x * (stiffness @ x), axis=0) / jnp.sum(x * (mass @ x), axis=0)
    return 2 * jnp.pi / jnp.sqrt(jnp.where(number < len(value), square, jnp.nan))


def _force_at_velocity(model: Model, pose: State, v: Array) -> Array:
    """Forces (free nodes, 3) [N] at the equilibrium with the velocity v, without the tensions of rigid links."""
    k = model.instant(pose.r, v, pose.t, model.ends(pose.t))
    return model.force(k) + model.tension_force(model.tension_by_law(k), k.tangents)


@cached_jit()
def _damping(model: Model, pose: State, shapes: Array) -> Array:
    """`x'Cx` (modes,) [kg/s]."""
    model = rest(model)
    _, linear = jax.linearize(partial(_force_at_velocity, model, pose), jnp.zeros_like(pose.r))
    return jax.lax.map(lambda x: -jnp.sum(x * linear(x)), shapes)


#: Number of instants per period at which the power of damping is summed; exact for powers of the speed up to 30.
INSTANTS = 32


@cached_jit()
def _mean_power(model: Model, pose: State, speeds: Array) -> Array:
    """Mean power (modes,) [W] of all forces over a period with the velocity amplitudes (modes, nodes, 3)."""
    model = rest(model)
    phases = jnp.cos(2 * jnp.pi * (jnp.arange(INSTANTS) + 0.5) / INSTANTS)

    def power(v: Array) -> Array:
        return jnp.sum(_force_at_velocity(model, pose, v) * v)

    def mean_power(speed: Array) -> Array:
        return jnp.mean(jax.vmap(lambda phase: power(phase * speed))(phases))

    return jax.lax.map(mean_power, speeds)


def _of_bodies(model: Model, pose: State, inertia: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements and small rotations of the bodies (modes, bodies, 6), and their part of `x'Mx` (modes, bodies)
    [kg], that of their corners."""
    constraint = model.constraints[0]
    axes = constraint.pose(model, pose.r)[1]
    moved, rates = jax.vmap(lambda r: constraint.pose(model, r))(jnp.asarray(shape))
    # w = 1/2 sum e_j x e_j' of the axes e_j, which are columns
    turned = 0.5 * np.sum(np.cross(axes, rates, axis=-2), axis=-1)
    of_nodes = np.sum(shape * (shape.reshape(len(shape), -1) @ inertia.T).reshape(shape.shape), axis=2)
    return np.concatenate([moved, turned], axis=-1), np.sum(of_nodes[:, constraint.body_nodes(model)], axis=2)


def _symmetric(matrix: AnyArray) -> AnyArray:
    return 0.5 * (matrix + matrix.T)


@cached_jit()
def _mass(model: Model, pose: State) -> Array:
    """Masses and added mass (3 free, 3 free) [kg]."""

    def inertia(a: Array) -> Array:
        k = model.instant(pose.r, jnp.zeros_like(pose.r), pose.t, model.ends(pose.t))
        return model.inertia(k, a.reshape(-1, 3)).ravel()

    return jax.jacfwd(inertia)(jnp.zeros(pose.r.size, model.dtype))
