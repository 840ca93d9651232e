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

from fitting.films.identity import follow
from fitting.films.lengths import robust_lengths
from fitting.films.ordering import Chain, distances, fast_step, rates

#: Deviation of a length beyond which it is wrong, in robust deviations.
WRONG_LENGTH = 7.0
#: Minimum deviation of a wrong length [pixel], and as a fraction of it; a missing length is not wrong.
LENGTH_ERROR = 0.8
LENGTH_SHARE = 0.015
#: Distance [links] below which two nodes may have either name.
EITHER_NAME = 0.05
#: The largest jumps are removed and the others checked again, at most this number of times.
MAX_JUMPS = 6
#: Deviation from the neighbouring frames beyond which a node has jumped, in usual deviations.
JUMP_DEVIATIONS = 8.0
#: Minimum deviation of a jump, as a fraction of a link.
SMALLEST_JUMP = 0.15
#: Number of samples before and after, which give the usual deviation of a position from its neighbours in time.
NEIGHBOURS = 8
#: Maximum distance of the inner neighbours in time from which a jump is detected [frame].
FARTHEST_NEIGHBOURS = 8
#: A node cannot move by more than this number of fast steps and of links.
FAST_STEPS = 1.5
SPARE_STEP = 0.2
#: Maximum number of samples of an unreachable run.
LONGEST_RUN = 6
#: Number of frames without errors from which nodes are named again, if any stretch has as many.
LONG_STRETCH = 12


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
    def nodes(self) -> np.ndarray:
        """Samples of nodes (k, n) that are wrong."""
        return self.swapped | self.jumped

    @property
    def frames(self) -> np.ndarray:
        """Which frames (k,) are marked."""
        return np.any(self.links, axis=1)

    @property
    def links(self) -> np.ndarray:
        """Samples of links (k, n - 1) that are unreliable."""
        return self.length | self.nodes[:, 1:] | self.nodes[:, :-1]

    def spans(self, t: np.ndarray) -> list[dict[str, Any]]:
        """Stretches of marked frames: from_s, to_s [s], nodes, and why (swapped, jumped, length)."""
        kinds = {"swapped": self.swapped, "jumped": self.jumped, "length": self.length}
        found = []
        for part in stretches(self.frames):
            nodes = self.nodes[part].any(axis=0)
            if not nodes.any():
                nodes = _ends_of(self.length[part]).any(axis=0)
            span = {"from_s": float(t[part.start]), "to_s": float(t[part.stop - 1])}
            why = [name for name, marked in kinds.items() if marked[part].any()]
            found.append({**span, "nodes": np.flatnonzero(nodes).tolist(), "why": why})
        return found


def _ends_of(links: np.ndarray) -> np.ndarray:
    """Which nodes (k, n) are at an end of the links in a mask (k, n - 1)."""
    wide = np.pad(links, ((0, 0), (1, 1)))
    return wide[:, 1:] | wide[:, :-1]


def stretches(which: np.ndarray) -> list[slice]:
    """Uninterrupted stretches of the frames in a mask (k,)."""
    return [part for (part,) in find_objects(label(which)[0])]


def find_marks(positions: np.ndarray, detected: np.ndarray) -> Marks:
    """Marks of positions (k, n, 2) [pixel of the plane of motion], `detected` (k, n) of which are measured."""
    known = np.where(detected[..., None], positions, np.nan)
    lengths, usual, deviation = robust_lengths(known)
    least = np.hypot(LENGTH_ERROR, LENGTH_SHARE * usual)
    length = np.abs(lengths - usual) > np.maximum(WRONG_LENGTH * deviation, least)
    near = distances(positions, positions) + 1e9 * np.eye(len(usual) + 1) <= EITHER_NAME * np.median(usual)
    swapped = _swapped_names(known, length, usual, deviation) & ~near.any(axis=2)
    # samples that are already marked must not make their neighbours in time look wrong
    wrong = swapped | _ends_of(length)
    jumped = _jumps(np.where(wrong[..., None], np.nan, known), np.median(usual))
    return Marks(swapped, jumped, length)


