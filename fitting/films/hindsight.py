"""Recovery of missed circles with hindsight: the positions before and after are known.

A node that is not detected is expected between its positions before and after, shifted to where its links allow. A
circle there that fits their lengths belongs to it, even if it was unassigned, half hidden, or not found at first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import distance_transform_edt

from fitting.films.detection import Circles, MarkerAppearance, detect_at
from fitting.films.flattening import Flat, link_lengths
from fitting.films.identity import bridge, length_errors
from fitting.films.ordering import Chain, distances, fast_step

#: Standard deviations of position and length up to which a circle is the missed node.
ACCEPTED_DEVIATIONS = 3.0
#: Deviations beyond this number of standard deviations count as much as one there.
OUTLYING_DEVIATIONS = 3.0


@dataclass
class TrackedChain:
    """The nodes in all frames.

    Attributes:
        flat: (k, n, 2) flat pixels, bridged if not detected; pixels: the same in the video's own.
        error: (k, n) standard errors of the circles' fits [pixel]; detected: (k, n).
        chain: the links, as the whole film shows them; chain.at is the frame from which it was followed.
        map: from pixels to the plane, by the whole film.
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

    def where_detected(self, positions: np.ndarray) -> np.ndarray:
        """`flat` or `pixels`, NaN if not detected."""
        return np.where(self.detected[..., None], positions, np.nan)

    def pick(self, frames: slice = slice(None), nodes: slice = slice(None)) -> TrackedChain:
        """Some frames or nodes of its samples."""
        arrays = {name: getattr(self, name)[frames, nodes] for name in ("flat", "pixels", "error", "detected")}
        return replace(self, **arrays)


def reverse_chain(found: TrackedChain) -> TrackedChain:
    """The same chain read from its other end."""
    parts = {name: getattr(found.chain, name) for name in ("positions", "length", "spread", "rate", "held")}
    chain = replace(found.chain, **{name: part[::-1] for name, part in parts.items() if part is not None})
    return replace(found.pick(nodes=slice(None, None, -1)), chain=chain, resting=found.resting[::-1])


def fill_missed(found: TrackedChain, mapped: list[np.ndarray], circles: list[Circles], which: np.ndarray) -> None:
    """Fill in existing circles that were not assigned, and bridge the rest, in place.

    Args:
        mapped: centres of the circles of each frame in the plane of motion.
        which: numbers of the circles that are assigned (k, n), -1 for none.
    """

    def free_circles(i: int) -> tuple[np.ndarray, Circles]:
        free = np.setdiff1d(np.arange(len(circles[i])), which[i])
        return mapped[i][free], circles[i].pick(free)

    bridge_gaps(found)
    _take(found, free_circles)
    bridge_gaps(found)


def detect_again(found: TrackedChain, images: Iterable[np.ndarray], appearance: MarkerAppearance) -> None:
    """Search the frames themselves, in order, for undetected nodes at their expected positions, mainly half hidden."""
    numbered = enumerate(images)

    def there(i: int) -> tuple[np.ndarray, Circles]:
        image = next(image for number, image in numbered if number == i)  # frames are asked for in their order
        circles = detect_at(image, appearance, found.pixels[i, ~found.detected[i]])
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
    fast = 0.2 * fast_step(found.where_detected(found.flat))
    for i in np.flatnonzero((~found.detected).any(axis=1)):
        flat, circles = there(i)
        if not len(flat):
            continue
        for k in np.flatnonzero(~found.detected[i]):
            # error [pixel] between samples: there, and per frame from the nearest one
            size = 2.0 + 1.0 * min(away[i, k], 12) + fast * min(away[i, k], 2)
            cost = np.linalg.norm(flat - expected[i, k], axis=1) / size
            for j, other in ((k - 1, k - 1), (k, k + 1)):
                if 0 <= j < len(error) and found.detected[i, other]:
                    miss = np.linalg.norm(flat - found.flat[i, other], axis=1) - found.chain.length[j]
                    cost = np.maximum(cost, np.abs(miss) / error[j])
            best = int(np.argmin(cost))
            if cost[best] < ACCEPTED_DEVIATIONS:
                found.flat[i, k] = flat[best]
                found.pixels[i, k] = circles.centre[best]
                found.error[i, k] = circles.error[best]
                found.detected[i, k] = True
                flat[best] = np.inf  # each circle once


def bridge_gaps(found: TrackedChain) -> None:
    """Put undetected nodes between the positions before and after, shifted towards their links; in place."""
    frames = np.arange(len(found.detected))
    hidden = ~found.detected
    for k, gaps in enumerate(hidden.T):
        known = frames[~gaps]
        positions = found.flat[known, k]
        if len(known) > 1:
            # no overshoot in long gaps; before the first and after the last sample the position is constant
            inside = np.clip(frames[gaps], known[0], known[-1])
            found.flat[gaps, k] = PchipInterpolator(known, positions)(inside)
        elif len(known):
            found.flat[gaps, k] = positions[0]
        else:
            found.flat[gaps, k] = found.chain.positions[k]
    error = length_errors(found.chain)
    for i in np.flatnonzero(hidden.any(axis=1)):
        found.flat[i] = bridge(found.flat[i], hidden[i], found.chain.length, error)
    found.pixels[hidden] = found.map.back(found.flat[hidden])


def remove_blur(found: TrackedChain) -> TrackedChain:
    """The positions corrected for a long exposure.

    A frame exposed for T frames shows the mean position, `p + c d^2p/dt^2` with `c = T^2/24`, of a motion p(t).
    """
    positions = found.where_detected(found.flat)
    share = exposure_share(positions)
    shift = share * second_differences(positions)
    return replace(found, flat=found.flat - shift, exposure=float(np.sqrt(24 * share)))


def second_differences(positions: np.ndarray) -> np.ndarray:
    """Second differences (k, n, 2) of the positions (k, n, 2), zero if a neighbour in time is missing (NaN)."""
    return np.pad(np.nan_to_num(np.diff(positions, 2, axis=0)), ((1, 1), (0, 0), (0, 0)))


def exposure_share(positions: np.ndarray) -> float:
    """c of the film (see `remove_blur`), 0 if the lengths do not show it.

    A blurred link d has the length `l + c d'' d/|d|`, of a constant l: c is a robust slope.

    Args:
        positions: (k, n, 2), NaN if not detected.
    """
    change = second_differences(positions)
    usable = np.where(change.any(axis=-1, keepdims=True), positions, np.nan)
    length = np.maximum(link_lengths(usable), 1e-9)
    slope = np.sum(np.diff(change, axis=1) * np.diff(positions, axis=1), axis=-1) / length
    parts = [np.zeros((2, 0))]
    for pair in np.stack([slope, length]).transpose(2, 0, 1):
        known = pair[:, np.isfinite(pair[1])]
        if known.shape[1] >= 10:
            parts.append(known - known.mean(axis=1, keepdims=True))
    x, y = np.concatenate(parts, axis=1)
    if not np.sum(x**2) > 0:
        return 0.0
    weight = np.ones_like(x)
    share = 0.0
    for _ in range(5):
        share = float(np.sum(weight * x * y) / np.sum(weight * x**2))
        off = np.abs(y - share * x)
        scale = 1.4826 * float(np.median(off)) + 1e-9
        weight = np.minimum(1.0, OUTLYING_DEVIATIONS * scale / np.maximum(off, 1e-12))
    error = scale / np.sqrt(np.sum(weight * x**2))
    if not share > 4.0 * error:  # standard errors; true for NaN as well
        return 0.0
    return min(share, 1 / 24)  # that of an exposure as long as a frame
