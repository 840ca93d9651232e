"""Remarks on a pose at rest: what holds in numbers and not at sea."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.scene import line_slices
from dropper_jax.scene.nodes import point_nodes

#: Base of a buoy this near [m] to the bed is on it.
NEAR = 0.05


def pose_remarks(scene: Scene, positions: np.ndarray, tension: np.ndarray) -> tuple[str, ...]:
    """One line for each line beyond its breaking load and each upright buoy under water or on the bed.

    Args:
        positions: all nodes (n + 1, 3) [m]; tension: (n,) [N].
    """
    return (*_overloaded(scene, tension), *_misplaced(scene, positions))


def _overloaded(scene: Scene, tension: np.ndarray) -> Iterator[str]:
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if line.breaking_load is None:
            continue
        share = tension[where.links] / line.breaking_load
        worst = int(np.argmax(share))
        if share[worst] > 1.0:
            yield (
                f"{line.name}: {tension[where.links][worst]:.4g} N at rest, above its breaking load of "
                f"{line.breaking_load[worst]:.4g} N"
            )


def _misplaced(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    nodes = point_nodes(scene)
    for buoy in scene.buoys:
        base = float(positions[nodes[buoy.point], 2]) - buoy.attachment
        if scene.sea is None:
            continue
        if base + buoy.height < 0.0:
            yield f"{buoy.name}: at rest its top is {-base - buoy.height:.3g} m under water"
        if base < -scene.sea.depth + NEAR:
            yield f"{buoy.name}: at rest its base is on the bed"
