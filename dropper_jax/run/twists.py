"""Twist and torque along lines with torsion, from the stored state of the effect, and warnings about omitted writhe."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.analysis.writhe import writhe
from dropper_jax.load.scene import Scene
from dropper_jax.scene import line_slices


def torque(scene: Scene, positions: np.ndarray, twist: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """`Q = GJ tau/l + c tau'/l + k_tt e` (k, n) [N m] of the links (see `effects.torsion`).

    Args:
        positions: all nodes (k, nodes, 3) [m]; twist, rate: (k, nodes) [rad], [rad/s].
    """
    given, links = scene.effects["torsion"], sum(line.links for line in scene.lines)
    stiffness, damping = (np.broadcast_to(given[key], links) for key in ("GJ", "damping"))
    coupling = None if given["coupling"] is None else np.broadcast_to(given["coupling"], links)
    found = np.zeros((len(positions), links))
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if given["lines"] and line.name not in given["lines"]:
            continue
        at = where.links
        tau, turning = (np.diff(a[:, where.nodes], axis=1) / line.length for a in (twist, rate))
        found[:, at] = stiffness[at] * tau + damping[at] * turning
        if coupling is not None:
            length = np.linalg.norm(np.diff(positions[:, where.nodes], axis=1), axis=-1)
            found[:, at] += coupling[at] * (length / line.length - 1.0)
    return found


#: Writhe [turns] and its fraction of the torque above which a run warns that it is omitted.
COILED, FELT = 1e-3, 0.1


def twist_remarks(scene: Scene, positions: np.ndarray, tension: np.ndarray, torque: np.ndarray) -> Iterator[str]:
    """Warnings about lines that would form loops under their torque, and lines whose coils would change their twist.

    A long rod of bending stiffness EI under the torque Q and the tension T is straight up to `Q = 2 sqrt(EI T)`
    (Greenhill 1883). Twist here is that of the material: a line that coils between fixed ends exchanges it for writhe.

    Args:
        positions: all nodes (k, nodes, 3) [m]; tension, torque: (k, n) [N], [N m].
    """
    given = scene.effects["torsion"]
    links = sum(line.links for line in scene.lines)
    stiffness = None
    if "bending" in scene.effects:
        stiffness = np.broadcast_to(np.asarray(scene.effects["bending"]["EI"], float), links)
    twisting = np.broadcast_to(given["GJ"], links)
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if given["lines"] and line.name not in given["lines"]:
            continue
        turning, pulled = np.abs(torque[:, where.links]), np.maximum(tension[:, where.links], 0.0)
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
            if turns > COILED and gives > FELT * float(np.max(turning)):
                yield (
                    f"{line.name}: it coils by {turns:.2g} turns in the run; its twist would change by as many, which "
                    "the torsion model omits"
                )
