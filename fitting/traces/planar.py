"""Links that move in one vertical plane: angles and rates as minimal coordinates, closed between two fixed ends.

Angles are polar angles from the horizontal, positive downwards: link j is `d = L (cos theta, 0, -sin theta)`. With a
free end every angle is a coordinate. With a fixed end the links must close, `sum of d_j = D`, and likewise their rates,
which removes two coordinates. A local chart around a reference pose is then `theta = close_chain(theta_ref + N z)`,
with N an orthonormal basis of the closed directions at the reference.
"""

from __future__ import annotations

from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from dropper_jax.modelling.build import from_angles

Angles = TypeVar("Angles", Array, np.ndarray)


#: Maximum |y| [m] or [m/s] of a scene that counts as plane.
IN_PLANE = 1e-9


def check_planar(model: Model, start: State) -> None:
    """Reject a scene that traces of polar angles cannot describe.

    Raises:
        SceneError: ends that move, a start outside the vertical plane y = const., or links that cannot move in it.
    """
    if model.has_moving_ends:
        raise SceneError("effects.end_motion: moving ends cannot be fitted. Use a scene with ends at rest")
    if freedoms(model) < 1:
        raise SceneError(
            f"line.0.links = {model.line.links}: between two fixed points they cannot move in their plane, so "
            "that their angles show no damping; allowed: at least 3 links, or a free end"
        )
    held = np.asarray(model.ends(start.t).positions)[:, 1]
    y = np.concatenate([np.asarray(start.r)[:, 1], np.asarray(start.v)[:, 1] + held[0], held])
    if np.ptp(y) > IN_PLANE:
        raise SceneError(
            f"start: leaves the vertical plane by {np.ptp(y):.2g} (m or m/s); traces have one angle and describe "
            "motion in the x-z plane only. A static start turns out of the plane where a link is pushed: "
            "`dropper equilibrium` shows y; try another start.release_force [N]"
        )


def pendulum_period(length: float | Array | np.ndarray) -> float:
    """Period [s] of small swings of the shortest of mathematical pendulums of these lengths [m]."""
    return float(2 * np.pi * np.sqrt(np.min(np.asarray(length)) / GRAVITY))


def freedoms(model: Model) -> int:
    """Number of independent angles."""
    if model.both_ends_fixed:
        return model.line.links - 2
    return model.line.links


def directions(theta: Array) -> tuple[Array, Array]:
    """Unit link vectors in the (x, z) plane and their derivatives by theta, each (..., n, 2)."""
    c = jnp.cos(theta)
    s = jnp.sin(theta)
    return jnp.stack([c, -s], axis=-1), jnp.stack([-s, -c], axis=-1)


def _closing(model: Model, theta: Array, rows: Array) -> Array:
    """Smallest change of angles (n,) that removes rows (2,) [m] of the linearised closure."""
    x, z = (model.line.length[:, None] * directions(theta)[1]).T
    xx = jnp.sum(x * x)
    xz = jnp.sum(x * z)
    zz = jnp.sum(z * z)
    in_x = zz * rows[0] - xz * rows[1]
    in_z = xx * rows[1] - xz * rows[0]
    return (x * in_x + z * in_z) / (xx * zz - xz**2)


def gap(model: Model, theta: Array) -> Array:
    """Distance from the end of the chain of links to its fixed end, (2,) [m] in x and z."""
    ends = model.ends(jnp.zeros((), model.dtype))
    reach = jnp.sum(model.line.length[:, None] * directions(theta)[0], axis=0)
    return reach - (ends.end - ends.start)[jnp.array([0, 2])]


def close_chain(model: Model, theta: Array, omega: Array) -> tuple[Array, Array]:
    """The nearby angles (n,) [rad] and rates (n,) [rad/s] that satisfy closure; unchanged for a free end."""
    if not model.both_ends_fixed:
        return theta, omega

    def correct(theta: Array, _: None) -> tuple[Array, None]:
        return theta - _closing(model, theta, gap(model, theta)), None

    # Newton iterations of the closure; from a distance of 0.1 rad four reach rounding (convergence is quadratic)
    theta, _ = jax.lax.scan(correct, theta, None, length=4)
    rate = jnp.sum((model.line.length * omega)[:, None] * directions(theta)[1], axis=0)
    return theta, omega - _closing(model, theta, rate)


def chart(model: Model, theta: np.ndarray) -> np.ndarray:
    """Orthonormal bases N (k, n, m) of the closed directions at poses theta (k, n)."""
    links = theta.shape[-1]
    if not model.both_ends_fixed:
        return np.broadcast_to(np.eye(links), (*theta.shape[:-1], links, links)).copy()
    length = np.asarray(model.line.length)
    rows = np.stack([-length * np.sin(theta), -length * np.cos(theta)], axis=-2)
    return np.swapaxes(np.linalg.svd(rows)[2][..., 2:, :], -1, -2)


def to_state(model: Model, theta: Array, omega: Array) -> State:
    """The simulator's state for angles and rates (n,)."""
    still = jnp.zeros_like(theta)
    return from_angles(model, theta, still, omega, still, zero="horizontal")


def from_nodes(model: Model, r: Array, v: Array) -> tuple[Array, Array]:
    """Angles and rates (n,) of free nodes (nodes, 3); velocities along links (of midpoint schemes) are ignored."""
    ends = model.ends(jnp.zeros((), model.dtype))
    link = model.links(r, ends)
    rate = model.link_rates(v, None)
    theta = jnp.arctan2(-link[:, 2], link[:, 0])
    omega = (-rate[:, 2] * link[:, 0] + link[:, 2] * rate[:, 0]) / (link[:, 0] ** 2 + link[:, 2] ** 2)
    return theta, omega


def energy(model: Model, theta: Array, omega: Array) -> Array:
    """Kinetic and potential energy [J] of links at these angles and rates (n,)."""
    s = to_state(model, theta, omega)
    k = model.instant(s.r, s.v, s.t, model.ends(s.t))
    return model.kinetic_energy(k) + model.potential_energy(k)


@cached_jit()
def energies(model: Model, theta: Array | np.ndarray, omega: Array | np.ndarray) -> Array:
    """The same of many angles and rates (k, n): (k,) [J]."""
    return jax.vmap(partial(energy, model))(jnp.asarray(theta), jnp.asarray(omega))


def wrap(angle: Angles) -> Angles:
    """The angle [rad] as the shortest turn, between -pi and pi."""
    return angle - 2 * np.pi * (angle / (2 * np.pi)).round()
