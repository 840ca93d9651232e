"""Views of a motion: whether it is planar, the limits that contain it, and axes of the x-z plane."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

#: Motion is planar if y stays within this fraction of the picture's size.
PLANAR_SHARE = 1e-9
#: Longest side of the drawn box [inch].
LONGEST_SIDE = 6.5


def planar(positions: np.ndarray) -> bool:
    """Whether nodes (k, n + 1, 3) stay in one x-z plane."""
    return bool(np.ptp(positions[..., 1]) <= PLANAR_SHARE * size(positions))


def size(positions: np.ndarray) -> float:
    """Largest extent (k, n + 1, 3) -> [m]."""
    return float(np.ptp(positions.reshape(-1, 3), axis=0).max())


#: Margin around the nodes, and minimum width or height of a picture, as fractions of the larger extent.
MARGIN = 0.06


def box(positions: np.ndarray, min_ratio: float = 0.4) -> np.ndarray:
    """Limits (3, 2) [m] with a margin around all nodes; no side is shorter than `min_ratio` of the longest."""
    low = positions.reshape(-1, 3).min(axis=0)
    high = positions.reshape(-1, 3).max(axis=0)
    side = (high - low).max() or 1.0
    half = np.maximum((high - low) / 2 + MARGIN * side, min_ratio * side / 2)
    middle = (high + low) / 2
    return np.stack([middle - half, middle + half], axis=1)


def flat_axes(figure: Figure, limits: np.ndarray) -> Axes:
    """Axes for the x-z plane, equal scales."""
    axes = figure.add_subplot()
    axes.set(xlim=limits[0], ylim=limits[2], xlabel="x [m]", ylabel="z [m]", aspect="equal")
    return axes


def figure_size(limits: np.ndarray, longest: float = LONGEST_SIDE) -> tuple[float, float]:
    """Width and height [inch] of a view in a plane, with space for labels and the colour bar."""
    side = np.ptp(limits, axis=1)[[0, 2]]
    return tuple(np.maximum(side * (longest / side.max()) + [1.6, 1.2], [4.6, 3.2]))
