"""Warnings about an equilibrium that is numerically valid but not realistic at sea."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.load.scene import Scene
from dropper_jax.scene import line_slices
from dropper_jax.scene.nodes import point_nodes

#: Static strain of a line above which a warning is given, and above which a scene is an error: a rope breaks before.
STRETCHED, TORN = 0.1, 0.5
#: A buoy whose base is within this distance [m] of the seabed is on it.
NEAR = 0.05


def pose_remarks(scene: Scene, positions: np.ndarray, tension: np.ndarray) -> tuple[str, ...]:
    """One warning for each line above its breaking load or stretched by 10 %, each buoy under water or on the seabed.

    Args:
        positions: all nodes (n + 1, 3) [m]; tension: (n,) [N].
    """
    return (*_check_loads(scene, tension), *_check_stretch(scene, positions), *_check_buoys(scene, positions))


def check_stretch(scene: Scene, positions: np.ndarray) -> None:
    """Reject lines that break at rest.

    Raises:
        SceneError: a strain of 50 % or more.
    """
    for line, strain in _strains(scene, positions):
        if strain >= TORN:
            raise SceneError(
                f"line {line!r}: is stretched by {strain:.0%} at rest, more than {TORN:.0%}. Check its length "
                "and EA and the positions of its ends"
            )


def _strains(scene: Scene, positions: np.ndarray) -> Iterator[tuple[str, float]]:
    """Maximum strain of a link of each elastic line."""
    for line, where in zip(scene.lines, line_slices(scene), strict=True):
        if not line.rigid:
            size = np.linalg.norm(np.diff(np.asarray(positions)[where.nodes], axis=0), axis=1)
            yield line.name, float(np.max(size / line.length - 1.0))


def _check_stretch(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    for line, strain in _strains(scene, positions):
        if strain > STRETCHED:
            yield f"{line}: is stretched by {strain:.0%} at rest; check its length and EA"


def _check_loads(scene: Scene, tension: np.ndarray) -> Iterator[str]:
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


def _check_buoys(scene: Scene, positions: np.ndarray) -> Iterator[str]:
    nodes = point_nodes(scene)
    for buoy in scene.buoys:
        base = float(positions[nodes[buoy.point], 2]) - buoy.attachment
        if scene.sea is None:
            continue
        if base + buoy.height < 0.0:
            yield f"{buoy.name}: at rest its top is {-base - buoy.height:.3g} m under water"
        if base < -scene.sea.depth + NEAR:
            yield f"{buoy.name}: at rest its base is on the seabed"
