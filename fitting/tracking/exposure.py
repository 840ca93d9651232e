"""What a long exposure does to places, found from the links' lengths and taken back.

A blurred disc stands where it was on average. To leading order that is off by the acceleration,

    p = r + r'' e^2/24,

e the exposure. With D the second difference of the places from frame to frame, p = r + c D, c = (e fps)^2/24. Along a
link of length l that turns at w it is short by c l w^2/fps^2, whatever else moves: so the lengths tell c.
"""

from __future__ import annotations

import numpy as np

from fitting.tracking.flattening import link_lengths

#: c of an exposure as long as a frame; significance [standard errors] below which nothing is taken back.
LONGEST, SIGNIFICANT = 1 / 24, 4.0
#: Passes that weigh anew; departures beyond this many deviations count as much as one there.
PASSES, CLIP = 5, 3.0


def second_differences(places: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Second differences (k, n, 2) of the places (k, n, 2), zero where a neighbour in time is not seen."""
    found = np.zeros_like(places)
    whole = seen[1:-1] & seen[:-2] & seen[2:]
    found[1:-1] = np.where(whole[..., None], places[2:] - 2 * places[1:-1] + places[:-2], 0.0)
    return found


def exposure_share(places: np.ndarray, seen: np.ndarray) -> float:
    """c of the film, 0 where the lengths do not show it; places (k, n, 2), seen (k, n)."""
    change = second_differences(places, seen)
    link = np.diff(places, axis=1)
    length = np.maximum(link_lengths(places), 1e-9)
    slope = np.sum(np.diff(change, axis=1) * link, axis=-1) / length
    moving = (np.abs(change).sum(axis=-1) > 0)[:, 1:] & (np.abs(change).sum(axis=-1) > 0)[:, :-1]
    known = seen[:, 1:] & seen[:, :-1] & moving
    x, y = [], []
    for j in range(known.shape[1]):
        here = known[:, j]
        if here.sum() >= 10:
            x.append(slope[here, j] - slope[here, j].mean())
            y.append(length[here, j] - length[here, j].mean())
    if not x:
        return 0.0
    x, y = np.concatenate(x), np.concatenate(y)
    if not np.sum(x**2) > 0:
        return 0.0
    weight, share = np.ones_like(x), 0.0
    for _ in range(PASSES):
        share = float(np.sum(weight * x * y) / np.sum(weight * x**2))
        off = np.abs(y - share * x)
        scale = 1.4826 * float(np.median(off)) + 1e-9
        weight = np.minimum(1.0, CLIP * scale / np.maximum(off, 1e-12))
    error = scale / np.sqrt(np.sum(weight * x**2))
    return min(share, LONGEST) if share > SIGNIFICANT * error else 0.0
