"""Breaking loads of parts that follow the design, and loads relative to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.load.scene import Scene
from dropper_jax.scene import whole_lines
from fitting.farm.site import Part


def relate_loads_to_strength(
    hard: Sequence[np.ndarray], slope: Sequence[np.ndarray], strength: np.ndarray, slopes: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Quantities (q,) of every case and their slopes (q, p + a), with the loads of parts over their present strength.

    Args:
        strength: of the parts over that at the start (parts,); slopes: its derivatives (parts, p + a). Parts come first
            among the quantities.
    """
    n = len(strength)
    now = strength[:, None]
    peaks = []
    changes = []
    for h, s in zip(hard, slope, strict=True):
        peaks.append(np.concatenate([h[:n] / strength, h[n:]]))
        changes.append(np.vstack([s[:n] / now - h[:n, None] / now**2 * slopes, s[n:]]))
    return peaks, changes


def part_strength(part: Part, scene: Scene) -> float:
    """Breaking load of a part [N] if it comes from the scene, so that it follows the design; 1 if the site gives it."""
    if not part.of_scene:
        return 1.0
    specs = {line.name: line.spec for line in whole_lines(scene)}
    loads = [specs[name].breaking_load for name in part.lines]
    return np.mean([np.min(load) for load in loads if load is not None])
