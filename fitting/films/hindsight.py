"""Recovery of missed circles with hindsight: the positions before and after are known.

A node that is not detected is expected between its positions before and after, shifted to where its links allow. A
circle there that fits their lengths belongs to it, even if it was unassigned, half hidden, or not found at first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import distance_transform_edt

from fitting.films.detection import Circles
from fitting.films.flattening import Flat, detected_links, link_lengths
from fitting.films.identity import bridge, length_errors
from fitting.films.ordering import Chain, distances, steps


@dataclass
class TrackedChain:
    """The nodes in all frames.

    Attributes:
        flat: (k, n, 2) flat pixels, bridged if not detected; pixels: the same in the video's own.
        error: (k, n) standard errors of the circles' fits [pixel]; seen: (k, n).
        chain, map: the results; chain.at is the frame from which it was followed.
        resting: (n,) which nodes rest; straight: the order is known only from lying on a line.
        exposure: [frame] that the lengths show, 0 if none; its effect on `flat` is corrected.
    """

    flat: np.ndarray
    pixels: np.ndarray
    error: np.ndarray
    detected: np.ndarray
    chain: Chain
    map: Flat
    resting: np.ndarray
    straight: bool = False
    exposure: float = 0.0


def reverse_chain(found: TrackedChain) -> TrackedChain:
    """The same chain read from its other end."""
    parts = {name: getattr(found.chain, name) for name in ("positions", "length", "spread", "rate", "held")}
    chain = replace(found.chain, **{name: part[::-1] for name, part in parts.items() if part is not None})
    arrays = {name: getattr(found, name)[:, ::-1] for name in ("flat", "pixels", "error", "detected")}
    return replace(found, **arrays, chain=chain, resting=found.resting[::-1])


def fill_missed(found: TrackedChain, mapped: list[Circles], circles: list[Circles], which: np.ndarray) -> None:
    """Fill in existing circles that were not assigned, and bridge the rest, in place."""

    def free_circles(i: int) -> tuple[np.ndarray, Circles]:
        free = np.setdiff1d(np.arange(len(circles[i])), which[i])
        return mapped[i].centre[free], circles[i].pick(free)

    bridge_gaps(found)
    _take(found, free_circles)
    bridge_gaps(found)


def detect_again(found: TrackedChain, looked: Callable[[int, np.ndarray], Circles]) -> None:
    """Search for undetected nodes at their expected positions; `looked` gives the circles there [pixel, video's]."""

    def there(i: int) -> tuple[np.ndarray, Circles]:
        circles = looked(i, found.pixels[i, ~found.detected[i]])
        apart = distances(circles.centre, found.pixels[i, found.detected[i]])
        circles = circles.pick(np.all(apart > 3.0, axis=1))
        return found.map(circles.centre), circles

    _take(found, there)
    bridge_gaps(found)


def _take(found: TrackedChain, there: Callable[[int], tuple[np.ndarray, Circles]]) -> None:
    """Assign circles to undetected nodes if they fit the expected position and the lengths of the links.

    Args:
        there: flat centres (m, 2) and circles of a frame that may be assigned.
    """
    error = length_errors(found.chain)
    expected = found.flat.copy()
    # frames to the nearest one in which the node itself is detected
    away = distance_transform_edt(~found.detected, sampling=(1.0, 1e6))
    moved = steps(found.flat, found.detected)
    fast = 0.0
    if len(moved):
        fast = 0.2 * float(np.percentile(moved, 98))
    for i in np.flatnonzero((~found.detected).any(axis=1)):
        flat, circles = there(i)
        for k in np.flatnonzero(~found.detected[i]):
            if not len(flat):
                break
            # error [pixel] between samples: there, and per frame from the nearest one
            size = 2.0 + 1.0 * min(away[i, k], 12) + fast * min(away[i, k], 2)
            price = np.linalg.norm(flat - expected[i, k], axis=1) / size
            for j, other in ((k - 1, k - 1), (k, k + 1)):
                if 0 <= other < found.detected.shape[1] and found.detected[i, other]:
                    miss = np.linalg.norm(flat - found.flat[i, other], axis=1) - found.chain.length[j]
                    price = np.maximum(price, np.abs(miss) / error[j])
            best = int(np.argmin(price))
            # standard deviations of position and length up to which a circle is the missed node
            if price[best] < 3.0:
                found.flat[i, k] = flat[best]
                found.pixels[i, k] = circles.centre[best]
                found.error[i, k] = circles.error[best]
                found.detected[i, k] = True
                flat[best] = np.inf  # each circle once


def bridge_gaps(found: TrackedChain) -> None:
    """Put undetected nodes between the positions before and after, shifted towards their links; in place."""
    frames = np.arange(len(found.detected))
    for k in range(found.detected.shape[1]):
        known = found.detected[:, k]
        if known.all():
            continue
        if known.sum() < 2:
            found.flat[~known, k] = found.flat[known, k][0] if known.any() else found.chain.positions[k]
            continue
        # no overshoot in long gaps; before the first and after the last sample the position is constant
        inside = np.clip(frames[~known], frames[known][0], frames[known][-1])
        found.flat[~known, k] = PchipInterpolator(frames[known], found.flat[known, k])(inside)
    error = length_errors(found.chain)
    hidden = ~found.detected
    for i in np.flatnonzero(hidden.any(axis=1)):
        found.flat[i] = bridge(found.flat[i], hidden[i], found.chain.length, error)
    found.pixels[hidden] = found.map.back(found.flat[hidden])


def remove_blur(found: TrackedChain) -> TrackedChain:
    """The positions corrected for a long exposure."""
    share = exposure_share(found.flat, found.detected)
    shift = share * second_differences(found.flat, found.detected)
    return replace(found, flat=found.flat - shift, exposure=float(np.sqrt(24 * share)))


def second_differences(positions: np.ndarray, detected: np.ndarray) -> np.ndarray:
    """Second differences (k, n, 2) of the positions (k, n, 2), zero if a neighbour in time is missing."""
    found = np.zeros_like(positions)
    whole = detected[1:-1] & detected[:-2] & detected[2:]
    found[1:-1] = np.where(whole[..., None], positions[2:] - 2 * positions[1:-1] + positions[:-2], 0.0)
    return found


#: Deviations beyond 3 standard deviations count as much as one there.
OUTLYING = 3.0


def exposure_share(positions: np.ndarray, detected: np.ndarray) -> float:
    """c of the film, 0 if the lengths do not show it; positions (k, n, 2), seen (k, n)."""
    change = second_differences(positions, detected)
    link = np.diff(positions, axis=1)
    length = np.maximum(link_lengths(positions), 1e-9)
    slope = np.sum(np.diff(change, axis=1) * link, axis=-1) / length
    usable = detected & change.any(axis=-1)
    known = detected_links(usable)
    parts = [np.zeros((2, 0))]
    for here, *pair in zip(known.T, slope.T, length.T, strict=True):
        if here.sum() >= 10:
            parts.append(np.stack([values[here] - values[here].mean() for values in pair]))
    x, y = np.concatenate(parts, axis=1)
    if not np.sum(x**2) > 0:
        return 0.0
    weight = np.ones_like(x)
    share = 0.0
    for _ in range(5):
        share = float(np.sum(weight * x * y) / np.sum(weight * x**2))
        off = np.abs(y - share * x)
        scale = 1.4826 * float(np.median(off)) + 1e-9
        weight = np.minimum(1.0, OUTLYING * scale / np.maximum(off, 1e-12))
    error = scale / np.sqrt(np.sum(weight * x**2))
    # at most c of an exposure as long as a frame; below 4 standard errors nothing is corrected
    if share > 4.0 * error:
        return min(share, 1 / 24)
    return 0.0
