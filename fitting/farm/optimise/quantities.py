"""Quantities of a storm: peaks of signals, each relative to its limit, as hard and as soft maxima.

    soft = s log int exp(x/s) dt / 1 s,    s = PEAK_WIDTH times a fixed height

A signal is positive and reaches 1 at its limit: load times factor over capacity, the minimum distance over a distance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError
from dropper_jax.base.numerics import horizontal_norm, safe_norm
from dropper_jax.base.records import names_of
from dropper_jax.model import Model
from dropper_jax.quantities.end_links import load_on_fixed_point
from dropper_jax.quantities.quantities import Quantity
from dropper_jax.quantities.quantity_names import quantity
from fitting.farm.site import Anchor, Part

#: Width of soft peaks over their height: they exceed the hard ones by 2 to 6 %, which a factor compensates.
PEAK_WIDTH = 0.01


class Steps(NamedTuple):
    """Free nodes (k, nodes, 3) [m] and tensions (k, n) [N] after steps, and the time that each step counts (k,) [s]."""

    r: Array
    tension: Array
    time: Array


@dataclass(frozen=True)
class LimitedSignal(ABC):
    """A signal over time with a peak; `name` in tables, static."""

    name: str

    #: Whether its value at an instant needs no others.
    is_instant: ClassVar[bool] = True

    @abstractmethod
    def signal(self, model: Model, steps: Steps) -> Array:
        """Values (k, m) of k steps."""

    def soft(self, model: Model, steps: Steps, height: Array) -> Array:
        """The soft peak for hard ones of about `height`, which is fixed; differentiable."""
        width = PEAK_WIDTH * height
        return width * jax.scipy.special.logsumexp(self.signal(model, steps) / width, b=steps.time[:, None])


@dataclass(frozen=True)
class Load(LimitedSignal):
    """Tension times `scale` of some links; with factor over capacity as scale their utilisation."""

    links: tuple[int, ...]
    scale: tuple[float, ...]

    def signal(self, model: Model, steps: Steps) -> Array:
        return jnp.maximum(steps.tension[:, np.array(self.links)], 0.0) * np.array(self.scale)


@dataclass(frozen=True)
class AnchorLoad(LimitedSignal):
    """Utilisation of an anchor, as in `dropper_jax.scene.anchor.AnchorSpec.utilisation`, times the factor.

    Attributes:
        links: those that end at its point; signs: 1 for links that start there, -1 for links that end there.
        across, up: factor over the horizontal and the upward capacity [1/N].
        any_direction: whether they are one capacity for a load in any direction.
        uplift: tangent of the maximum angle of the load; None for the load itself.
    """

    links: tuple[int, ...]
    signs: tuple[float, ...]
    across: float
    up: float
    any_direction: bool
    uplift: float | None = None

    def signal(self, model: Model, steps: Steps) -> Array:
        start = jnp.zeros((), steps.r.dtype)

        def load(r: Array, tension: Array) -> Array:
            return load_on_fixed_point(model, self.links, self.signs, r, tension, start)

        force = jax.vmap(load)(steps.r, jnp.maximum(steps.tension, 0.0))
        horizontal = horizontal_norm(force)[:, None]
        upward = force[:, 2:]
        if self.uplift is not None:
            # V <= H tan(a), as a number that is positive and reaches 1 there
            return 1.0 + (upward - self.uplift * horizontal) * self.up
        across = self.across * horizontal
        rising = self.up * jnp.maximum(upward, 0.0)
        if self.any_direction:
            return safe_norm(jnp.concatenate([across, jnp.zeros_like(across), rising], axis=1))[:, None]
        return across + rising


#: Distance of two nodes over the required one below which the signal no longer grows: it stays finite if nodes meet.
CLOSEST_SHARE = 1e-3


@dataclass(frozen=True)
class Clearance(LimitedSignal):
    """Ratio of the required distance [m] to that of pairs of free nodes."""

    pairs: tuple[tuple[int, int], ...]
    required_distance: float

    def signal(self, model: Model, steps: Steps) -> Array:
        one, other = np.array(self.pairs).T
        distance = safe_norm(steps.r[:, one] - steps.r[:, other])
        return self.required_distance / jnp.maximum(distance, CLOSEST_SHARE * self.required_distance)


@dataclass(frozen=True)
class NodeDisplacement(LimitedSignal):
    """Displacement of nodes from their mean position [m], times `scale`."""

    nodes: tuple[int, ...]
    scale: float = 1.0

    is_instant = False

    def signal(self, model: Model, steps: Steps) -> Array:
        own = steps.r[:, np.array(self.nodes)]
        mean = jnp.tensordot(steps.time, own, axes=1) / jnp.sum(steps.time)
        return self.scale * safe_norm(own - mean)


@dataclass(frozen=True)
class NamedQuantity(LimitedSignal):
    """The maximum of a quantity by name, times `scale`."""

    of: Quantity
    scale: float

    def signal(self, model: Model, steps: Steps) -> Array:
        now = jnp.zeros((), steps.r.dtype)
        found = jax.vmap(lambda r, tension: self.of.instant(model, r, r, r, tension, now))(steps.r, steps.tension)
        return self.scale * found


#: Signals of `NamedQuantity`: positive ones that positions and tensions determine.
LIMITED = ("tension", "anchor", "offset")


def named_quantity(name: str, model: Model, option: str, limit: float) -> NamedQuantity:
    """The quantity of a name such as `tension.west-leg.fairlead.max`, relative to its limit.

    Raises:
        SceneError: an unknown name, or one without a limit in storms.
    """
    found = quantity(name, model, option)
    if found.signal not in LIMITED or found.statistic != "max":
        raise SceneError(f"{option}: {name!r} cannot be limited; allowed: maxima of {', '.join(LIMITED)}")
    return NamedQuantity(name, found, 1.0 / limit)


def line_nodes(model: Model, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Numbers of the free nodes of each line, including free ends."""
    graph = model.geometry
    found = {}
    for name, own in graph.line_links(names).items():
        ends = dict.fromkeys([*graph.first[own], *graph.last[own]])
        found[name] = np.array([i for i in ends if i < graph.free], int)
    return found


