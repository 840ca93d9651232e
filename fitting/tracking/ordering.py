"""Which circle is which node: links are rigid, so neighbours are those whose distance does not change.

The circles of the first frames are followed without names. Then the path through them is sought whose steps vary least
in length (Held and Karp's dynamic programme; markers that are still only at its ends), and its lengths are learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dropper_jax.base.errors import SceneError

#: Markers that move less than this share of their radius hang on a held end or on the wall.
STILL = 0.5
#: Spots seen in fewer frames (share) are reflections, not markers, where enough others are there.
OFTEN = 0.5
#: Spots that are followed at most: the search for the path doubles with each.
MOST = 13
#: Weight of a step's own length against its changes: breaks ties only, where nothing moves yet.
LENGTH_WEIGHT = 0.02


@dataclass(frozen=True)
class Chain:
    """The nodes in order at some frame: places (n, 2), lengths of the links and how much they vary (n - 1,) [pixel]."""

    places: np.ndarray
    length: np.ndarray
    spread: np.ndarray


def follow_unnamed(frames: list[np.ndarray], begin: int) -> np.ndarray:
    """Places (k, m, 2) of the spots of frame `begin` in the frames from there on; NaN where one is not seen.

    Args:
        frames: centres (m_i, 2) [pixel] of each frame.
    """
    tracks = [frames[begin]]
    last, rate = frames[begin].copy(), np.zeros_like(frames[begin])
    for centres in frames[begin + 1 :]:
        guess = last + rate
        apart = np.linalg.norm(guess[:, None] - centres[None], axis=-1)
        limit = 8.0 + np.linalg.norm(rate, axis=1)
        now = np.full_like(last, np.nan)
        if len(centres):
            for i, j in zip(*linear_sum_assignment(np.minimum(apart, 1e3)), strict=True):
                if apart[i, j] < limit[i]:
                    now[i] = centres[j]
        seen = np.isfinite(now[:, 0])
        rate = np.where(seen[:, None], now - last, rate)
        last = np.where(seen[:, None], now, guess)
        tracks.append(now)
    return np.stack(tracks)


def order(tracks: np.ndarray, nodes: int, radius: float, first: str = "auto") -> Chain:
    """The chain through the spots.

    Args:
        tracks: (k, m, 2) [pixel] from `follow_unnamed`, m >= nodes.
        nodes: markers of the chain.
        first: where node 0 is: `left`, `right`, `top`, or `auto`: the only still end, else the left one.

    Raises:
        SceneError: no path of that many spots.
    """
    share = np.isfinite(tracks[..., 0]).mean(axis=0)
    often = np.argsort(-share, kind="stable")[:MOST]
    tracks = tracks[:, often[(share[often] >= OFTEN) | (np.arange(len(often)) < nodes)]]
    change, mean = _changes(tracks)
    still = _still(tracks, radius)
    cost = change + LENGTH_WEIGHT * mean / max(float(np.median(mean)), 1e-9) * radius
    path = _path(cost, still, nodes)
    if path is None:
        raise SceneError(
            f"track: no chain of {nodes} moving markers found among {tracks.shape[1]} circles; "
            "allowed: --start with the nodes' places in the first frame"
        )
    if _turn_round(tracks[0, path], still[path], first):
        path = path[::-1]
    pairs = path[:-1], path[1:]
    return Chain(tracks[0, path], mean[pairs], change[pairs])


def _changes(tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Robust deviation and median (m, m) [pixel] of the distances of all pairs."""
    apart = np.linalg.norm(tracks[:, :, None] - tracks[:, None], axis=-1)
    together = np.isfinite(apart).sum(axis=0)
    apart = np.where(together < 2, 0.0, apart)  # pairs never seen together: excluded below
    low, middle, high = np.nanpercentile(apart, (5, 50, 95), axis=0)
    return np.where(together < 2, 1e6, 0.5 * (high - low)), middle


def _still(tracks: np.ndarray, radius: float) -> np.ndarray:
    low, high = np.nanpercentile(tracks, (2, 98), axis=0)
    return np.linalg.norm(high - low, axis=1) < STILL * radius


def _path(cost: np.ndarray, still: np.ndarray, nodes: int) -> np.ndarray | None:
    """The cheapest path of `nodes` spots; still ones only as ends, unless there are too few that move."""
    spots = len(cost)
    ends_only = still.copy() if (~still).sum() >= nodes - 2 and nodes > 2 else np.zeros(spots, bool)
    two_ends = ends_only.sum() >= 2 and (~still).sum() < nodes - 1
    best: dict[tuple[int, int], tuple[float, int]] = {(1 << i, i): (0.0, -1) for i in range(spots)}
    layers = [best]
    for count in range(2, nodes + 1):
        layer: dict[tuple[int, int], tuple[float, int]] = {}
        for (used, tip), (spent, _) in layers[-1].items():
            for j in range(spots):
                if used >> j & 1 or (ends_only[j] and (count < nodes or (ends_only[tip] and nodes > 2))):
                    continue
                key, price = (used | 1 << j, j), spent + cost[tip, j]
                if key not in layer or price < layer[key][0]:
                    layer[key] = (price, tip)
        layers.append(layer)
    finals = layers[-1]
    if two_ends:
        held = [i for i in range(spots) if ends_only[i]]
        both = {key: v for key, v in finals.items() if sum(key[0] >> i & 1 for i in held) == 2}
        finals = both or finals
    if not finals:
        return None
    key = min(finals, key=lambda k: finals[k][0])
    path = [key[1]]
    for layer in reversed(layers[1:]):
        tip = layer[key][1]
        key = (key[0] & ~(1 << key[1]), tip)
        path.append(tip)
    return np.array(path)


def _turn_round(places: np.ndarray, still: np.ndarray, first: str) -> bool:
    """Whether the path is to be read from its other end."""
    if first == "auto":
        if still[0] != still[-1]:
            return bool(still[-1])
        first = "left"
    axis, sign = {"left": (0, 1), "right": (0, -1), "top": (1, 1)}[first]
    return bool(sign * places[0, axis] > sign * places[-1, axis])
