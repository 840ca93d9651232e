"""Colours of tensions: their map, their range and their bar."""

from __future__ import annotations

import functools
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from dropper_jax.plots.scales import force_unit
from dropper_jax.plots.style import FAINT

#: Fraction of matplotlib's map `plasma` that is visible on white, and number of its colours that are interpolated.
VISIBLE = 0.87
COLOURS = 64


@functools.cache
def tension_map() -> Colormap:
    """Plasma without its pale end, which vanishes on white."""
    plasma = matplotlib.colormaps["plasma"]
    return LinearSegmentedColormap.from_list("tension", plasma(np.linspace(0.0, VISIBLE, COLOURS)), bad=FAINT)


def tension_bar(figure: Figure, links: ScalarMappable, tension: np.ndarray, **where: Any) -> None:
    """Colour bar of tensions (...) [N] in N or kN: pointed if they exceed `tension_norm`, the maximum in its label."""
    known = tension[np.isfinite(tension)]
    lowest, highest = tension_limits(known)
    below = np.any(known < lowest)
    above = np.any(known > highest)
    extend = "neither"
    if below and above:
        extend = "both"
    elif below:
        extend = "min"
    elif above:
        extend = "max"
    unit, size = force_unit(known)
    label = f"tension [{unit}]"
    if above:
        label = f"{label}, maximum {known.max() / size:.4g}"
    figure.colorbar(links, extend=extend, label=label, format=lambda value, _: f"{value / size:g}", **where)


#: Number of tensions from which some may be outside the colour range, and the percentiles at its ends [%].
MANY_TENSIONS = 1000
PERCENTILES = (1, 99)
#: Range of tensions relative to their size up to which they are equal, but for rounding, and half the range that they
#: then have, relative to the same [N/N].
EQUAL = 1e-9
HALF_RANGE = 0.05


def tension_norm(tension: np.ndarray) -> Normalize:
    """Colours of tensions [N] within `tension_limits`."""
    return Normalize(*tension_limits(tension), clip=True)


def tension_limits(tension: np.ndarray) -> tuple[float, float]:
    """Colour range of tensions [N]: from the 1st to the 99th percentile, so that one snap load does not hide the rest.

    For fewer values than `MANY_TENSIONS`, as in one configuration, the full range: a percentile would only cut the
    maximum.
    """
    known = tension[np.isfinite(tension)]
    if known.size == 0:
        return 0.0, 1.0
    low = known.min()
    high = known.max()
    if known.size >= MANY_TENSIONS:
        low, high = np.percentile(known, PERCENTILES)
    size = max(abs(low), abs(high))
    if high - low <= EQUAL * size:
        pad = HALF_RANGE * size or 1.0  # [N]
        return low - pad, high + pad
    return low, high
