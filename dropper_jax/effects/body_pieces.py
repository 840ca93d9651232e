"""Cylinders, slices of them and spheres of rigid bodies, as weighted combinations of their bodies' corners."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.fields import component, option
from dropper_jax.base.indexed_sums import scatter_add
from dropper_jax.base.numerics import upright
from dropper_jax.effects.hydrostatics import Cylinders, sphere_energy, sphere_volume
from dropper_jax.model import ModelView


@component
class Pieces:
    """Cylinders, or slices of them, and spheres of rigid bodies, each a weighted combination of its body's corners.

    Attributes:
        ends: weights of the ends of the axes (c, 2, 4); spheres: of the centres (s, 4).
        radius, length: of the cylinders (c,) [m]; ball: radii of the spheres (s,) [m].
        first: index of the first corner among the points; cylinder_of, sphere_of: their bodies.
    """

    ends: Array
    spheres: Array
    radius: Array
    length: Array
    ball: Array
    first: int = option("number of the first corner among the points", type=int, default=0)
    cylinder_of: tuple[int, ...] = option("body of each cylinder", type=tuple, default=())
    sphere_of: tuple[int, ...] = option("body of each sphere", type=tuple, default=())

    @property
    def owners(self) -> np.ndarray:
        """Body of each piece (c + s,)."""
        return np.array([*self.cylinder_of, *self.sphere_of], int)

    @property
    def piece_of_point(self) -> np.ndarray:
        """Piece of each point (2 c + s,): the first ends of the axes, their last ends, and the spheres' centres."""
        count = len(self.cylinder_of)
        return np.concatenate([np.arange(count), np.arange(count + len(self.sphere_of))])

    @property
    def point_weights(self) -> Array:
        """Weights (2 c + s, 4) of these points."""
        return jnp.concatenate([self.ends[:, 0], self.ends[:, 1], self.spheres])

    def body_nodes(self, model: ModelView, of: np.ndarray) -> np.ndarray:
        """Free nodes (items, 4) at the corners of bodies."""
        return model.geometry.point_node[self.first + 4 * of[:, None] + np.arange(4)]

    def _point_corners(self, model: ModelView) -> np.ndarray:
        """Free nodes (2 c + s, 4) at the corners of the bodies of the points."""
        return self.body_nodes(model, self.owners[self.piece_of_point])

    def points(self, model: ModelView, nodal: Array) -> Array:
        """A nodal field (free, 3) at the points (2 c + s, 3)."""
        return mix_corners(self.point_weights, nodal[self._point_corners(model)])

    def axes(self, model: ModelView, nodal: Array) -> Array:
        """A nodal field at the ends of the axes (c, 2, 3)."""
        corners = self.body_nodes(model, np.array(self.cylinder_of, int))
        return mix_corners(self.ends, nodal[corners][:, None])

    def centres(self, model: ModelView, nodal: Array) -> Array:
        """A nodal field at the spheres' centres (s, 3)."""
        return mix_corners(self.spheres, nodal[self.body_nodes(model, np.array(self.sphere_of, int))])

    def energy(self, model: ModelView, r: Array, level: Array) -> Array:
        """Energy divided by rho g of the displaced water under a surface at `level` (c + s,) [m] over the pieces, a
        scalar [m^4]."""
        balls = sphere_energy(self.centres(model, r), level[len(self.cylinder_of) :], self.ball)
        return jnp.sum(self._cylinders(model, r, level).energy()) + jnp.sum(balls)

    def wet(self, model: ModelView, r: Array, level: Array) -> Array:
        """Submerged volumes (c + s,) [m^3]."""
        return jnp.concatenate([self._cylinders(model, r, level).volume(), self._wet_balls(model, r, level)])

    def push(self, model: ModelView, r: Array, level: Array) -> Array:
        """Buoyancy divided by rho g on the free nodes (free, 3) [m^3]: minus the gradient of the energy."""
        ends = self._cylinders(model, r, level).push()
        lift = jnp.concatenate([ends[:, 0], ends[:, 1], upright(self._wet_balls(model, r, level))])
        return scatter_to_corners(self._point_corners(model), self.point_weights, lift, model.free_nodes)

    def _cylinders(self, model: ModelView, r: Array, level: Array) -> Cylinders:
        """The cylinders relative to the surface."""
        return Cylinders.of(self.axes(model, r), level[: len(self.cylinder_of)], self.radius, self.length)

    def _wet_balls(self, model: ModelView, r: Array, level: Array) -> Array:
        """Submerged volumes of the spheres (s,) [m^3]."""
        return sphere_volume(self.centres(model, r), level[len(self.cylinder_of) :], self.ball)

    def middles(self, model: ModelView, nodal: Array) -> Array:
        """A nodal field at the centres of the cylinders' axes and of the spheres (c + s, 3)."""
        axes = self.axes(model, nodal)
        return jnp.concatenate([0.5 * (axes[:, 0] + axes[:, 1]), self.centres(model, nodal)])

    def spread(self, model: ModelView, force: Array) -> Array:
        """Forces (c + s, 3) [N] at the centres, distributed to the free nodes (free, 3)."""
        weights = jnp.concatenate([0.5 * (self.ends[:, 0] + self.ends[:, 1]), self.spheres])
        return scatter_to_corners(self.body_nodes(model, self.owners), weights, force, model.free_nodes)


def mix_corners(weights: Array, corners: Array) -> Array:
    """Combinations (..., 3) of corners (..., 4, 3) with weights (..., 4)."""
    return jnp.sum(weights[..., None] * corners, axis=-2)


def scatter_to_corners(corners: np.ndarray, weights: Array, force: Array, free: int) -> Array:
    """Forces (items, 3) on the free nodes (free, 3): each on its body's corners with its weights (items, 4)."""
    return scatter_add(corners.ravel(), (weights[:, :, None] * force[:, None, :]).reshape(-1, 3), free)
