"""Marks of wrong frames: nodes that were swapped, jumped, or violate the lengths of their links.

There are three independent checks. Lengths: a rigid link has a constant length. Names: the positions of each frame are
assigned again from frames without errors, forwards from the first such stretch and backwards from the last; if all
these assignments give a position to another node, nodes were swapped. Jumps: a position is compared with the cubic
through the two before and the two after, without gaps

    p(i) against (4 (p(i-1) + p(i+1)) - (p(i-2) + p(i+2))) / 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import find_objects, label, maximum_filter, median_filter

from fitting.films.detection import Circles
from fitting.films.flattening import robust_lengths
from fitting.films.identity import Follower
from fitting.films.ordering import Chain, distances, rates, steps


@dataclass(frozen=True)
class Marks:
    """Wrong samples.

    Attributes:
        swapped, jumped: (k, n) samples of nodes; length: (k, n - 1) samples of links.
    """

    swapped: np.ndarray
    jumped: np.ndarray
    length: np.ndarray

    @property
    def frames(self) -> np.ndarray:
        """Which frames (k,) are marked."""
        return np.any(self.swapped | self.jumped, axis=1) | np.any(self.length, axis=1)

    @property
    def links(self) -> np.ndarray:
        """Samples of links (k, n - 1) that are unreliable."""
        nodes = self.swapped | self.jumped
        return self.length | nodes[:, 1:] | nodes[:, :-1]

    def spans(self, t: np.ndarray) -> list[dict[str, Any]]:
        """Stretches of marked frames: from_s, to_s [s], nodes, and why (swapped, jumped, length)."""
        found = []
        for part in stretches(self.frames):
            nodes = (self.swapped | self.jumped)[part].any(axis=0)
            links = self.length[part].any(axis=0)
            if not nodes.any():
                nodes = np.append(links, False) | np.insert(links, 0, False)
            found.append(
                {
                    "from_s": float(t[part.start]),
                    "to_s": float(t[part.stop - 1]),
                    "nodes": np.flatnonzero(nodes).tolist(),
                    "why": [name for name in ("swapped", "jumped", "length") if getattr(self, name)[part].any()],
                }
            )
        return found


def stretches(which: np.ndarray) -> list[slice]:
    """Uninterrupted stretches of the frames in a mask (k,)."""
    return [part for (part,) in find_objects(label(which)[0])]


#: Deviation of a length beyond which it is wrong, in robust deviations.
WRONG_LENGTH = 7.0
#: Minimum deviation of a wrong length [pixel].
LENGTH_ERROR = 0.8
#: Minimum deviation of a wrong length as a fraction of it; a missing length is not wrong.
LENGTH_SHARE = 0.015


def find_marks(positions: np.ndarray, detected: np.ndarray) -> Marks:
    """Marks of positions (k, n, 2) [pixel of the plane of motion], `detected` (k, n) of which are measured."""
    lengths, usual, deviation = robust_lengths(positions, detected)
    length = np.abs(lengths - usual) > np.maximum(
        WRONG_LENGTH * deviation, np.hypot(LENGTH_ERROR, LENGTH_SHARE * usual)
    )
    swapped = _swapped_names(positions, detected, length, usual, deviation)
    # samples that are already marked must not make their neighbours in time look wrong
    wrong = swapped.copy()
    wrong[:, 1:] |= length
    wrong[:, :-1] |= length
    return Marks(swapped, _jumps(positions, detected & ~wrong, float(np.median(usual))), length)


def _swapped_names(
    positions: np.ndarray, detected: np.ndarray, wrong: np.ndarray, usual: np.ndarray, deviation: np.ndarray
) -> np.ndarray:
    """Samples (k, n) whose position is assigned to another node when all are named again."""
    parts = stretches(np.all(detected, axis=1) & ~np.any(wrong, axis=1))
    if not parts:
        return np.zeros(detected.shape, bool)
    long = min(12, max(part.stop - part.start for part in parts))
    middles = [(part.start + part.stop) // 2 for part in parts if part.stop - part.start >= long]
    first = middles[0]
    last = middles[-1]
    runs = [(first, len(positions), 1), (first, -1, -1), (last, len(positions), 1), (last, -1, -1)]
    asked = np.zeros(len(positions), int)
    other = np.zeros(detected.shape, int)
    for at, stop, way in runs[:2] if first == last else [runs[0], runs[3], runs[1], runs[2]]:
        rate = rates(np.where(detected[..., None], positions, np.nan), at)
        follower = Follower(Chain(positions[at], usual, 2 * deviation, at, rate), way)
        for i in range(at, stop, way):
            here = np.flatnonzero(detected[i])
            found = follower.advance(Circles(positions[i, here], *[np.zeros(len(here))] * 4))
            asked[i] += 1
            for k in np.flatnonzero(found >= 0):
                if here[found[k]] != k:
                    other[i, here[found[k]]] += 1
    # two nodes closer than 0.05 links may have either name
    near = distances(positions, positions) + 1e9 * np.eye(detected.shape[1])
    alone = near.min(axis=2) > 0.05 * np.median(usual)
    return (other > 0) & (other >= asked[:, None]) & detected & alone


#: The largest jumps are removed and the others checked again.
MOST_JUMPS = 6


#: Deviation from the neighbouring frames beyond which a node has jumped, in usual deviations.
JUMP = 8.0
#: Minimum deviation of a jump, as a fraction of a link.
SMALLEST_JUMP = 0.15


def _jumps(positions: np.ndarray, detected: np.ndarray, length: float) -> np.ndarray:
    """Samples (k, n) off the cubics through the two detected before and the two after them."""
    # number of samples before and after, which give the usual deviation of a position from its neighbours in time
    neighbours = 8
    result = np.zeros(detected.shape, bool)
    for k in range(detected.shape[1]):
        for _ in range(MOST_JUMPS):
            frames = np.flatnonzero(detected[:, k] & ~result[:, k])
            if len(frames) < 2 * neighbours:
                break
            off, apart = off_cubic(frames, positions[frames, k])
            usual = median_filter(off, 2 * neighbours + 1, mode="nearest")
            limit = np.maximum(JUMP * usual, SMALLEST_JUMP * length * (apart / 2) ** 2)
            # if neighbouring samples all look wrong, the worst one is: the others are checked without it
            worst = maximum_filter(off / limit, 5, mode="nearest")
            now = (off > limit) & (off / limit >= worst) & (apart <= 8)
            if not now.any():
                break
            result[frames[now], k] = True
    return result | _out_of_reach(positions, detected & ~result, length)


#: A node cannot move by more than nearly the fastest steps and this number of links.
SPARE_STEP = 0.2


def _out_of_reach(positions: np.ndarray, detected: np.ndarray, length: float) -> np.ndarray:
    """Short runs of samples (k, n) that no node can have reached, also across gaps."""
    result = np.zeros(detected.shape, bool)
    moved = steps(positions, detected)
    if not len(moved):
        return result
    fastest = 1.5 * float(np.percentile(moved, 98))
    for k in range(detected.shape[1]):
        frames = np.flatnonzero(detected[:, k])
        way = np.linalg.norm(np.diff(positions[frames, k], axis=0), axis=-1)
        broken = np.flatnonzero(way > fastest * np.diff(frames) + SPARE_STEP * length) + 1
        for run in np.split(frames, broken):
            if len(run) <= 6 and len(run) < len(frames) / 2:
                result[run, k] = True
    return result


def off_cubic(frames: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (k,) of positions (k, 2) from the cubic through their neighbours; distance of the inner ones."""
    t = frames.astype(float)
    off = np.zeros(len(frames))
    apart = np.full(len(frames), 1e9)
    where = [np.arange(2, len(t) - 2) + step for step in (-2, -1, 1, 2)]
    now = t[2:-2]
    guess = np.zeros((len(now), 2))
    for i in where:
        share = np.ones(len(now))
        for j in where:
            if j is not i:
                share *= (now - t[j]) / (t[i] - t[j])
        guess += share[:, None] * positions[i]
    off[2:-2], apart[2:-2] = np.linalg.norm(positions[2:-2] - guess, axis=1), t[where[2]] - t[where[1]]
    return off, apart
