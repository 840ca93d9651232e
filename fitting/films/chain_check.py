"""Whether the followed circles move as the nodes of a chain: links of constant length, nodes with mass.

Circles are assigned to nodes by the lengths of the links, so that scratches and corners of the background may be taken
for nodes, a different one in each frame. Three properties of a real chain reveal this:

- A link keeps its length within a few per cent over the film, after the map to the plane of motion.
- A node has mass: its position follows from those before and after. `off` is its deviation from the cubic through the
  two samples before and the two after, `s` its standard deviation over the film. White noise has off/s = 1.2, a swing
  sampled 6 times per period 0.17.
- Swapped names, jumps and wrong lengths (`marks`) are exceptions.
"""

from __future__ import annotations

import numpy as np

from fitting.films.lengths import robust_lengths
from fitting.films.marks import Marks, off_cubic
from fitting.traces.trace import FEWEST_SAMPLES

#: Maximum change of a link, robust standard deviation over its length. Right films show 0.001, motion out of the plane
#: and uncalibrated lenses up to 0.03.
LENGTH_CHANGE = 0.05
#: Maximum share of marked frames. Right films show up to 0.01.
MARKED_SHARE = 0.2
#: Maximum ratio off/s of a node that moves by more than `MOVES_BY` mean links; one node at least must be below it.
MAX_JERK = 0.25
MOVES_BY = 0.15
#: Maximum standard error of an angle [rad]. Larger ones are left empty.
LARGEST_ERROR = 0.2


def why_no_chain(positions: np.ndarray, marks: Marks, error: np.ndarray) -> str:
    """Why the circles do not move as a chain; empty if they do.

    Args:
        positions: (k, n, 2) in the plane of motion, NaN if not detected.
        error: standard errors of the angles (k, n - 1) [rad], NaN for missing samples.
    """
    _, length, deviation = robust_lengths(positions)
    change = deviation / np.maximum(length, 1e-9)
    worst = np.argmax(change)
    if change[worst] > LENGTH_CHANGE:
        return f"link {worst + 1} changes its length by {100 * change[worst]:.2g} %"
    share = marks.frames.mean()
    if share > MARKED_SHARE:
        return f"nodes swap, jump or violate the lengths of their links in {100 * share:.0f} % of the frames"
    if jerk := _why_jerky(positions, np.mean(length)):
        return jerk
    for j, column in enumerate(error.T, 1):
        known = column[np.isfinite(column)]
        if len(known) and np.median(known) > LARGEST_ERROR:
            return f"the angle of link {j} has a standard error of {np.median(known):.2g} rad"
        good = np.sum(known <= LARGEST_ERROR)
        if good < FEWEST_SAMPLES:
            return f"link {j} is seen in {good} frames, fewer than {FEWEST_SAMPLES}"
    return ""


def _why_jerky(positions: np.ndarray, length: float) -> str:
    """Why the nodes do not move as masses do; empty if they do."""
    ratios = []
    for k in range(positions.shape[1]):
        frames = np.flatnonzero(np.isfinite(positions[:, k, 0]))
        if len(frames) < FEWEST_SAMPLES:
            continue
        here = positions[frames, k]
        off, apart = off_cubic(frames, here)
        near = apart == 2
        spread = np.sqrt(np.var(here, axis=0).sum())
        if near.sum() < FEWEST_SAMPLES or not spread > 0:
            continue
        ratio = np.median(off[near]) / spread
        low, high = np.percentile(here, (2, 98), axis=0)
        if ratio > MAX_JERK and np.linalg.norm(high - low) > MOVES_BY * length:
            return f"node {k} jumps from frame to frame"
        ratios.append(ratio)
    if min(ratios, default=0.0) > MAX_JERK:
        return "no node moves"
    return ""
