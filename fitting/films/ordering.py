"""Order of the nodes: links are rigid, so neighbours are those whose distance does not change.

The circles of a stretch of the film are followed without names, forwards and backwards from a frame that shows many.
A path through them is a chain if no step changes its length and no step joins two resting circles: fixed ends also keep
their distance. Any stretch may determine the order; the clearest is used, and the whole film must agree
(`following.py`). If several paths keep their lengths, the order is reported as unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from fitting.films.video import spread_out

#: Maximum number of steps in the search for paths.
MAX_PATH_STEPS = 40_000
#: Maximum step of a spot beyond its last one [pixel]: it may have any rate at first, if no other is nearer.
FASTEST_SPOT = 8.0
#: Maximum step of a spot as a fraction of the distance to the next one, and in pixels.
NEXT_SPOT = 0.4
FARTHEST_SPOT = 60.0
#: Fraction of a hidden spot's rate that is kept in every frame: it is no longer where its rate would have carried it.
RATE_DECAY = 0.8
#: Fraction of frames in which a marker is seen; spots that are missing more often are reflections.
MARKER_FRAME_SHARE = 0.5
#: The same if there are too few others.
RARE_MARKER_FRAME_SHARE = 0.1
#: Tolerance of a change of a length [pixel], and as a fraction of it: a slanting camera changes it by some per cent.
LENGTH_CHANGE = 0.5
CHANGE_SHARE = 0.01
#: Durations [s] of the stretches of the film in which a chain is looked for, one after the other.
DURATIONS = (1.0, 2.0, 4.0)
#: Minimum number of frames of such a stretch, and maximum number of stretches of one duration.
FEWEST_FRAMES = 20
MAX_STRETCHES = 16
#: Maximum number of spots among which a chain is looked for, those that are seen most often.
MAX_SPOTS = 13
#: Changes of a length [tolerances] up to which two spots may be joined, tried in this order.
JOINED_CHANGES = (2.0, 4.0, 8.0)
#: Change of a length that is never seen [pixel].
UNKNOWN_CHANGE = 1e6
#: Sum of squared changes [tolerances] by which the second best path must be worse.
CLEARLY_BEST = 9.0
#: Motion [radius] below which a marker hangs on a fixed end or on the wall. The second is used if the first leaves too
#: few moving ones: the noise of a centre is 1 % of a radius.
STILL_MOTION = 0.5
VERY_STILL = 0.12
#: Markers lie on a line to within this fraction of its extent.
ON_A_LINE = 0.03


@dataclass(frozen=True)
class Chain:
    """The nodes in order at some frame.

    Attributes:
        positions: (n, 2) [pixel]; length, spread: of the links and how much they vary (n - 1,) [pixel].
        at: the frame; rate: (n, 2) [pixel per frame] there, or None if unknown.
        held: (n,) nodes known to rest, or None; hidden or not, they keep their positions.
    """

    positions: np.ndarray
    length: np.ndarray
    spread: np.ndarray
    at: int = 0
    rate: np.ndarray | None = None
    held: np.ndarray | None = None


class AmbiguousOrderError(Exception):
    """Several orders of the nodes fit the film.

    Attributes:
        orders: positions of the nodes (n, 2) [pixel of the video] in each order, in one frame.
        frame: its number in the video.
    """

    def __init__(self, message: str, orders: list[np.ndarray], frame: int) -> None:
        super().__init__(message)
        self.orders = orders
        self.frame = frame


def distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances (..., m, n) of points (..., m, 2) from others (..., n, 2)."""
    return np.linalg.norm(one[..., :, None, :] - other[..., None, :, :], axis=-1)


