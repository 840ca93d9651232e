"""Positions and velocities of a line at one instant, and what follows from them, computed only when asked."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp

if TYPE_CHECKING:
    from dropper_jax.model import Line, Model
    from dropper_jax.sea import Water


class Ends(NamedTuple):
    """Held ends of a line: positions and velocities, (3,) [m], [m/s]; `end` is None where the end is free."""

    start: jax.Array
    end: jax.Array | None
    start_velocity: jax.Array | None = None
    end_velocity: jax.Array | None = None


def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """Scalar products of 3-vectors (..., 3).

    Written out: on the CPU a sum over an axis of three is a kernel of its own, three products fuse with their users.
    """
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """Vector products of 3-vectors (..., 3), written out for the same reason (and half the operations of jnp's)."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    z = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return jnp.stack([x, y, z], axis=-1)


def safe_norm(x: jax.Array, floor: float = 1e-30) -> jax.Array:
    """|x| of 3-vectors (..., 3), with finite derivatives at zero (the floor is 1e-15 in |x|)."""
    return jnp.sqrt(dot(x, x) + jnp.asarray(floor, x.dtype))


def stack_nodes(free: jax.Array, start: jax.Array, end: jax.Array | None) -> jax.Array:
    """All nodes of a line (n + 1, 3) from its free nodes and held ends."""
    rows = [start[None], free] if end is None else [start[None], free, end[None]]
    return jnp.concatenate(rows)


def link_differences(free: jax.Array, start: jax.Array | None, end: jax.Array | None, held: bool) -> jax.Array:
    """Differences over the links (n, ...) of a nodal field; a held end without a value counts as zero."""
    zero = jnp.zeros_like(free[:1])
    head = zero if start is None else start[None]
    if not held:
        return free - jnp.concatenate([head, free[:-1]])
    tail = zero if end is None else end[None]
    return jnp.concatenate([free, tail]) - jnp.concatenate([head, free])


def gather_links(pull: jax.Array, held: bool) -> jax.Array:
    """Sum on the free nodes (nodes, ...) of what links pull (n, ...): + on their first node, - on their last."""
    if held:
        return pull[1:] - pull[:-1]
    return jnp.concatenate([pull[1:], jnp.zeros_like(pull[:1])]) - pull


class Kinematics:
    """One instant of a line, as effects see it.

    Attributes:
        model, line: what moves.
        r, v: free nodes (nodes, 3) [m], [m/s].
        t: time [s].
        free: number of free nodes.
        h: the step [s] of which this is the middle; None at a plain instant.
    """

    def __init__(
        self,
        model: Model,
        r: jax.Array,
        v: jax.Array,
        t: jax.Array,
        ends: Ends,
        prepared: dict[str, Any] | None = None,
        h: jax.Array | None = None,
    ):
        self.model, self.r, self.v, self.t, self.ends, self.h = model, r, v, t, ends, h
        self._prepared = prepared or {}

    @property
    def line(self) -> Line:
        return self.model.line

    @property
    def free(self) -> int:
        return self.r.shape[0]

    def with_velocity(self, v: jax.Array) -> Kinematics:
        """The same places with other velocities of the free nodes."""
        return Kinematics(self.model, self.r, v, self.t, self.ends, self._prepared, self.h)

    def prepared(self, effect: Any) -> Any:
        """What the effect's `prepare` returned for this step."""
        return self._prepared[effect.name]

    @property
    def water(self) -> Water:
        """The water around the free nodes, frozen over the step (see `dropper_jax.sea`)."""
        return self._prepared["water"]

    @cached_property
    def nodes(self) -> jax.Array:
        """All nodes (n + 1, 3) [m]."""
        return self.model.nodes(self.r, self.ends)

    @cached_property
    def links(self) -> jax.Array:
        """Link vectors (n, 3) [m]."""
        return self.model.differences(self.r, self.ends)

    @cached_property
    def link_velocities(self) -> jax.Array:
        """Rates of the link vectors (n, 3) [m/s]."""
        return self.model.differences(self.v, self.ends, rates=True)

    @cached_property
    def tangents(self) -> jax.Array:
        """Unit vectors along the links (n, 3)."""
        return self.links / safe_norm(self.links)[:, None]

    @cached_property
    def angular_rates(self) -> jax.Array:
        """Angular velocity of each link, without spin (n, 3) [rad/s]: `q x q'`."""
        return cross(self.tangents, self.link_velocities) / safe_norm(self.links)[:, None]
