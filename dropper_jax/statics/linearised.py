"""Small motions about an equilibrium: mass, damping and stiffness matrices, and the effect of moving ends on tensions.

    M x'' + C x' + K x = -(M_h u'' + C_h u' + K_h u),    dT = T_x x + T_v x' + T_u u + T_w u'

x are displacements of the free nodes, u of the fixed points; all matrices are exact derivatives at the equilibrium.
They are those of zero amplitude: quadratic drag damps motion in a current, `dF/dv = rho c_d A U`, but not in still
water. Internal damping and linear damping are in C. Waves are left out, and dry friction has no linear form. For u =
Re(U exp(i w t)):

    x = -(K + i w C - w^2 M)^-1 (K_h + i w C_h - w^2 M_h) U

Dense: for hundreds of nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.read import short_text
from dropper_jax.model import Ends, Model, State
from dropper_jax.statics.rest_problem import held_names, require_stretching_links, rest
from dropper_jax.statics.stiffness import verges


@dataclass(frozen=True)
class Response:
    """Complex amplitudes of the response to `U exp(i w t)` of the ends; the motion is the real part of them times
    `exp(i w t)`.

    Attributes:
        omega: (k,) [rad/s].
        moves: displacements of the free nodes (k, free, 3) [m].
        tension: of the links (k, n) [N], relative to that of the equilibrium.
    """

    omega: np.ndarray
    moves: np.ndarray
    tension: np.ndarray


@dataclass(frozen=True)
class Linearised:
    """Matrices of small motions; degrees of freedom are x, y, z of the free nodes, and of the fixed points `held`.

    Attributes:
        mass, damping, stiffness: (f, f) [kg], [N s/m], [N/m]; f = 3 free.
        held_mass, held_damping, held_stiffness: (f, h) for motion of the fixed points; h = 3 held.
        tension_by_position, tension_by_velocity: (n, f + h) [N/m], [N s/m].
        tension: at the equilibrium (n,) [N].
        held: names of the fixed points.
        warnings: links on the verge of going slack, where small motions are not linear.
    """

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    held_mass: np.ndarray
    held_damping: np.ndarray
    held_stiffness: np.ndarray
    tension_by_position: np.ndarray
    tension_by_velocity: np.ndarray
    tension: np.ndarray
    held: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def response(self, omega: ArrayLike, motion: Mapping[str, ArrayLike]) -> Response:
        """Response to the motion `motion` of fixed points: amplitudes (3,) [m] by name, complex for a phase lag.

        Args:
            omega: angular frequencies (k,) [rad/s].

        Raises:
            SceneError: a name that is not a fixed point, or amplitudes that are not three finite numbers.
        """
        moved = np.zeros((len(self.held), 3), complex)
        for name, amplitude in motion.items():
            if name not in self.held:
                raise SceneError(f"motion: {name!r} is not a fixed point; {nearest(name, self.held)}")
            vector = np.asarray(amplitude)
            if vector.shape != (3,) or not np.all(np.isfinite(vector)):
                raise SceneError(
                    f"motion.{name}: {short_text(vector.tolist())} is out of range; allowed: 3 finite numbers m"
                )
            moved[self.held.index(name)] = vector
        omega = np.atleast_1d(np.asarray(omega, float))
        if not np.all(np.isfinite(omega) & (omega >= 0.0)):
            raise SceneError("omega: is out of range; allowed: angular frequencies of at least 0 rad/s")
        moves = np.zeros((len(omega), len(self.mass)), complex)
        tension = np.zeros((len(omega), len(self.tension)), complex)
        for i, w in enumerate(omega):
            moves[i], tension[i] = self._amplitudes(w, moved.ravel())
        return Response(omega, moves.reshape(len(omega), len(self.mass) // 3, 3), tension)

    def _amplitudes(self, w: float, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Amplitudes of displacements (f,) [m] and tensions (n,) [N] at w [rad/s], of those of fixed points u (h,)."""
        matrix = self.stiffness + 1j * w * self.damping - w**2 * self.mass
        push = (self.held_stiffness + 1j * w * self.held_damping - w**2 * self.held_mass) @ u
        try:
            x = -np.linalg.solve(matrix, push)
        except np.linalg.LinAlgError:
            raise SceneError(f"omega: {w:g} rad/s is an undamped resonance. Use another frequency") from None
        return x, (self.tension_by_position + 1j * w * self.tension_by_velocity) @ np.concatenate([x, u])


def linearised_about(model: Model, pose: State) -> Linearised:
    """The matrices about an equilibrium.

    Args:
        pose: `equilibrium(...).state`, also under additional forces.

    Raises:
        SceneError: rigid links or bodies, or an effect that is not smooth.
    """
    require_stretching_links(model)
    if model.constraints:
        raise SceneError("body: rigid bodies are not linearised; allowed: scenes of lines, points and buoys")
    if model.laws:
        raise SceneError(f"effects.{model.laws[0].name}: dry friction has no linear form. Use a scene without it")
    by_motion, tension_by_motion = _derivatives(rest(model), pose)
    free = 3 * model.free_nodes
    stiffness, damping, mass = (np.asarray(part).reshape(free, -1) for part in by_motion)
    return Linearised(
        mass=mass[:, :free],
        damping=damping[:, :free],
        stiffness=stiffness[:, :free],
        held_mass=mass[:, free:],
        held_damping=damping[:, free:],
        held_stiffness=stiffness[:, free:],
        tension_by_position=np.asarray(tension_by_motion[0]).reshape(-1, stiffness.shape[1]),
        tension_by_velocity=np.asarray(tension_by_motion[1]).reshape(-1, stiffness.shape[1]),
        tension=np.asarray(pose.tension),
        held=tuple(held_names(model)),
        warnings=verges(model, pose),
    )


@cached_jit()
def _derivatives(model: Model, pose: State) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Derivatives of the free nodes' rows, and of tensions, by positions, velocities and accelerations of all nodes."""
    free = model.free_nodes
    positions = model.ends(pose.t).positions

    def rows(x: Array, v: Array, a: Array) -> tuple[Array, Array]:
        k = model.instant(pose.r + x[:free], v[:free], pose.t, Ends(positions + x[free:], v[free:]))
        tension = model.tension_by_law(k)
        direction = model.line.axial.direction(k.links, k.links, k.links, model.line.length)
        left = model.inertia(k, a[:free], a[free:]) - model.force(k) - model.tension_force(tension, direction)
        return left, tension

    still = jnp.zeros((free + model.geometry.ends, 3), model.dtype)
    return jax.jacfwd(rows, argnums=(0, 1, 2))(still, still, still)
