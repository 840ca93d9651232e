"""Moving links, lines and nodes of a run, which have a panel."""

from __future__ import annotations

import numpy as np

from dropper_jax.plots import view
from dropper_jax.plots.run import Run

#: Limits of rounding: angles [rad]; tensions relative to the maximum; displacements relative to the size of the scene.
ANGLE, TENSION, TRAVEL = 1e-7, 1e-6, 1e-7


def swing(run: Run) -> np.ndarray:
    """Rotation of each link (n,) [rad]: the range of the components of its direction, which does not depend on its
    angles."""
    links = run.positions[:, run.first + 1] - run.positions[:, run.first]
    length = np.linalg.norm(links, axis=-1, keepdims=True)
    return np.ptp(links / np.where(length > 0, length, 1.0), axis=0).max(axis=-1)


def travel(run: Run) -> np.ndarray:
    """Displacement of each node (nodes,) [m]: the longest side of the box around its path."""
    return np.ptp(run.positions, axis=0).max(axis=-1)


def anything_moves(run: Run) -> bool:
    """Whether any node moves by more than rounding."""
    return bool(travel(run).max() > TRAVEL * max(view.size(run.positions[:1]), 1e-300))


def chosen_links(run: Run, most: int) -> np.ndarray:
    """Links that have a panel, at most `most`, in order: evenly spaced in a single line; of many lines the links that
    move most."""
    size = swing(run)
    moving = np.flatnonzero(size > ANGLE)
    if len(run.written_lines) == 1 or len(moving) <= most:
        return moving[np.unique(np.linspace(0, len(moving) - 1, min(len(moving), most)).round().astype(int))]
    best = [line.links.start + int(np.argmax(size[line.links])) for line in run.written_lines]
    best = [link for link in best if size[link] > ANGLE]
    return np.sort(np.array(sorted(best, key=lambda link: -size[link])[:most], dtype=int))


def changing(columns: list[np.ndarray], least: float) -> np.ndarray:
    """Which of n series (k, n) change by more than their limit in any of the columns (n,)."""
    with np.errstate(invalid="ignore"):
        return np.any([np.nan_to_num(np.ptp(values, axis=0)) > least for values in columns], axis=0)
