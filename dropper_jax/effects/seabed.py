"""The seabed: a spring and damper under every node, along the normal of a flat seabed or of a grid of depths."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.fields import component, parameter
from dropper_jax.base.numerics import cross, dot, trace_once
from dropper_jax.base.read import Values, plain, refuse, rises
from dropper_jax.base.springs import REST_DEPTH, limit_damper, mean_positive_part, unresolved_force
from dropper_jax.model import ContactArea, Effect, Kinematics
from dropper_jax.scene import SceneData

#: Part of a cell, on either side of a grid line, over which one slope of the seabed blends into the next.
ROUNDED_SHARE = 0.02


@component
class Seabed(Effect):
    """Contact force `N = A (k p + clip(c p', -k p, k p))` along the normal of the seabed, p the depth of a node in it.

    `A = D L` is the plan area of the node's halves of its links, as in MoorDyn; p is measured along the normal and is 0
    above the seabed. As in a rope the damper force never exceeds the spring force. The contact force is therefore
    continuous at touchdown, never sticks, and only takes energy. Over a step the spring is treated as in `springs`. If
    `bed_x`, `bed_y` and `bed_depth` are given, the seabed is that grid, bilinear between the points, with rounded
    creases: at the bottom of a sharp crease the force of one side alone would let no node rest.
    """

    name = "seabed"
    stiffness: Array = parameter("contact stiffness", unit="Pa/m", above=0.0, default=3e6)
    damping: Array = parameter("contact damping", unit="Pa s/m", low=0.0, default=3e5)
    depth: Array = parameter("depth of a flat bed", unit="m", above=0.0, default=None)
    bed_x: Array | None = parameter("x of the depth grid", unit="m", shape="table", default=None)
    bed_y: Array | None = parameter("y of the depth grid", unit="m", shape="table", default=None)
    bed_depth: Array | None = parameter(
        "depths of the grid, ordered by x (all y of the first x first)", unit="m", shape="table", default=None
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        grid = [values[key] for key in ("bed_x", "bed_y", "bed_depth") if values[key] is not None]
        if len(grid) in (1, 2):
            raise SceneError("effects.seabed: `bed_x`, `bed_y` and `bed_depth` belong together, one of them is missing")
        if grid and values["depth"] is not None:
            allowed = "`depth`, or `bed_x`, `bed_y` and `bed_depth`"
            raise refuse("effects.seabed.depth", plain(values["depth"]), "cannot be combined with a grid", allowed)
        if grid:
            x, y, depth = map(len, grid)
            if depth != x * y:
                raise SceneError(
                    f"effects.seabed.bed_depth: has {depth} entries; allowed: {x * y}, one for each x and y"
                )
            for key in ("bed_x", "bed_y"):
                if not rises(values[key], 2):
                    raise SceneError(f"effects.seabed.{key}: needs at least 2 increasing numbers")
        elif values["depth"] is None and scene.sea is None:
            raise SceneError("effects.seabed.depth: missing; needed: the depth of the seabed, or a [sea] with `depth`")
        if any(line.diameter is None for line in scene.lines):
            raise SceneError("line.diameter: missing; effects.seabed needs the diameter of every line [m]")

    @classmethod
    def build(cls, values: Values, scene: SceneData) -> Seabed:
        values = dict(values)
        if values["depth"] is None and values["bed_x"] is None:
            values["depth"] = scene.needed_sea.depth
        return cls(**values)

    def bed_height(self, r: Array, rounded: float = ROUNDED_SHARE) -> Array:
        """Height z of the seabed (nodes,) [m] at positions r (nodes, 3); with `rounded` = 0 its creases are sharp."""
        if self.bed_x is None or self.bed_y is None or self.bed_depth is None:
            return -self.depth * jnp.ones_like(r[:, 2])
        grid = self.bed_depth.reshape(self.bed_x.shape[0], self.bed_y.shape[0])
        i, a = _shares(self.bed_x, r[:, 0], rounded)
        j, b = _shares(self.bed_y, r[:, 1], rounded)
        return -jnp.sum(a[:, None] * b * grid[i[:, None], j], axis=(0, 1))

    def upward(self, r: Array) -> Array:
        """Unit normals (nodes, 3) of the seabed at positions r (nodes, 3), or (3,) of a flat one."""
        if self.bed_x is None:
            return jnp.array([0.0, 0.0, 1.0], r.dtype)
        along = jnp.eye(3, dtype=r.dtype)

        def slope(axis: int) -> Array:
            return jax.jvp(self.bed_height, (r,), (jnp.broadcast_to(along[axis], r.shape),))[1]

        x = slope(0)
        n = jnp.stack([-x, -slope(1), jnp.ones_like(x)], axis=-1)
        return n / jnp.sqrt(dot(n, n))[:, None]

    def tangents(self, r: Array) -> tuple[Array, Array]:
        """Two orthogonal unit vectors (nodes, 3) along the seabed; (3,) of a flat one."""
        n = self.upward(r)
        first = jnp.stack([n[..., 2], jnp.zeros_like(n[..., 2]), -n[..., 0]], axis=-1)
        first = first / jnp.sqrt(dot(first, first))[..., None]
        return first, cross(n, first)

    def prepare(self, k: Kinematics) -> Array:
        """Downward speed of nodes at the start of the step (nodes,) [m/s]; k has the velocities of that time."""
        return -dot(k.v, self.upward(k.r))

    def normal(self, k: Kinematics) -> Array:
        """Contact force (nodes,) [N], never negative."""
        area = k.line.node_share(k.line.needed_diameter * k.line.length)
        for effect in k.model.effects_with(ContactArea):
            area = area + effect.contact_area(k.model)
        n = self.upward(k.r)
        return area * self.pressure(k, self, (self.bed_height(k.r) - k.r[:, 2]) * n[..., 2], -dot(k.v, n))

    def pressure(self, k: Kinematics, effect: Effect, deep: Array, down: Array) -> Array:
        """Contact force per area (points,) [Pa] of points `deep` [m] below the seabed that sink at `down` [m/s].

        `effect` has prepared their downward speed at the start of the step.
        """
        if k.h is None:
            spring = self.stiffness * jnp.maximum(deep, 0.0)
            rate = down
        else:
            before = deep - 0.5 * k.h * down
            after = deep + 0.5 * k.h * down
            pressed_before = jnp.maximum(before, 0.0)
            pressed_after = jnp.maximum(after, 0.0)
            expected = jnp.maximum(before + k.h * k.prepared(effect), 0.0)
            mean = mean_positive_part(before, after) + unresolved_force(
                pressed_before, pressed_after, expected, REST_DEPTH
            )
            spring = jnp.maximum(self.stiffness * mean, 0.0)
            rate = (pressed_after - pressed_before) / k.h
        return spring + limit_damper(self.damping * rate, spring)

    def force(self, k: Kinematics) -> Array:
        return self.normal(k)[:, None] * self.upward(k.r)


@trace_once
def _shares(knots: Array, x: Array, rounded: float) -> tuple[Array, Array]:
    """Three knots around each x and their weights, each (3, n): linear between, rounded at knots, level outside."""
    last = knots.shape[0] - 1
    i = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, last - 1)
    near = jnp.where(2.0 * x > knots[i] + knots[i + 1], i + 1, i)
    before = jnp.maximum(near - 1, 0)
    after = jnp.minimum(near + 1, last)
    left = knots[near] - knots[before]
    right = knots[after] - knots[near]
    width = rounded * jnp.minimum(left, right)  # no rounding at the edges
    one = jnp.ones_like(width)
    up = _ramp(x - knots[near], width) / jnp.where(right > 0.0, right, one)
    down = _ramp(knots[near] - x, width) / jnp.where(left > 0.0, left, one)
    return jnp.stack([before, near, after]), jnp.stack([down, 1.0 - up - down, up])


def _ramp(x: Array, width: Array) -> Array:
    """`max(x, 0)`, replaced by a parabola within `width` of the corner."""
    inside = jnp.abs(x) < width
    return jnp.where(inside, (x + width) ** 2 / jnp.where(inside, 4.0 * width, 1.0), jnp.maximum(x, 0.0))
