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
from numpy.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.model import Ends, Model, State
from dropper_jax.statics.rest_problem import rest
from dropper_jax.statics.stiffness import stiffness_with_held, verges


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
        tension_by_place, tension_by_speed: (n, f + h) [N/m], [N s/m].
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
    tension_by_place: np.ndarray
    tension_by_speed: np.ndarray
    tension: np.ndarray
    held: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def response(self, omega: ArrayLike, motion: Mapping[str, ArrayLike]) -> Response:
        """Response to the motion `motion` of fixed points: amplitudes (3,) [m] by name, complex for a phase lag.

        Args:
            omega: angular frequencies (k,) [rad/s].

        Raises:
            SceneError: a name that is not a fixed point.
        """
        moved = np.zeros((len(self.held), 3), complex)
        for name, amplitude in motion.items():
            if name not in self.held:
                raise SceneError(f"motion: {name!r} is not a fixed point; {nearest(name, self.held)}")
            moved[self.held.index(name)] = np.asarray(amplitude)
        omega = np.atleast_1d(np.asarray(omega, float))
        u = moved.ravel()
        if not (np.all(np.isfinite(omega)) and np.all(omega >= 0.0)):
            raise SceneError("omega: is out of range; allowed: angular frequencies of at least 0 rad/s")
        each = [self._at(w, u) for w in omega]
        x, tension = map(np.array, zip(*each, strict=True))
        return Response(omega, x.reshape(len(omega), -1, 3), tension)

    def _at(self, w: float, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        matrix = self.stiffness + 1j * w * self.damping - w**2 * self.mass
        push = (self.held_stiffness + 1j * w * self.held_damping - w**2 * self.held_mass) @ u
        try:
            x = -np.linalg.solve(matrix, push)
        except np.linalg.LinAlgError:
            raise SceneError(f"omega: {w:g} rad/s is an undamped resonance. Use another frequency") from None
        return x, (self.tension_by_place + 1j * w * self.tension_by_speed) @ np.concatenate([x, u])


def linearised_about(model: Model, pose: State, loads: jax.Array | None = None) -> Linearised:
    """The matrices about an equilibrium.

    Args:
        pose: `equilibrium(...).state`.
        loads: additional forces of the equilibrium (free nodes, 3) [N].

    Raises:
        SceneError: rigid links or bodies, or an effect that is not smooth.
    """
    if not model.line.axial.elastic:
        raise SceneError("line.axial.law: 'rigid' has no axial stiffness; allowed: elastic, rope, tabulated")
    if model.constraints:
        raise SceneError("body: rigid bodies are not linearised; allowed: scenes of lines, points and buoys")
    if model.laws:
        raise SceneError(f"effects.{model.laws[0].name}: dry friction has no linear form. Use a scene without it")
    loads = jnp.zeros_like(pose.r) if loads is None else loads
    (damping, by_speed), (mass, _), by_position = _matrices(rest(model), pose)
    f = 3 * model.free_nodes
    stiffness = stiffness_with_held(rest(model), pose, loads)[:f].toarray()
    names = tuple(model.points[int(i)].name for i in model.geometry.held_points)
    cut = lambda a: (np.asarray(a)[:, :f], np.asarray(a)[:, f:])  # noqa: E731
    k, kh = cut(stiffness)
    c, ch = cut(damping)
    m, mh = cut(mass)
    by = np.asarray(by_position), np.asarray(by_speed)
    return Linearised(m, c, k, mh, ch, kh, *by, np.asarray(pose.tension), names, verges(model, pose))


@cached_jit()
def _matrices(model: Model, pose: State) -> tuple[tuple[jax.Array, jax.Array] | jax.Array, ...]:
    """Derivatives of the free nodes' rows and of tensions by velocities and accelerations, of tensions by positions."""
    free = 3 * model.free_nodes
    held = 3 * model.geometry.ends
    positions = model.ends(pose.t).positions

    def rows(x: jax.Array, v: jax.Array, a: jax.Array) -> tuple[jax.Array, jax.Array]:
        at = lambda y: (y[:free].reshape(-1, 3), y[free:].reshape(-1, 3))  # noqa: E731
        dr, du = at(x)
        dv, dw = at(v)
        da, db = at(a)
        k = model.instant(pose.r + dr, dv, pose.t, Ends(positions + du, dw))
        tension = model.tension_by_law(k)
        direction = model.line.axial.direction(k.links, k.links, k.links, model.line.length)
        left = model.inertia(k, da, db) - model.force(k) - model.tension_force(tension, direction)
        return left.ravel(), tension

    zero = jnp.zeros(free + held, model.dtype)
    by_position = jax.jacfwd(lambda x: rows(x, zero, zero)[1])(zero)
    return *(jax.jacfwd(rows, argnums=i)(zero, zero, zero) for i in (1, 2)), by_position
