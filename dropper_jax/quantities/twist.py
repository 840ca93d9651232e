"""Torque of lines over a whole run, and warnings of what their torsion omits: loops and coils."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.analysis.writhe import writhe
from dropper_jax.base.read import Table
from dropper_jax.load.scene import Scene
from dropper_jax.quantities.bending import bending_stiffness, has_bending
from dropper_jax.scene import line_slices, sliced_lines
from dropper_jax.scene.slices import link_differences


def torque(
    scene: Scene, positions: np.ndarray, twist: np.ndarray, rate: np.ndarray, t: np.ndarray, broken: tuple[Table, ...]
) -> np.ndarray:
    """`Q = GJ tau/l + c tau'/l + k_tt e` (k, n) [N m] of the links (see `effects.torsion`); zero of broken ones.

    Args:
        positions: all nodes (k, nodes, 3) [m]; twist, rate: (k, nodes) [rad], [rad/s].
        t: times (k,) [s].
        broken: rows of `run.observation.breaks`.
    """
    given = scene.effects["torsion"]
    length = scene.line.length
    tau = link_differences(scene, twist) / length
    found = given["GJ"] * tau + given["damping"] * link_differences(scene, rate) / length
    if given["coupling"] is not None:
        size = np.linalg.norm(link_differences(scene, positions), axis=-1)
        found = found + given["coupling"] * (size / length - 1.0)
    for line, where in sliced_lines(scene):
        if given["lines"] and line.name not in given["lines"]:
            found[:, where.links] = 0.0
    starts = {where.name: where.links.start for where in line_slices(scene)}
    for row in broken:
        found[t > row["time_s"], starts[row["line"]] + row["link"] - 1] = 0.0
    return found


#: Writhe [turns] above which a run warns that it is omitted.
WRITHE = 1e-3
#: Fraction of the torque above which writhe is not negligible.
WRITHE_SHARE = 0.1


def twist_warnings(scene: Scene, positions: np.ndarray, tension: np.ndarray, torque: np.ndarray) -> Iterator[str]:
    """Warnings about lines that would form loops under their torque, and lines whose coils would change their twist.

    A long rod of bending stiffness EI under the torque Q and the tension T is straight up to `Q = 2 sqrt(EI T)`
    (Greenhill 1883). Twist here is that of the material: a line that coils between fixed ends exchanges it for writhe.

    Args:
        positions: all nodes (k, nodes, 3) [m]; tension, torque: (k, n) [N], [N m].
    """
    given = scene.effects["torsion"]
    stiffness = np.broadcast_to(given["GJ"], scene.line.links)
    limit = np.full(torque.shape, np.inf)
    if has_bending(scene):
        limit = 2.0 * np.sqrt(bending_stiffness(scene) * np.maximum(tension, 0.0))
    for line, where in sliced_lines(scene):
        if given["lines"] and line.name not in given["lines"]:
            continue
        size = np.abs(torque[:, where.links])
        straight_below = limit[:, where.links]
        worst = np.unravel_index(np.argmax(size - straight_below), size.shape)
        if size[worst] > straight_below[worst]:
            yield (
                f"{line.name}: its torque of {size[worst]:.3g} N m is above 2 sqrt(EI T) = {straight_below[worst]:.3g} "
                "N m: it would form loops, which the torsion model omits"
            )
        if given["first"] == given["last"] == "held":
            nodes = positions[:, where.nodes]
            turns = float(np.ptp(writhe(nodes, nodes[0, -1] - nodes[0, 0])))
            # torque of a twist by as many turns over the whole line
            change = 2.0 * np.pi * turns * float(np.min(stiffness[where.links])) / float(np.sum(line.length))
            if turns > WRITHE and change > WRITHE_SHARE * float(np.max(size)):
                yield (
                    f"{line.name}: it coils by {turns:.2g} turns in the run; its twist would change by as many, which "
                    "the torsion model omits"
                )
