"""Curvature, bending moment, torque, and forces on fixed points over a whole run."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.analysis.writhe import writhe
from dropper_jax.base.read import Table
from dropper_jax.effects.bending import CRUSHED, common_ends
from dropper_jax.effects.clamp_motion import ClampMotion
from dropper_jax.load.scene import Scene
from dropper_jax.run.end_links import EndLinks, line_ends
from dropper_jax.run.growth import overgrown
from dropper_jax.scene import LineSlice, LineSpec, SceneData, line_slices, sliced_lines, whole_lines


def torque(scene: Scene, positions: np.ndarray, twist: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """`Q = GJ tau/l + c tau'/l + k_tt e` (k, n) [N m] of the links (see `effects.torsion`).

    Args:
        positions: all nodes (k, nodes, 3) [m]; twist, rate: (k, nodes) [rad], [rad/s].
    """
    given = scene.effects["torsion"]
    links = scene.line.links
    stiffness = np.broadcast_to(given["GJ"], links)
    damping = np.broadcast_to(given["damping"], links)
    coupling = given["coupling"]
    found = np.zeros((len(positions), links))
    for line, where in _twisting_lines(scene):
        at = where.links
        tau = np.diff(twist[:, where.nodes], axis=1) / line.length
        turning = np.diff(rate[:, where.nodes], axis=1) / line.length
        found[:, at] = stiffness[at] * tau + damping[at] * turning
        if coupling is not None:
            length = np.linalg.norm(np.diff(positions[:, where.nodes], axis=1), axis=-1)
            found[:, at] += np.broadcast_to(coupling, links)[at] * (length / line.length - 1.0)
    return found


def _twisting_lines(scene: Scene) -> list[tuple[LineSpec, LineSlice]]:
    """The lines with torsion, and their nodes and links."""
    names = scene.effects["torsion"]["lines"]
    return [(line, where) for line, where in sliced_lines(scene) if not names or line.name in names]


#: Writhe [turns] above which a run warns that it is omitted.
WRITHE = 1e-3
#: Fraction of the torque above which writhe is not negligible.
WRITHE_SHARE = 0.1


def twist_remarks(scene: Scene, positions: np.ndarray, tension: np.ndarray, torque: np.ndarray) -> Iterator[str]:
    """Warnings about lines that would form loops under their torque, and lines whose coils would change their twist.

    A long rod of bending stiffness EI under the torque Q and the tension T is straight up to `Q = 2 sqrt(EI T)`
    (Greenhill 1883). Twist here is that of the material: a line that coils between fixed ends exchanges it for writhe.

    Args:
        positions: all nodes (k, nodes, 3) [m]; tension, torque: (k, n) [N], [N m].
    """
    given = scene.effects["torsion"]
    twisting = np.broadcast_to(given["GJ"], scene.line.links)
    stiffness = None
    if bends(scene):
        stiffness = bending_stiffness(scene)
    for line, where in _twisting_lines(scene):
        turning = np.abs(torque[:, where.links])
        pulled = np.maximum(tension[:, where.links], 0.0)
        if stiffness is not None:
            most = 2.0 * np.sqrt(stiffness[where.links] * pulled)
            worst = np.unravel_index(np.argmax(turning - most), turning.shape)
            if turning[worst] > most[worst]:
                yield (
                    f"{line.name}: its torque of {turning[worst]:.3g} N m is above 2 sqrt(EI T) = {most[worst]:.3g} "
                    "N m: it would form loops, which the torsion model omits"
                )
        if given["first"] == given["last"] == "held":
            nodes = positions[:, where.nodes]
            turns = float(np.ptp(writhe(nodes, nodes[0, -1] - nodes[0, 0])))
            gives = 2.0 * np.pi * turns * float(np.min(twisting[where.links])) / float(np.sum(line.length))
            if turns > WRITHE and gives > WRITHE_SHARE * float(np.max(turning)):
                yield (
                    f"{line.name}: it coils by {turns:.2g} turns in the run; its twist would change by as many, which "
                    "the torsion model omits"
                )


def crushed_links(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    """Warnings about lines with bending stiffness whose links shorten, because their axial law has no compression.

    A line without bending stiffness folds under compression. With it the line stays straight, its links collapse to
    points, and the bending moment between links without a direction has no value.

    Args:
        positions: all nodes (k, nodes, 3) [m].
    """
    if not bends(scene):
        return
    stiffness = bending_stiffness(scene)
    for line, where in sliced_lines(scene):
        if not (line.goes_slack and np.any(stiffness[where.links] > 0.0)):
            continue
        size = np.linalg.norm(np.diff(positions[:, where.nodes], axis=1), axis=-1) / line.length
        worst = np.unravel_index(np.argmin(size), size.shape)
        if size[worst] < CRUSHED:
            yield (
                f"{line.name}: link {worst[1] + 1} is compressed to {size[worst]:.0%} of its length: the line has "
                f"bending stiffness, but its axial law {line.axial_law!r} no stiffness in compression. Use axial law "
                "'elastic'"
            )


def bends(scene: Scene) -> bool:
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
    found = np.zeros(positions.shape[:2])
    away = {}
    clamps = _clamps(scene, np.zeros(len(positions)) if t is None else t)
    for line, where in sliced_lines(scene):
        links = np.diff(positions[:, where.nodes], axis=1)
        size = np.linalg.norm(links, axis=-1, keepdims=True)
        q = links / np.where(size > 0.0, size, 1.0)
        length = np.asarray(line.length, float)
        own = found[:, where.nodes]
        own[:, 1:-1] = np.linalg.norm(q[:, 1:] - q[:, :-1], axis=-1) / (0.5 * (length[1:] + length[:-1]))
        for node, link, name, sign in ((0, 0, line.start, 1.0), (-1, -1, line.end, -1.0)):
            if name in clamps:
                own[:, node] = np.linalg.norm(q[:, link] - sign * clamps[name], axis=-1) / (0.5 * length[link])
        away[line.name] = ((q[:, 0], length[0]), (-q[:, -1], length[-1]))
    for pair, ends, nodes in _joined_ends(scene):
        first, second = (away[name][end] for name, end in zip(pair, ends, strict=True))
        bent = np.linalg.norm(first[0] + second[0], axis=-1) / (0.5 * (first[1] + second[1]))
        found[:, nodes] = bent[:, None]
    return found


def _joined_ends(scene: Scene) -> Iterator[tuple[tuple[str, str], tuple[int, int], list[int]]]:
    """The lines of each pair that `bending` joins, their ends (0 or 1) at the common point, and their nodes there."""
    ends = {line.name: (line.start, line.end) for line in scene.lines}
    nodes = {where.name: (where.nodes.start, where.nodes.stop - 1) for where in line_slices(scene)}
    for pair in scene.effects.get("bending", {}).get("joined", ()):
        common = common_ends(pair, ends)
        yield pair, common, [nodes[name][end] for name, end in zip(pair, common, strict=True)]


def bending_moment(scene: Scene, positions: np.ndarray, t: np.ndarray, broken: tuple[Table, ...]) -> np.ndarray:
    """`M = EI kappa` (k, nodes) [N m]; zero next to a broken link."""
    kappa = curvature(scene, positions, t)
    stiffness = bending_stiffness(scene)
    for where in line_slices(scene):
        each = stiffness[where.links]
        kappa[:, where.nodes] *= np.concatenate([each[:1], 0.5 * (each[1:] + each[:-1]), each[-1:]])
        for row in broken:
            if row["line"] == where.name:
                beside = slice(where.nodes.start + row["link"] - 1, where.nodes.start + row["link"] + 1)
                kappa[t > row["time_s"], beside] = 0.0
    for _, _, nodes in _joined_ends(scene):
        # one moment on both lines: that of their mean stiffness, and none once an end link has broken
        intact = np.all(kappa[:, nodes] > 0.0, axis=1, keepdims=True)
        kappa[:, nodes] = intact * np.mean(kappa[:, nodes], axis=1, keepdims=True)
    return kappa


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
        least_radius_m = None
        if bent > STRAIGHT:
            least_radius_m = 1.0 / bent
        found[line.name] = {
            "largest_moment_n_m": float(own[when, node]),
            "at_m": float(np.sum(line.length[:node])),
            "t_s": float(t[when]),
            "least_radius_m": least_radius_m,
        }
    return found


def point_load(
    scene: Scene, name: str, t: np.ndarray, positions: np.ndarray, t_tension: np.ndarray, tension: np.ndarray
) -> np.ndarray:
    """Force (q, 3) [N] of all lines on a point, at the times of the tensions (see `run.end_links`).

    Args:
        t, positions: saved times (k,) [s] and nodes (k, nodes, 3) [m] of all lines.
        t_tension, tension: (q,) [s] and (q, links) [N].
    """
    links = EndLinks(overgrown(scene))
    total = np.zeros((len(t_tension), 3))
    for point, end in line_ends(scene):
        if point == name:
            total += links.force_between(end, t, positions, t_tension, tension)
    return total


def held_points(scene: SceneData) -> list[str]:
    """Names of the fixed points at which a line ends."""
    ends = {name for line in scene.lines for name in (line.start, line.end)}
    return [name for name in scene.fixed_points if name in ends]


def end_tensions(scene: SceneData, tension: np.ndarray) -> dict[str, np.ndarray]:
    """Tension (k, 2) [N] of the first and the last link of every line, pieces between attached points together."""
    return {line.name: tension[:, [line.links.start, line.links.stop - 1]] for line in whole_lines(scene)}
