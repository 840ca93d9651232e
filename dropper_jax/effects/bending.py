"""Bending stiffness of lines."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.errors import SceneError, nearest
from dropper_jax.base.fields import component, option, parameter
from dropper_jax.base.numerics import dot
from dropper_jax.base.read import Pairs, Values
from dropper_jax.model import Effect, Kinematics, ModelView, at_pieces, sum_of_pieces
from dropper_jax.scene import SceneData

#: Length of a link over its unstretched length below which nothing resists its compression: the bending moment between
#: links without a direction has no value.
CRUSHED_LENGTH = 0.9


@component
class Bending(Effect):
    """Bending moment `EI kappa` at every joint inside a line; the curvature kappa is the change of direction per
    length.

    Energy `sum of EI/(2 l) |q_(j+1) - q_j|^2`, with q the link directions and l the mean length of two neighbouring
    links. The nodal forces are minus its gradient. Second order in the link length. Lines are pinned at their points
    except for `clamped` ones: there q_0 is the prescribed direction of the line, and l is half a link. Lines do not
    resist torsion here (see `torsion`). A broken link has no bending stiffness.

    Two lines of a pair in `joined` bend at their common point as within one line: clamped to each other, or with a
    swivel, since their twists are independent. Points without a pair are hinges.

    Moments and curvatures of a run: `Solution.bending_moment`, `Solution.curvature`.
    """

    name = "bending"
    reach = 2
    breaks_with_links = True
    EI: Array = parameter("bending stiffness", unit="N m^2", shape="link", low=0.0)
    directions: Array | None = parameter(
        "directions of lines at their clamped points", unit="-", shape="vectors", default=None
    )
    clamped: tuple[str, ...] = option("fixed points at which a line is clamped", type=list, default=())
    joined: tuple[tuple[str, str], ...] = option(
        "lines that bend across their common point as one", type=Pairs, default=()
    )

    @classmethod
    def check(cls, values: Values, scene: SceneData) -> None:
        if all(line.links < 2 for line in scene.lines) and not values["clamped"] and not values["joined"]:
            raise SceneError("effects.bending: needs a line of at least 2 links. Use more links, or remove the effect")
        _check_clamps(values, scene)
        _check_joints(values, scene)

    def potential(self, k: Kinematics) -> Array:
        return self._energy(k, at_pieces(k, self.piece_nodes(k.model))[0])

    force = sum_of_pieces

    def piece_nodes(self, model: ModelView) -> np.ndarray:
        """The three nodes of every joint, then those of the clamped links, with the first one twice."""
        graph = model.geometry
        clamped, _ = self._clamped_links(model)
        walls = np.stack([graph.first[clamped], graph.first[clamped], graph.last[clamped]], axis=1)
        return np.concatenate([self._joints(model)[2], walls])

    def piece_force(self, k: Kinematics, r: Array, v: Array) -> Array:
        return -jax.grad(partial(self._energy, k))(r)

    def _energy(self, k: Kinematics, r: Array) -> Array:
        """Energy [J] of the joints with nodes at positions r (joints, 3, 3)."""
        first, second, _ = self._joints(k.model)
        stiffness = self._stiffness(k, first, second)
        links = r[:, 1:] - r[:, :-1]
        before, after = jnp.moveaxis(links / jnp.sqrt(dot(links, links) + 1e-30)[..., None], 1, 0)
        if self.directions is not None:
            clamped, signs = self._clamped_links(k.model)
            size = jnp.sqrt(dot(self.directions, self.directions))
            wall = signs[:, None] * self.directions / size[:, None]
            # l of a clamp is half of its link
            stiffness = jnp.concatenate([stiffness, 2.0 * self._stiffness(k, clamped, clamped)])
            before = jnp.concatenate([before[: len(first)], wall])
        bend = after - before
        return jnp.sum(stiffness * dot(bend, bend))

    def _stiffness(self, k: Kinematics, first: np.ndarray, second: np.ndarray) -> Array:
        """`EI/(2 l)` (joints,) [J] of joints between two links each."""
        length = 0.5 * (k.line.length[first] + k.line.length[second])
        stiffness = jnp.broadcast_to(self.EI, k.line.length.shape)
        each = 0.25 * (stiffness[first] + stiffness[second]) / length
        intact = k.line.axial.intact
        if intact is None:
            return each
        return intact[first] * intact[second] * each

    def _clamped_links(self, model: ModelView) -> tuple[np.ndarray, np.ndarray]:
        """Links at clamped points (clamps,), and 1.0 if they leave the point, -1.0 if they arrive there."""
        found = [link_at_point(model, name) for name in self.clamped]
        links, leaves = np.array(found, int).reshape(-1, 2).T
        return links, 2.0 * leaves - 1.0

    def _joints(self, model: ModelView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Both links of every joint (joints,), those of joined lines last, and its three nodes (joints, 3)."""
        graph = model.geometry
        before = graph.previous_links
        after = before + 1
        links = [np.stack([before, after], axis=1)]
        nodes = [np.stack([graph.first[before], graph.last[before], graph.last[after]], axis=1)]
        ends = {member.name: (member.start, member.end) for member in graph.members}
        spans = dict(zip(ends, graph.spans, strict=True))
        for pair in self.joined:
            pair_links = []
            paths = []
            for name, is_last in zip(pair, common_ends(pair, ends), strict=True):
                link = spans[name].stop - 1 if is_last else spans[name].start
                path = [graph.first[link], graph.last[link]]
                pair_links.append(link)
                paths.append(path if is_last else path[::-1])  # towards the joint
            links.append(np.array([pair_links]))
            nodes.append(np.array([[*paths[0], paths[1][0]]]))
        first, second = np.concatenate(links).T
        return first, second, np.concatenate(nodes)


