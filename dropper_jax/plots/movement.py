"""What moves in a run: rotations of links, displacements of nodes, and the links that have a panel."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from dropper_jax.base.numerics import unit_vectors
from dropper_jax.plots import view
from dropper_jax.plots.run import Run
from dropper_jax.scene.slices import link_differences

#: Limits of rounding: angles [rad]; displacements relative to the size of the scene.
ANGLE_ROUNDING = 1e-7
TRAVEL_ROUNDING = 1e-7


def swing(run: Run) -> np.ndarray:
    """Rotation of each link (n,) [rad]: the range of the components of its direction, which does not depend on its
    angles."""
    return np.ptp(directions(run), axis=0).max(axis=-1)


def directions(run: Run) -> np.ndarray:
    """Unit vector (k, n, 3) of each link."""
    return unit_vectors(link_differences(run.scene, run.positions))


def travel(run: Run) -> np.ndarray:
    """Displacement of each node (nodes,) [m]: the longest side of the box around its path."""
    return np.ptp(run.positions, axis=0).max(axis=-1)


def travel_rounding(run: Run) -> float:
    """Displacement [m] up to which a node is at rest."""
    return TRAVEL_ROUNDING * view.size(run.positions[:1])


def anything_moves(run: Run) -> bool:
    """Whether any node moves by more than rounding."""
    return bool(travel(run).max() > travel_rounding(run))


def chosen_links(run: Run, most: int) -> np.ndarray:
    """Links that have a panel, at most `most`, in order: evenly spaced in a single line; of many lines the links that
    move most."""
    size = swing(run)
    moving = np.flatnonzero(size > ANGLE_ROUNDING)
    if len(run.written_lines) == 1 or len(moving) <= most:
        return moving[np.unique(np.linspace(0, len(moving) - 1, min(len(moving), most)).round().astype(int))]
    best = np.array([line.links.start + int(np.argmax(size[line.links])) for line in run.written_lines])
    order = np.argsort(-size[best], kind="stable")[:most]
    return np.sort(best[order][size[best[order]] > ANGLE_ROUNDING])


def changing(columns: Iterable[np.ndarray], least: float) -> np.ndarray:
    """Which of n series (k, n) change by more than their limit in any of the columns (n,)."""
    with np.errstate(invalid="ignore"):
        return np.any([np.nan_to_num(np.ptp(values, axis=0)) > least for values in columns], axis=0)
