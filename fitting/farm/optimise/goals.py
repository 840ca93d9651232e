"""Objective and constraints of a design: what is minimised, and the quantities that have limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import groupby, pairwise, product
from typing import NamedTuple

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.base.records import names_of
from dropper_jax.load.scene import Scene
from dropper_jax.model import Model
from fitting.farm.optimise.quantities import (
    Clearance,
    LimitedSignal,
    NodeDisplacement,
    anchor_loads,
    line_nodes,
    named_quantity,
    part_load,
)
from fitting.farm.site import Site


@dataclass(frozen=True)
class Objective:
    """`[objective]`: the quantity to minimise."""

    of: str
    price: tuple[tuple[str, float], ...] = ()
    float_price: float = 1.0
    part: str = ""
    lines: tuple[str, ...] = ()

    def material(self, scene: Scene) -> float:
        """Kilograms times price of lines and floats."""
        total = 0.0
        for line in scene.lines:
            name = line.piece_of or line.name
            price = next((p for pattern, p in self.price if fnmatchcase(name, pattern)), 1.0)
            total += price * np.sum(line.mass)
        floats = (p for p in scene.points if p.is_free and p.volume)
        return total + self.float_price * sum(float(p.mass or 0.0) for p in floats)


class DepthUtilisation(NamedTuple):
    """Name of a bound, its utilisation (1 at the bound), and the derivative of this by the variables (p,)."""

    name: str
    value: float
    slope: np.ndarray


@dataclass(frozen=True)
class DepthRange:
    """Range of depths for nodes at rest [m] below the water's level."""

    name: str
    points: tuple[str, ...]
    lines: tuple[str, ...]
    shallowest: float | None
    deepest: float | None

    def nodes(self, model: Model) -> np.ndarray:
        """Numbers of the free nodes that it applies to."""
        names = names_of(model.points)
        point_nodes = [model.geometry.point_node[names.index(name)] for name in self.points]
        return np.concatenate([point_nodes, *line_nodes(model, self.lines).values()]).astype(int)

    def utilisations(self, model: Model, r: np.ndarray, dr: np.ndarray, level: float) -> list[DepthUtilisation]:
        """Each bound at the worst node."""
        nodes = self.nodes(model)
        depth = level - r[nodes, 2]
        found = []
        unit = abs(self.deepest or self.shallowest or 1.0)
        for key, bound, sign in (("shallowest", self.shallowest, 1.0), ("deepest", self.deepest, -1.0)):
            if bound is None:
                continue
            worst = np.argmin(sign * depth)
            value = 1.0 + sign * (bound - depth[worst]) / unit
            slope = sign * dr[:, nodes[worst], 2] / unit
            found.append(DepthUtilisation(f"{self.name} {key}", value, slope))
        return found


def check_depths(depths: Sequence[DepthRange], model: Model) -> None:
    """Reject bounds that no pose meets: one requires a node to be deeper than another one allows.

    Raises:
        SceneError: with both of them.
    """
    own = [(depth, set(depth.nodes(model).tolist())) for depth in depths]
    for one, nodes in own:
        for other, others in own:
            if one.shallowest is None or other.deepest is None or not nodes & others:
                continue
            if one.shallowest > other.deepest:
                raise SceneError(
                    f"constraint: {one.name} shallowest of {one.shallowest:g} m contradicts {other.name} deepest of "
                    f"{other.deepest:g} m on the same nodes; allowed: at most {other.deepest:g} m"
                )


@dataclass(frozen=True)
class StormLimit:
    """A constraint on storms: its kind and path, the lines or the quantity that it applies to, and its limit."""

    kind: str
    path: str
    of: tuple[str, ...] | str
    limit: float

    def quantity(self, model: Model, number: int) -> LimitedSignal:
        """The quantity with a limit of 1; `number` counts constraints of this kind from 1."""
        if isinstance(self.of, str):
            return named_quantity(self.of, model, self.path, self.limit)
        if self.kind == "clearance":
            return Clearance(f"clearance {number}", _pairs(model, self.of, self.path), self.limit)
        return NodeDisplacement(f"motion {number}", _nodes(model, self.of), 1.0 / self.limit)


@dataclass(frozen=True)
class Goals:
    """Objective and constraints, read; those on storms by kind."""

    objective: Objective
    depths: tuple[DepthRange, ...]
    limits: tuple[StormLimit, ...]

    def quantities(self, site: Site, model: Model, kind: str = "intact") -> tuple[LimitedSignal, ...]:
        """The quantities of storms: all with a limit of 1, and the objective last if it depends on storms.

        If a line breaks (`kind` "broken") these are the loads of parts and anchors, with their own factors.
        """
        found: list[LimitedSignal] = [part_load(model, part, kind) for part in site.parts]
        found += [quantity for anchor in site.anchors for quantity in anchor_loads(model, anchor, kind)]
        if kind != "intact":
            return tuple(found)
        for _, limits in groupby(self.limits, key=lambda limit: limit.kind):
            found += [limit.quantity(model, i) for i, limit in enumerate(limits, 1)]
        if self.objective.of == "motion":
            found.append(NodeDisplacement("largest motion", _nodes(model, self.objective.lines)))
        return tuple(found)


def _nodes(model: Model, lines: Sequence[str]) -> tuple[int, ...]:
    """Numbers of the free nodes of lines, each once."""
    return tuple(dict.fromkeys(np.concatenate(list(line_nodes(model, lines).values())).tolist()))


def _pairs(model: Model, lines: Sequence[str], path: str) -> tuple[tuple[int, int], ...]:
    """Nodes of each line with those of the next one, without shared nodes; ends only if a line has no inner ones.

    Raises:
        SceneError: two lines without such a pair.
    """
    nodes = line_nodes(model, lines)
    pairs: list[tuple[int, int]] = []
    for one, other in pairwise(nodes):
        first = _unshared_nodes(model, nodes[one], nodes[other])
        second = _unshared_nodes(model, nodes[other], nodes[one])
        if not (first and second):
            raise SceneError(f"{path}.lines: {one!r} and {other!r} have no free nodes of their own. Use more links")
        pairs += product(first, second)
    return tuple(pairs)


def _unshared_nodes(model: Model, nodes: np.ndarray, others: np.ndarray) -> list[int]:
    """The inner ones of a line's nodes; of a line of one link, its free ends that are not among `others`."""
    inner = nodes[nodes < model.geometry.inner]
    if len(inner):
        return inner.tolist()
    return nodes[~np.isin(nodes, others)].tolist()
