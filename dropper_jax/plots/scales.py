"""Units and scales of the axes of all pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

#: Maximum tension [N] above which a figure is in kN.
IN_KILONEWTON = 5e3


def force_unit(values: ArrayLike) -> tuple[str, float]:
    """Unit and its size [N] for all forces [N] of a figure."""
    size = np.abs(np.asarray(values, float))
    if np.max(size, initial=0.0, where=np.isfinite(size)) >= IN_KILONEWTON:
        return "kN", 1e3
    return "N", 1.0


def time_axis(axes: Axes, t: np.ndarray) -> None:
    """Label and limits of a time axis that spans the samples."""
    axes.set_xlabel("time [s]")
    if t[-1] > t[0]:
        axes.set_xlim(t[0], t[-1])


#: Range of values relative to their size (at least 1) below which they are constant: rounding of a long run.
CONSTANT = 1e-6
#: Half the height of the axis of constant values relative to their size.
HALF_HEIGHT = 0.05


def widen(values: np.ndarray, limits: Callable[[float, float], object]) -> None:
    """Give constant values a readable axis (`limits` sets it) instead of one that magnifies rounding errors."""
    known = values[np.isfinite(values)]
    if known.size and np.ptp(known) < CONSTANT * np.abs(known).max(initial=1.0):
        middle = 0.5 * (known.min() + known.max())
        half = HALF_HEIGHT * max(1.0, abs(middle))
        limits(middle - half, middle + half)


#: Panels share a scale if none has a range smaller than the largest by this factor.
SIMILAR = 4.0
#: Height of the limits that contain all panels over that of the widest, above which each panel keeps its own middle.
SEPARATE_RATIO = 2.0


def share_scales(panels: Iterable[Axes]) -> None:
    """The same vertical scale for panels of similar ranges, so that curves in different panels can be compared.

    Their limits are the same too, unless they are so far apart that curves would be flat, as the coordinates of a
    float far from the origin.
    """
    left = sorted(panels, key=_height, reverse=True)
    while left:
        widest = _height(left[0])
        group = [axes for axes in left if _height(axes) * SIMILAR >= widest]
        ends = [axes.get_ylim() for axes in group]
        low = np.min(ends)
        high = np.max(ends)
        for axes in group:
            if high - low > SEPARATE_RATIO * widest:
                middle = float(np.mean(axes.get_ylim()))
                axes.set_ylim(middle - 0.5 * widest, middle + 0.5 * widest)
            else:
                axes.set_ylim(low, high)
        left = left[len(group) :]


def _height(axes: Axes) -> float:
    """Range of the vertical scale of a panel."""
    return float(np.ptp(axes.get_ylim()))
