"""Observation of a motion by camera, markers and clock: rotated angles and missing frames.

Markers have offsets from the parts that they mark. The marker of a link is rotated relative to it, which adds to
its angle. The marker of a node at p_i is seen at p_i + e_i and affects two links. With d_j = p_{j+1} - p_j, u_j its
direction and n_j across it (towards larger angles), link j is seen rotated by

    atan2(n_j . x_j, L_j + u_j . x_j),      x_j = e_{j+1} - e_j.

The marker of a node between links is glued to the link that ends there, e_i = a u_{i-1} + b n_{i-1}. At a fixed end
it is constant, e_i = (a, b) in x and z. At a free end it rotates the last link alone, as the marker of that link
does.

During frames that are missing without a mark the motion continues while the traces' clock stops. After such a frame
the motion is `lost` later than the clock reads, in addition to the effect of a wrong rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Model
from fitting.parameters.parameter import Parameter
from fitting.parameters.targets import DOWN, CameraTarget, ClockTarget, LostTarget, NodeMarkerTarget, RecordingTarget
from fitting.traces.planar import directions, wrap


def camera_angles(model: Model, parameters: Sequence[Parameter], values: Array, theta: Array) -> Array:
    """Angles (..., n) seen by the camera for links at theta (..., n) [rad]; differentiable."""
    turned = theta + node_markers(model, parameters, values, theta)
    return turned + camera_offset(parameters, values, theta.shape[-1])


def camera_offset(parameters: Sequence[Parameter], values: Array, links: int) -> Array | float:
    """Rotation of the camera and of the links' markers, for each link (n,) [rad]; 0 if none is free."""
    total: Array | float = 0.0
    for i, p in enumerate(parameters):
        if isinstance(p.where, CameraTarget):
            share = np.ones(links)
            if p.where.link is not None:
                share = np.eye(links)[p.where.link]
            total = total + values[i] * share
    return total


def node_markers(model: Model, parameters: Sequence[Parameter], values: Array, theta: Array) -> Array | float:
    """Rotation of each link by the markers of nodes (..., n) [rad]; 0 if none is free."""
    mine = [(i, p.where) for i, p in enumerate(parameters) if isinstance(p.where, NodeMarkerTarget)]
    if not mine:
        return 0.0
    along, across = directions(theta)
    links = theta.shape[-1]
    moved = jnp.zeros((*theta.shape[:-1], links + 1, 2))
    for i, where in mine:
        direction = (along, across)[where.axis][..., where.node - 1, :]
        if where.node in (0, links):
            direction = jnp.asarray(np.eye(2)[where.axis])
        here = np.eye(links + 1)[where.node]
        moved = moved + values[i] * direction[..., None, :] * here[:, None]
    apart = moved[..., 1:, :] - moved[..., :-1, :]
    return jnp.arctan2(jnp.sum(across * apart, -1), model.line.length + jnp.sum(along * apart, -1))


class Recording(NamedTuple):
    """How a recording reads angles: `zeros + scale theta(t - delay)`, theta from straight down.

    Attributes:
        zeros: of the links (n,) [rad].
        scale: [-].
        delay: of the aligned stamps [s].
    """

    zeros: Array
    scale: Array | float
    delay: Array | float

    def read(self, theta: Array, measured: Array) -> Array:
        """Readings of angles (..., n) from the horizontal [rad], with the whole turns of the measured ones."""
        turned = measured + wrap(theta - measured)
        return DOWN + self.zeros + self.scale * (turned - DOWN)


def recording(parameters: Sequence[Parameter], values: Array, number: int, links: int) -> Recording:
    """Recording `number` at these values; differentiable."""
    found = Recording(jnp.zeros(links), 1.0, 0.0)
    for i, p in enumerate(parameters):
        where = p.where
        if not isinstance(where, RecordingTarget) or where.recording != number:
            continue
        if where.field == "zero":
            zero = values[i] - where.applied
            found = found._replace(zeros=jnp.where(np.arange(links) == where.link, zero, found.zeros))
        else:
            found = found._replace(**{where.field: values[i] - where.applied})
    return found


def clock_rate(parameters: Sequence[Parameter], values: Array) -> Array | None:
    """Time of the motion per time of the traces' clock, scalar [s/s]; None if it is not free."""
    return next((values[i] for i, p in enumerate(parameters) if isinstance(p.where, ClockTarget)), None)


def lost_frames(parameters: Sequence[Parameter]) -> dict[int, LostTarget]:
    """The parameters that are times of lost frames, by their numbers in order."""
    return {i: p.where for i, p in enumerate(parameters) if isinstance(p.where, LostTarget)}
