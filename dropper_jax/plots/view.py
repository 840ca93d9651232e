"""Viewing direction: normal to the plane of a planar motion, or fixed in space."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MaxNLocator

#: Motion is planar if y stays within this fraction of the picture's size.
FLAT = 1e-9
#: Margin around the nodes, and minimum width or height of a picture, as fractions of the larger extent.
MARGIN, LEAST = 0.06, 0.4


def planar(positions: np.ndarray) -> bool:
    """Whether nodes (k, n + 1, 3) stay in one x-z plane."""
    return bool(np.ptp(positions[..., 1]) <= FLAT * size(positions))


def size(positions: np.ndarray) -> float:
    """Largest extent (k, n + 1, 3) -> [m]."""
    return float(np.ptp(positions.reshape(-1, 3), axis=0).max())


def box(positions: np.ndarray, least: float = LEAST) -> np.ndarray:
    """Limits (3, 2) [m] with a margin around all nodes; no side is shorter than `least` of the longest."""
    low, high = positions.reshape(-1, 3).min(axis=0), positions.reshape(-1, 3).max(axis=0)
    side = (high - low).max() or 1.0
    half = np.maximum((high - low) / 2 + MARGIN * side, least * side / 2)
    middle = (high + low) / 2
    return np.stack([middle - half, middle + half], axis=1)


def fixed_ends(positions: np.ndarray) -> np.ndarray:
    """End nodes that never move, (m, 3) [m], m <= 2; for a run of one sample only the first end is known to be
    fixed."""
    ends = positions[:, [0, -1]]
    still = np.abs(ends - ends[:1]).max(axis=(0, 2)) <= FLAT * size(positions)
    if len(positions) == 1:
        still = np.array([True, False])
    return ends[0, still]


def flat_axes(figure: Figure, subplot: SubplotSpec, limits: np.ndarray) -> Axes:
    """Axes for the x-z plane, equal scales."""
    axes = figure.add_subplot(subplot)
    axes.set(xlim=limits[0], ylim=limits[2], xlabel="x [m]", ylabel="z [m]")
    axes.set_aspect("equal")
    return axes


def space_axes(figure: Figure, subplot: SubplotSpec, limits: np.ndarray) -> Axes:
    """Axes in space, equal scales."""
    axes = figure.add_subplot(subplot, projection="3d", elev=18, azim=-58)
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2], xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect(limits[:, 1] - limits[:, 0], zoom=0.92)
    side = limits[:, 1] - limits[:, 0]
    for axis, part in zip((axes.xaxis, axes.yaxis, axes.zaxis), side / side.max(), strict=True):
        axis.set_major_locator(MaxNLocator(2 if part < 0.6 else 5))
        axis.set_pane_color((0.97, 0.97, 0.98, 1.0))
    axes.tick_params(labelsize=8, pad=1)
    return axes


def figure_size(limits: np.ndarray, flat: bool, longest: float = 6.5) -> tuple[float, float]:
    """Width and height [inch] for the limits, with space for labels and the colour bar."""
    if not flat:
        return longest + 0.6, longest * 0.9
    width, height = limits[0, 1] - limits[0, 0], limits[2, 1] - limits[2, 0]
    scale = longest / max(width, height)
    return max(width * scale + 1.6, 4.6), max(height * scale + 1.2, 3.2)
