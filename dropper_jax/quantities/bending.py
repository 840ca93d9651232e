"""Curvature and bending moment of lines over a whole run."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.base.numerics import unit_vectors
from dropper_jax.base.read import Table
from dropper_jax.effects.bending import CRUSHED_LENGTH, common_ends
from dropper_jax.effects.clamp_motion import ClampMotion
from dropper_jax.load.scene import Scene
from dropper_jax.quantities.end_links import End, ends_of, line_ends
from dropper_jax.scene import line_slices, sliced_lines
from dropper_jax.scene.slices import first_nodes, link_differences


def crushed_links(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    """Warnings about lines with bending stiffness whose links shorten, because their axial law has no compression.

    A line without bending stiffness folds under compression. With it the line stays straight, its links collapse to
    points, and the bending moment between links without a direction has no value.

    Args:
        positions: all nodes (k, nodes, 3) [m].
    """
    if not has_bending(scene):
        return
    bending = bending_stiffness(scene) > 0.0
    shares = np.linalg.norm(link_differences(scene, positions), axis=-1) / scene.line.length
    for line, where in sliced_lines(scene):
        if not (line.goes_slack and np.any(bending[where.links])):
            continue
        share = shares[:, where.links]
        worst = np.unravel_index(np.argmin(share), share.shape)
        if share[worst] < CRUSHED_LENGTH:
            yield (
                f"{line.name}: link {worst[1] + 1} is compressed to {share[worst]:.0%} of its length: the line has "
                f"bending stiffness, but its axial law {line.axial_law!r} no stiffness in compression. Use axial law "
                "'elastic'"
            )


def has_bending(scene: Scene) -> bool:
    """Whether lines of the scene have bending stiffness."""
    return "bending" in scene.effects


def bending_stiffness(scene: Scene) -> np.ndarray:
    """EI (n,) [N m^2] of each link."""
    return np.broadcast_to(np.asarray(scene.effects["bending"]["EI"], float), scene.line.links)


def curvature(scene: Scene, positions: np.ndarray, t: np.ndarray | None = None) -> np.ndarray:
    """`kappa = |q_(j+1) - q_j|/l` (k, nodes) [1/m] as `effects.bending` has it: 0 at pinned ends.

    q are directions of links, l the mean length of a node's two; at a clamped end q_0 is the clamp's and l half a link.

    Args:
        positions: all nodes, line after line (k, nodes, 3) [m].
        t: times (k,) [s], for clamps that turn; 0 if omitted.
    """
    length = scene.line.length
    first = first_nodes(scene)
    q = unit_vectors(link_differences(scene, positions))
    found = np.zeros(positions.shape[:2])
    before = np.flatnonzero(np.diff(first) == 1)  # links that another one of their line follows
    turns = np.linalg.norm(q[:, before + 1] - q[:, before], axis=-1)
    found[:, first[before + 1]] = turns / (0.5 * (length[before + 1] + length[before]))
    clamps = _clamps(scene, np.zeros(len(positions)) if t is None else t)
    for point, end in line_ends(scene):
        if point in clamps:
            found[:, end.nodes[0]] = np.linalg.norm(_outward(q, end) - clamps[point], axis=-1) / (
                0.5 * length[end.link]
            )
    for one, other in _joined_ends(scene):
        turn = np.linalg.norm(_outward(q, one) + _outward(q, other), axis=-1)
        found[:, [one.nodes[0], other.nodes[0]]] = (turn / (0.5 * (length[one.link] + length[other.link])))[:, None]
    return found


def _outward(q: np.ndarray, end: End) -> np.ndarray:
    """Direction (k, 3) of an end link from its point, from those of all links (k, n, 3)."""
    if end.last:
        return -q[:, end.link]
    return q[:, end.link]


def _joined_ends(scene: Scene) -> Iterator[list[End]]:
    """The two ends of lines that `bending` joins, of each pair."""
    points = {line.name: (line.start, line.end) for line in scene.lines}
    ends = {where.name: ends_of(where) for where in line_slices(scene)}
    for pair in scene.effects.get("bending", {}).get("joined", ()):
        yield [ends[name][last] for name, last in zip(pair, common_ends(pair, points), strict=True)]


def bending_moment(scene: Scene, positions: np.ndarray, t: np.ndarray, broken: tuple[Table, ...]) -> np.ndarray:
    """`M = EI kappa` (k, nodes) [N m], EI the mean of the links at a node; zero next to a broken link.

    At a joint of two lines it is one moment on both, of their mean stiffness.

    Args:
        positions, t: as for `curvature`.
        broken: as in a solution.
    """
    first = first_nodes(scene)
    at = np.concatenate([first, first + 1])
    stiffness = np.bincount(at, np.tile(bending_stiffness(scene), 2)) / np.bincount(at)
    joints = [[one.nodes[0], other.nodes[0]] for one, other in _joined_ends(scene)]
    for nodes in joints:
        stiffness[nodes] = np.mean(stiffness[nodes])
    moment = stiffness * curvature(scene, positions, t)
    starts = {where.name: where.links.start for where in line_slices(scene)}
    for row in broken:
        node = first[starts[row["line"]] + row["link"] - 1]
        straight = [node, node + 1]
        for nodes in joints:
            if node in nodes or node + 1 in nodes:
                straight += nodes
        moment[np.ix_(t > row["time_s"], straight)] = 0.0
    return moment


def _clamps(scene: Scene, t: np.ndarray) -> dict[str, np.ndarray]:
    """Directions (3,), or (k, 3) at times t (k,) [s], in which lines leave their clamped points."""
    given = scene.effects.get("bending", {})
    found = {}
    if given.get("clamped"):
        for name, direction in zip(given["clamped"], given["directions"], strict=True):
            found[name] = direction / np.linalg.norm(direction)
    if "clamp_motion" in scene.effects:
        clamp = ClampMotion(**scene.effects["clamp_motion"])
        found[clamp.point] = np.asarray(jax.vmap(clamp.leaving)(jnp.asarray(t)))
    return found


#: Curvature below which a radius is that of a straight line [1/m].
STRAIGHT = 1e-12


def bending_summary(
    scene: Scene, t: np.ndarray, kappa: np.ndarray, moment: np.ndarray
) -> dict[str, dict[str, float | None]]:
    """Maximum moment [N m] of each line with its arc length [m] and time [s], and the minimum radius [m].

    Lines that stay straight have the radius None.
    """
    found = {}
    for line, where in sliced_lines(scene):
        own = moment[:, where.nodes]
        bent = float(np.max(kappa[:, where.nodes]))
        when, node = np.unravel_index(np.argmax(own), own.shape)
        found[line.name] = {
            "largest_moment_n_m": float(own[when, node]),
            "at_m": float(np.sum(line.length[:node])),
            "t_s": float(t[when]),
            "least_radius_m": 1.0 / bent if bent > STRAIGHT else None,
        }
    return found