def part_load(model: Model, part: Part, kind: str) -> Load:
    """Utilisation of a part: load times factor over capacity, the worst of its links.

    Args:
        kind: of load case that selects the factor, `intact` or `broken`.
    """
    links = model.geometry.line_links(part.lines)
    counts = [len(links[name]) for name in part.lines]
    scale = np.repeat(part.factors.by_kind[kind] / part.capacity, counts)
    every = np.concatenate([links[name] for name in part.lines])
    return Load(part.name, tuple(every.tolist()), tuple(scale.tolist()))


def anchor_loads(model: Model, anchor: Anchor, kind: str) -> list[AnchorLoad]:
    """Utilisation of each of its points and, with a limit of the angle, that of the angle.

    Args:
        kind: of load case that selects the factor, `intact` or `broken`.
    """
    found = []
    graph = model.geometry
    factor = anchor.factor[kind]
    horizontal, upward, any_direction = anchor.table.capacities
    names = names_of(model.points)
    for name in anchor.points:
        node = graph.point_node[names.index(name)]
        first = np.flatnonzero(graph.first == node).tolist()
        last = np.flatnonzero(graph.last == node).tolist()
        signs = (1.0,) * len(first) + (-1.0,) * len(last)
        load = AnchorLoad(name, (*first, *last), signs, factor / horizontal, factor / upward, any_direction)
        found.append(load)
        if anchor.table.uplift is not None:
            tangent = float(np.tan(np.radians(anchor.table.uplift)))
            found.append(replace(load, name=f"{name} uplift", uplift=tangent))
    return found