def fast_step(positions: np.ndarray) -> float:
    """98th percentile of the steps from frame to frame of positions (k, n, 2), NaN if not detected; 0 without any."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=-1)
    known = steps[np.isfinite(steps)]
    if not len(known):
        return 0.0
    return float(np.percentile(known, 98))


def follow_unnamed(frames: list[np.ndarray], begin: int) -> np.ndarray:
    """Positions (k, m, 2) of the spots of frame `begin` in all frames from there on; NaN if one is not detected.

    Args:
        frames: centres (m_i, 2) [pixel] of each frame.
    """
    tracks = [frames[begin]]
    last = frames[begin].copy()
    rate = np.zeros_like(frames[begin])
    for centres in frames[begin + 1 :]:
        guess = last + rate
        apart = distances(guess, centres)
        alone = np.minimum(NEXT_SPOT * _alone(last), FARTHEST_SPOT)
        limit = np.maximum(FASTEST_SPOT + np.linalg.norm(rate, axis=1), alone)
        now = np.full_like(last, np.nan)
        if len(centres):
            for i, j in zip(*linear_sum_assignment(np.minimum(apart, 1e3)), strict=True):
                if apart[i, j] < limit[i]:
                    now[i] = centres[j]
        detected = np.isfinite(now)
        rate = np.where(detected, now - last, RATE_DECAY * rate)
        last = np.where(detected, now, guess)
        tracks.append(now)
    return np.stack(tracks)


def _alone(positions: np.ndarray) -> np.ndarray:
    """Distance (m,) of each position (m, 2) to the nearest other one."""
    apart = distances(positions, positions)
    np.fill_diagonal(apart, np.inf)
    return apart.min(axis=1)


def best_chain(tracks: np.ndarray, nodes: int, radius: float, at: int) -> tuple[Chain | None, float]:
    """The chain with the smallest change of its lengths, and the margin to the next best chain.

    Args:
        tracks: (k, m, 2) [pixel] from `follow_unnamed`.
        nodes: markers of the chain.
        at: frame of the chain's positions.
    """
    share = np.isfinite(tracks[..., 0]).mean(axis=0)
    often = np.argsort(-share, kind="stable")[:MAX_SPOTS]
    enough = (share[often] >= MARKER_FRAME_SHARE) | (
        (np.arange(len(often)) < nodes) & (share[often] >= RARE_MARKER_FRAME_SHARE)
    )
    tracks = tracks[:, often[enough]]
    if tracks.shape[1] < nodes:
        return None, 0.0
    change, mean = changes(tracks)
    still = resting(tracks, radius, nodes)
    ratio = change / np.hypot(LENGTH_CHANGE, CHANGE_SHARE * mean)
    for worst in JOINED_CHANGES:
        found = paths(ratio, still, nodes, worst)
        if found:
            cost, path = found[0]
            next_best = found[1][0] if len(found) > 1 else worst**2
            pairs = (path[:-1], path[1:])
            chain = Chain(tracks[at, path], mean[pairs], change[pairs], at, rates(tracks[:, path], at))
            return chain, next_best - cost
    return None, 0.0


def rates(tracks: np.ndarray, at: int) -> np.ndarray | None:
    """Rates (n, 2) [pixel per frame] of tracks (k, n, 2) at a frame, or None if a neighbour in time is missing."""
    if not 0 < at < len(tracks) - 1:
        return None
    found = 0.5 * (tracks[at + 1] - tracks[at - 1])
    if np.isfinite(found).all():
        return found
    return None


def clearest_chain(frames: list[np.ndarray], nodes: int, radius: float, fps: float) -> Chain | None:
    """The chain of the stretch of the film that determines it most clearly, with its frame in `at`."""
    best = None
    clear = -np.inf
    for duration in DURATIONS:
        size = min(len(frames), max(FEWEST_FRAMES, round(duration * fps)))
        for start in spread_out(len(frames) - size + 1, MAX_STRETCHES):
            chain, margin = _chain_of_stretch(frames[start : start + size], nodes, radius)
            if chain is not None and margin > clear and np.isfinite(chain.positions).all():
                best = replace(chain, at=start + chain.at)
                clear = margin
        if clear >= CLEARLY_BEST or size == len(frames):
            break
    return best


def _chain_of_stretch(frames: list[np.ndarray], nodes: int, radius: float) -> tuple[Chain | None, float]:
    """The chain of one stretch of the film, and the margin to the next best one."""
    counts = np.array(list(map(len, frames)))
    if counts.max(initial=0) < nodes:
        return None, 0.0
    # from a frame with at least as many circles as nodes, a number that most others have too
    enough = np.flatnonzero(counts == np.bincount(counts[counts >= nodes]).argmax())
    middle = enough[np.argmin(np.abs(enough - len(frames) // 2))]
    before = follow_unnamed(frames[: middle + 1][::-1], 0)[::-1]
    tracks = np.concatenate([before, follow_unnamed(frames, middle)[1:]])
    return best_chain(tracks, nodes, radius, middle)


def changes(tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Robust deviation and median (m, m) [pixel] of the distances of all pairs.

    The deviation of a pair that is rarely detected together is `UNKNOWN_CHANGE`.
    """
    apart = distances(tracks, tracks)
    few = np.isfinite(apart).sum(axis=0) < max(2, min(10, len(tracks) // 8))
    apart = np.where(few, 0.0, apart)
    low, middle, high = np.nanpercentile(apart, (5, 50, 95), axis=0)
    return np.where(few, UNKNOWN_CHANGE, 0.5 * (high - low)), middle


def resting(tracks: np.ndarray, radius: float, nodes: int) -> np.ndarray:
    """Which spots (m,) always rest."""
    known = np.where(np.isfinite(tracks).any(axis=0), tracks, 0.0)
    low, high = np.nanpercentile(known, (2, 98), axis=0)
    size = np.linalg.norm(high - low, axis=1) / radius
    if (size >= STILL_MOTION).sum() < nodes - 2:
        return size < VERY_STILL
    return size < STILL_MOTION


def paths(
    ratio: np.ndarray, still: np.ndarray, nodes: int, worst: float, most: int = 2
) -> list[tuple[float, np.ndarray]]:
    """The `most` best paths of `nodes` spots, as sums of squares and spots, by branch and bound, depth first.

    Args:
        ratio: (m, m) changes of the distances [tolerances]; steps above `worst` are not links.
        still: (m,) spots that rest: ends only, and never joined with each other.
    """
    near = [np.argsort(row)[: np.sum(row <= worst)].tolist() for row in ratio]
    found: list[tuple[float, tuple[int, ...]]] = []
    stack: list[tuple[float, tuple[int, ...]]] = [(0.0, (i,)) for i in reversed(range(len(ratio)))]
    for _ in range(MAX_PATH_STEPS):
        if not stack:
            break
        cost, path = stack.pop()
        if len(found) == most and cost >= found[-1][0]:
            continue
        if len(path) == nodes:
            if path[0] < path[-1]:  # each path in one direction only
                found = sorted([*found, (cost, path)])[:most]
            continue
        # the nearest spot is tried first
        for j in reversed(near[path[-1]]):
            if j not in path and not (still[j] and (len(path) < nodes - 1 or still[path[-1]])):
                stack.append((cost + ratio[path[-1], j] ** 2, (*path, j)))
    return [(cost, np.array(path)) for cost, path in found]


def on_a_line(tracks: np.ndarray) -> np.ndarray | None:
    """The order (m,) of spots along a line on which they lie in every frame, or None.

    Markers in a row that never bends could be joined otherwise only by links that always overlap.
    """
    whole = tracks[np.isfinite(tracks).all(axis=(1, 2))]
    if not len(whole):
        return None
    middle = whole - whole.mean(axis=1, keepdims=True)
    _, size, axes = np.linalg.svd(middle, full_matrices=False)
    if (size[:, 1] > ON_A_LINE * size[:, 0]).any():
        return None
    orders = np.argsort(np.einsum("kmi,ki->km", middle, axes[:, 0]), axis=1)
    same = (orders == orders[0]).all(axis=1) | (orders == orders[0][::-1]).all(axis=1)
    if same.all():
        return orders[0]
    return None


def turn_round(positions: np.ndarray, still: np.ndarray, first: str) -> bool:
    """Whether a path with `positions` (n, 2), y downwards, must be read from its other end."""
    if first == "auto":
        if still[0] != still[-1]:
            return bool(still[-1])
        first = "left"
    axis, sign = {"left": (0, 1), "right": (0, -1), "top": (1, 1)}[first]
    return bool(sign * positions[0, axis] > sign * positions[-1, axis])