def _check_clamps(values: Values, scene: SceneData) -> None:
    """Reject clamped points without a direction, or at which other than one line ends."""
    clamped = values["clamped"]
    given = values["directions"]
    if given is None:
        given = ()
    if len(given) != len(clamped):
        raise SceneError(
            f"effects.bending.directions: has {len(given)} entries; allowed: one for each of the "
            f"{len(clamped)} points that `clamped` names"
        )
    for i, (name, direction) in enumerate(zip(clamped, given, strict=True)):
        if not np.any(direction):
            raise SceneError(
                f"effects.bending.directions.{i}: {list(direction)} has no direction; allowed: a non-zero vector"
            )
        path = f"effects.bending.clamped.{i}"
        scene.check_line_end(name, path)
        if name in clamped[:i]:
            raise SceneError(f"{path}: {name!r} is listed twice; allowed: each point once")


def _check_joints(values: Values, scene: SceneData) -> None:
    """Reject pairs of lines that do not meet, and pairs that are listed twice."""
    ends = {line.name: (line.start, line.end) for line in scene.lines}
    joined = [set(pair) for pair in values["joined"]]
    for i, pair in enumerate(values["joined"]):
        path = f"effects.bending.joined.{i}"
        for name in pair:
            if name not in ends:
                raise SceneError(f"{path}: {name!r} is not a line; {nearest(name, list(ends))}")
        common_ends(pair, ends, path)
        if joined[i] in joined[:i]:
            raise SceneError(f"{path}: {pair[0]!r} and {pair[1]!r} are listed twice; allowed: each pair once")


def link_at_point(model: ModelView, name: str) -> tuple[int, bool]:
    """The link at a point where one line ends, and whether it is the first of its line."""
    for member, span in zip(model.geometry.members, model.geometry.spans, strict=True):
        if model.points[member.start].name == name:
            return span.start, True
        if model.points[member.end].name == name:
            return span.stop - 1, False
    raise SceneError(f"point {name!r} has no line")


def common_ends(
    pair: tuple[str, str], ends: Mapping[str, tuple[Any, Any]], path: str = "effects.bending.joined"
) -> tuple[int, int]:
    """0 for the first end of each of two lines, 1 for its last, at their common point.

    Args:
        ends: first and last point of lines by name.
        path: of the pair in the scene.

    Raises:
        SceneError: no common point, or two of them.
    """
    first, second = (ends[name] for name in pair)
    found = [(i, j) for i in (0, 1) for j in (0, 1) if first[i] == second[j]]
    if pair[0] == pair[1] or len(found) != 1:
        raise SceneError(f"{path}: {pair[0]!r} and {pair[1]!r} do not meet in one point; allowed: two lines that do")
    return found[0]
