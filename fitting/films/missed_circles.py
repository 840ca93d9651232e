"""Recovery of missed circles with hindsight: the positions before and after are known.

A node that is not detected is expected between its positions before and after, shifted to where its links allow. A
circle there that fits their lengths belongs to it, even if it was unassigned, half hidden, or not found at first.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import distance_transform_edt

from fitting.films.detection import Circles, MarkerAppearance, detect_at
from fitting.films.identity import bridge, length_errors
from fitting.films.ordering import distances, fast_step
from fitting.films.tracked_chain import TrackedChain

#: Standard deviations of position and length up to which a circle is the missed node.
ACCEPTED_DEVIATIONS = 3.0
#: Distance from a detected node [pixel] up to which a circle is that node's own: markers are ten pixels wide or more.
SAME_CIRCLE_DISTANCE = 3.0
#: Standard error of a bridged position [pixel]: a little above that of a followed one (`identity.POSITION_ERROR`).
BRIDGED_ERROR = 2.0
#: Its growth per frame from the node's nearest detection [pixel], because its rate in a gap is unknown.
ERROR_PER_FRAME = 1.0
#: Number of frames after which it stays constant: in longer gaps the links' lengths limit the position.
MAX_GROWING_FRAMES = 12
#: Its growth per frame in a fast film, as a fraction of a fast step: a path bends between samples.
FAST_STEP_SHARE = 0.2
#: Number of frames after which that stays constant.
MAX_FAST_FRAMES = 2
#: Distance of neighbouring nodes [frame] in the search for the nearest detection: above the length of any film, so that
#: only the node's own detections count.
NODE_DISTANCE = 1e6


def fill_missed(found: TrackedChain, mapped: list[np.ndarray], circles: list[Circles], which: np.ndarray) -> None:
    """Fill in existing circles that were not assigned, and bridge the rest, in place.

    Args:
        mapped: centres of the circles of each frame in the plane of motion.
        which: numbers of the circles that are assigned (k, n), -1 for none.
    """
    bridge_gaps(found)
    error = _bridged_errors(found)
    for i in np.flatnonzero((~found.detected).any(axis=1)):
        free = np.setdiff1d(np.arange(len(circles[i])), which[i])
        _assign_circles(found, i, error[i], mapped[i][free], circles[i].pick(free))
    bridge_gaps(found)


def detect_again(found: TrackedChain, images: Iterable[np.ndarray], appearance: MarkerAppearance) -> None:
    """Search the frames themselves, in order, for undetected nodes at their expected positions, mainly half hidden."""
    error = _bridged_errors(found)
    hidden = np.any(~found.detected, axis=1)
    stop = int(np.max(np.flatnonzero(hidden), initial=-1)) + 1  # later frames need not be read
    for i, image in enumerate(islice(images, stop)):
        if hidden[i]:
            circles = detect_at(image, appearance, found.pixels[i, ~found.detected[i]])
            apart = distances(circles.centre, found.pixels[i, found.detected[i]])
            circles = circles.pick(np.all(apart > SAME_CIRCLE_DISTANCE, axis=1))
            _assign_circles(found, i, error[i], found.map(circles.centre), circles)
    bridge_gaps(found)


def _bridged_errors(found: TrackedChain) -> np.ndarray:
    """Standard errors of the positions of undetected nodes (k, n) [pixel]."""
    frames = distance_transform_edt(~found.detected, sampling=(1.0, NODE_DISTANCE))
    slow = BRIDGED_ERROR + ERROR_PER_FRAME * np.minimum(frames, MAX_GROWING_FRAMES)
    fast = FAST_STEP_SHARE * fast_step(found.where_detected(found.flat))
    return slow + fast * np.minimum(frames, MAX_FAST_FRAMES)


def _assign_circles(found: TrackedChain, i: int, error: np.ndarray, flat: np.ndarray, circles: Circles) -> None:
    """Assign circles of frame i to undetected nodes if they fit the bridged position and the links' lengths; in place.

    Args:
        error: of the bridged positions (n,) [pixel].
        flat: centres (m, 2) of the circles in the plane of motion; an assigned one is set to infinity.
    """
    if not len(flat):
        return
    expected = found.flat[i].copy()
    length_error = length_errors(found.chain)
    for k in np.flatnonzero(~found.detected[i]):
        cost = np.linalg.norm(flat - expected[k], axis=1) / error[k]
        for j, other in ((k - 1, k - 1), (k, k + 1)):
            if 0 <= j < len(length_error) and found.detected[i, other]:
                miss = np.linalg.norm(flat - found.flat[i, other], axis=1) - found.chain.length[j]
                cost = np.maximum(cost, np.abs(miss) / length_error[j])
        best = np.argmin(cost)
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