def _swapped_names(positions: np.ndarray, wrong: np.ndarray, usual: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Samples (k, n) whose position is assigned to another node when all are named again."""
    detected = np.isfinite(positions[..., 0])
    swapped = detected.copy()
    parts = stretches(np.all(detected, axis=1) & ~np.any(wrong, axis=1))
    if not parts:
        return np.zeros_like(swapped)
    long = min(LONG_STRETCH, max(part.stop - part.start for part in parts))
    middles = [(part.start + part.stop) // 2 for part in parts if part.stop - part.start >= long]
    centres = [here[known] for here, known in zip(positions, detected, strict=True)]
    circle = np.where(detected, np.cumsum(detected, axis=1) - 1, -2)
    for at in {middles[0], middles[-1]}:
        found = follow(centres, Chain(positions[at], usual, 2 * deviation, at, rates(positions, at)))
        # by frame, which node got the circle of which one
        given = found[:, :, None] == circle[:, None]
        swapped &= (given & ~np.eye(len(usual) + 1, dtype=bool)).any(axis=1)
    return swapped


def _jumps(positions: np.ndarray, length: float) -> np.ndarray:
    """Samples (k, n) off the cubics through the two detected before and the two after them."""
    detected = np.isfinite(positions[..., 0])
    result = np.zeros_like(detected)
    for k in range(detected.shape[1]):
        for _ in range(MAX_JUMPS):
            frames = np.flatnonzero(detected[:, k] & ~result[:, k])
            if len(frames) < 2 * NEIGHBOURS:
                break
            off, apart = off_cubic(frames, positions[frames, k])
            usual = median_filter(off, 2 * NEIGHBOURS + 1, mode="nearest")
            limit = np.maximum(JUMP_DEVIATIONS * usual, SMALLEST_JUMP * length * (apart / 2) ** 2)
            # if neighbouring samples all look wrong, the worst one is: the others are checked without it
            worst = maximum_filter(off / limit, 5, mode="nearest")
            now = (off > limit) & (off / limit >= worst) & (apart <= FARTHEST_NEIGHBOURS)
            if not now.any():
                break
            result[frames[now], k] = True
    return result | _out_of_reach(np.where(result[..., None], np.nan, positions), length)


def _out_of_reach(positions: np.ndarray, length: float) -> np.ndarray:
    """Short runs of samples (k, n) that no node can have reached, also across gaps."""
    detected = np.isfinite(positions[..., 0])
    result = np.zeros_like(detected)
    fastest = FAST_STEPS * fast_step(positions)
    if not fastest:
        return result
    for k in range(detected.shape[1]):
        frames = np.flatnonzero(detected[:, k])
        moved = np.linalg.norm(np.diff(positions[frames, k], axis=0), axis=-1)
        broken = np.flatnonzero(moved > fastest * np.diff(frames) + SPARE_STEP * length) + 1
        for run in np.split(frames, broken):
            if len(run) <= LONGEST_RUN and len(run) < len(frames) / 2:
                result[run, k] = True
    return result


def off_cubic(frames: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (k,) of positions (k, 2) from the cubic through their neighbours; distance of the inner ones."""
    off = np.zeros(len(frames))
    apart = np.full(len(frames), 1e9)
    inner = np.arange(2, len(frames) - 2)
    near = [inner + step for step in (-2, -1, 1, 2)]
    times = [frames[i] - frames[inner] for i in near]
    guess = np.zeros((len(inner), 2))
    for i, own in zip(near, times, strict=True):
        share = np.prod([t / (t - own) for t in times if t is not own], axis=0)
        guess += share[:, None] * positions[i]
    off[inner] = np.linalg.norm(positions[inner] - guess, axis=1)
    apart[inner] = times[2] - times[1]
    return off, apart
