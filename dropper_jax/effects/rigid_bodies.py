"""Rigid bodies with six degrees of freedom: mass, inertia, centre of mass, weight, and the lines attached to them."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.constants import GRAVITY
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import cross, dot, trace_once, upright
from dropper_jax.model import HolonomicConstraint, Kinematics, ModelView

#: Pairs of corners of a body, whose distances are constant.
FIRST, SECOND = np.triu_indices(4, 1)
#: Pairs of axes of the six moments and products of inertia.
MOMENT_AXES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: Index of each entry of the matrix of inertia among them.
MOMENT_INDEX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])

#: Fraction of a body's mass carried by each node on it: a node without a line must not be without inertia.
NODE_SHARE = 1e-3
#: A step leaves an energy error of the order of this fraction of a body's size: with it tumbling bodies conserve energy
#: to 3e-10 in 6000 steps (1e-9 with a fraction of 1).
GAP_SHARE = 0.001


@component
class RigidBodies(HolonomicConstraint):
    """Bodies of `[[body]]` as four nodes each, the corners of a tetrahedron whose six edges keep their length.

    Every point s of a body (in its own axes) is a fixed weighted combination of its corners, `x = sum_i w_i(s) r_i`
    with `sum w_i = 1`, `sum w_i s_i = s` (natural coordinates; Betsch and Steinmann 2001). The kinetic energy is then
    `1/2 sum_ij M_ij r_i' . r_j'` with the constant `M_ij = int w_i w_j dm` of mass, centre of mass and inertia. This is
    exact for any rigid body. With the constraints of the edges, the energy-momentum step conserves it together with the
    angular momentum. Points at which lines are attached are separate nodes with `r = sum_i w_i r_i`. A pinned body
    keeps its reference point fixed, `sum_i w_i r_i = pin`, and rotates about it.
    """

    name = "rigid_bodies"
    mass: Array = parameter("mass", unit="kg", shape="table", above=0.0)
    centre_of_mass: Array = parameter("centre of mass in the body's axes", unit="m", shape="vectors")
    moments: Array = parameter("Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass", unit="kg m^2", shape="vectors")
    corner: Array = parameter("corners in the body's axes (bodies, 4, 3)", unit="m", shape="vectors")
    affine: Array = parameter("[s, 1] @ affine: weights of a position s (bodies, 4, 4)", unit="-", shape="vectors")
    seat: Array = parameter("positions of the attached points in their body's axes", unit="m", shape="vectors")
    velocity: Array = parameter("velocity of the centre of mass at the start", unit="m/s", shape="vectors")
    spin: Array = parameter("angular velocity at the start, in the body's axes", unit="rad/s", shape="vectors")
    #: The mass matrix if it has been computed: in the equations of a step, which use it many times.
    matrix: Array | None = None
    gravity: Array = parameter("acceleration of gravity", unit="m/s^2", low=0.0, default=GRAVITY)
    first: int = option("number of the first corner among the points", type=int, default=0)
    points: tuple[int, ...] = option("numbers of the points attached to bodies", type=tuple, default=())
    owner: tuple[int, ...] = option("body of each attached point", type=tuple, default=())
    names: tuple[str, ...] = option("names of the bodies", type=list, default=())
    pin: Array = parameter("positions of the pinned bodies' reference points", unit="m", shape="vectors", default=())
    pinned: tuple[int, ...] = option("numbers of the pinned bodies", type=tuple, default=())

    @property
    def count(self) -> int:
        return len(self.names)

    def body_nodes(self, model: ModelView) -> np.ndarray:
        return model.geometry.point_node[self.first + np.arange(4 * self.count)].reshape(-1, 4)

    def seats(self, model: ModelView) -> np.ndarray:
        return model.geometry.point_node[np.array(self.points, int)]

    @property
    def _owners(self) -> np.ndarray:
        """Body of each attached point (seats,)."""
        return np.array(self.owner, int)

    def _nodes_and_bodies(self, model: ModelView) -> tuple[np.ndarray, np.ndarray]:
        """All nodes of bodies, corners first, and their bodies."""
        nodes = np.concatenate([self.body_nodes(model).ravel(), self.seats(model)])
        return nodes, np.concatenate([np.repeat(np.arange(self.count), 4), self._owners])

    def _seat_shares(self) -> Array:
        """Weights of the attached points in the corners of their body (seats, 4)."""
        return shares(self.affine[self._owners], self.seat)

    def seat_shares(self) -> Array:
        owns = np.eye(self.count)[self._owners]
        return (owns[:, :, None] * self._seat_shares()[:, None, :]).reshape(len(self.owner), -1)

    @trace_once
    def pose(self, model: ModelView, r: Array) -> tuple[Array, Array]:
        """Reference points (bodies, 3) [m] and axes (bodies, 3, 3) of the bodies, from positions r (free nodes, 3).

        For velocities: the velocities of the reference points and the rates of the axes.
        """
        own = jnp.einsum("bki,bic->bck", self.affine, r[self.body_nodes(model)])
        return own[..., 3], own[..., :3]

    def references(self, corners: Array) -> Array:
        return jnp.sum(self.affine[:, 3, :, None] * corners, axis=1)

    @trace_once
    def initial_velocities(self, model: ModelView, r: Array) -> Array:
        """Initial velocities (free nodes, 3) [m/s] of the bodies' corners and attached points, at positions r."""
        _, axes = self.pose(model, r)
        nodes, body = self._nodes_and_bodies(model)
        local = jnp.concatenate([self.corner.reshape(-1, 3), self.seat])
        turning = cross(self.spin[body], local - self.centre_of_mass[body])
        velocity = self.velocity[body] + jnp.einsum("bck,bk->bc", axes[body], turning)
        return scatter_add(nodes, velocity, model.free_nodes)

    def lengths(self) -> Array:
        """Edges (bodies, 6) [m]."""
        edge = self.corner[:, SECOND] - self.corner[:, FIRST]
        return jnp.sqrt(dot(edge, edge))

    def rows(self, model: ModelView) -> int:
        return 6 * self.count + 3 * len(self.owner) + 3 * len(self.pinned)

    def gap(self, model: ModelView, r: Array) -> Array:
        """`(|d|^2 - L^2)/(2 L)` of the edges, distances of attached points from their positions and of bodies from pins
        [m]."""
        corners = r[self.body_nodes(model)]
        length = self.lengths()
        edge = corners[:, SECOND] - corners[:, FIRST]
        edges = (dot(edge, edge) - length**2) / (2.0 * length)
        seats = r[self.seats(model)] - jnp.sum(self._seat_shares()[..., None] * corners[self._owners], axis=1)
        pins = self.references(corners)[np.array(self.pinned, int)] - self.pin
        return jnp.concatenate([edges.ravel(), seats.ravel(), pins.ravel()])

    def gap_size(self, model: ModelView) -> Array:
        # A fraction of a body's size: it determines the energy error of a step. Of 1 m at least, since the rounding of
        # positions a kilometre away allows no finer tolerance.
        return self._per_row(0.1 * jnp.maximum(jnp.max(self.lengths(), axis=1), 1.0))

    def force_size(self, model: ModelView) -> Array:
        return self._per_row(GRAVITY * self.mass)

    def _per_row(self, per_body: Array) -> Array:
        """A value of each body at its gaps (rows,)."""
        others = np.array([*self.owner, *self.pinned], int)
        return jnp.concatenate([jnp.repeat(per_body, 6), jnp.repeat(per_body[others], 3)])

    def mass_matrix(self) -> Array:
        """M_ij (bodies, 4, 4) [kg], without the mass carried by the attached points."""
        if self.matrix is not None:
            return self.matrix
        trace = self.moments[:, 0] + self.moments[:, 1] + self.moments[:, 2]
        second = 0.5 * trace[:, None, None] * jnp.eye(3, dtype=trace.dtype) - self.moments[:, MOMENT_INDEX]
        homogeneous = jnp.concatenate([self.centre_of_mass, jnp.ones_like(self.mass)[:, None]], axis=1)
        moments = self.mass[:, None, None] * homogeneous[:, :, None] * homogeneous[:, None, :]
        moments = moments + jnp.pad(second, ((0, 0), (0, 1), (0, 1)))
        total = jnp.einsum("bji,bjk,bkl->bil", self.affine, moments, self.affine)
        own = self._seat_shares()
        carried = self._carried_mass()[:, None, None] * own[:, :, None] * own[:, None, :]
        return total - scatter_add(self._owners, carried, self.count)

    def with_known_mass(self) -> RigidBodies:
        """The same bodies with their mass matrix computed."""
        return replace(self, matrix=self.mass_matrix())

    def _carried_mass(self) -> Array:
        return NODE_SHARE * self.mass[self._owners]

    def point_mass(self, model: ModelView) -> Array:
        own = jnp.diagonal(self.mass_matrix(), axis1=1, axis2=2).ravel()
        mass = jnp.concatenate([own, self._carried_mass()])
        return scatter_add(self._nodes_and_bodies(model)[0], mass, model.free_nodes)

    def coupled(self, model: ModelView, a: Array) -> Array:
        corners = self.body_nodes(model)
        between = self.mass_matrix() * (1.0 - np.eye(4))
        force = jnp.sum(between[..., None] * a[corners][:, None, :, :], axis=2)
        return scatter_add(corners.ravel(), force.reshape(-1, 3), model.free_nodes)

    def node_size(self, model: ModelView) -> Array:
        nodes, bodies = self._nodes_and_bodies(model)
        return scatter_add(nodes, (GAP_SHARE * jnp.max(self.lengths(), axis=1))[bodies], model.free_nodes)

    def _weights(self) -> Array:
        """Weight on each corner (4 bodies,) [N]."""
        return (self.gravity * self.mass[:, None] * shares(self.affine, self.centre_of_mass)).ravel()

    def force(self, k: Kinematics) -> Array:
        return scatter_add(self.body_nodes(k.model).ravel(), upright(-self._weights()), k.free)

    def potential(self, k: Kinematics) -> Array:
        return jnp.sum(self._weights() * k.r[self.body_nodes(k.model).ravel(), 2])


def shares(affine: Array, s: Array) -> Array:
    """Weights (..., 4) of positions s (..., 3) in a body's axes."""
    return jnp.sum(s[..., :, None] * affine[..., :3, :], axis=-2) + affine[..., 3, :]


def tetrahedron(mass: float, centre: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Corners (4, 3) [m] on which four equal masses have this mass, centre of mass and inertia (3, 3) about it.

    With the principal second moments `E_i = (I_j + I_k - I_i)/2` the corners are at `sqrt(E_i/m)` along the principal
    axes, signs (+ + +), (+ - -), (- + -), (- - +). For a thin body they are kept from lying in a plane.
    """
    value, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    reach = np.sqrt(np.maximum(value, 0.0) / mass)
    reach = np.maximum(reach, 0.1 * np.max(reach))
    signs = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    return centre + (signs * reach) @ axes.T
