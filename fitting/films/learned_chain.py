"""The chain as the whole film shows it: lengths and order of its links, and whether another order is as good."""

from __future__ import annotations

import numpy as np

from fitting.films.identity import length_errors
from fitting.films.lengths import robust_lengths
from fitting.films.ordering import (
    AmbiguousOrderError,
    Chain,
    changes,
    on_a_line,
    paths,
    rates,
)

#: Changes [tolerances] up to which another order is equally good.
AS_GOOD = 3.0
#: Tolerance of a length [pixel] and as a fraction of it in such an order, once the plane is known, and its minimum over
#: the usual change of the chain's own links, of which at most 1 pixel counts.
ORDER_CHANGE = 0.05
ORDER_CHANGE_SHARE = 0.0005
ORDER_CHANGE_RATIO = 2.0
#: Variation of the length of a link that is never detected, and noise of a length [pixel].
UNKNOWN_SPREAD = 3.0
LENGTH_NOISE = 0.3
#: Maximum number of orders that are looked for.
MAX_ORDERS = 50


def learn_chain(tracks: np.ndarray, chain: Chain, still: np.ndarray, order: bool) -> tuple[Chain, bool]:
    """The chain according to the whole film, and whether it changed so much that it must be followed again.

    Args:
        tracks: positions of the nodes (k, n, 2), NaN if not detected.
        still: nodes that rest (n,).
        order: whether the order of the nodes is learned too.
    """
    own = np.arange(len(still))
    path = own
    if order and len(still) > 2:
        path = _best_path(tracks, still)
    tracks = tracks[:, path]
    detected = np.isfinite(tracks[..., 0])
    length, new, spread = robust_lengths(tracks)
    known = np.isfinite(length).any(axis=0)
    new = np.where(known, new, chain.length)
    spread = np.where(known, spread, UNKNOWN_SPREAD)
    # from the frame that shows all nodes with the best-fitting lengths
    off = np.nan_to_num(np.abs(length - new) / np.hypot(LENGTH_NOISE, spread), nan=np.inf).max(axis=1)
    at = int(np.argmin(off)) if np.isfinite(off.min()) else chain.at
    if not detected[at].all():
        return chain, False
    # a node that is hidden most of the time may have been mistaken for a resting reflection
    held = still[path] & (detected.mean(axis=0) > 0.5)
    other_lengths = (np.abs(new - chain.length) > length_errors(chain)).any()
    other_rest = held.any() and chain.held is None
    changed = bool(other_lengths or other_rest) or at != chain.at or not np.array_equal(path, own)
    return Chain(tracks[at], new, 2 * spread, at, rates(tracks, at), held), changed


def _best_path(tracks: np.ndarray, still: np.ndarray) -> np.ndarray:
    """The best order of the nodes: of several, that along a line on which they lie; not the reverse of their own."""
    own = np.arange(len(still))
    best, *others = _orders(tracks, still) or [own]
    if others:
        line = on_a_line(tracks)
        if line is not None:
            best = line
    if np.array_equal(best[::-1], own):
        return own
    return best


def _orders(tracks: np.ndarray, still: np.ndarray) -> list[np.ndarray]:
    """The best orders of all nodes in which links keep their lengths as well as those of the chain."""
    change, mean = changes(tracks)
    own = float(np.median(np.diagonal(change, 1)))
    ratio = change / np.maximum(ORDER_CHANGE_RATIO * min(own, 1.0), np.hypot(ORDER_CHANGE, ORDER_CHANGE_SHARE * mean))
    return [path for _, path in paths(ratio, still, len(still), AS_GOOD, MAX_ORDERS)]


def check_order(tracks: np.ndarray, pixels: np.ndarray, still: np.ndarray, straight: bool) -> bool:
    """Reject an ambiguous order; returns whether the order is known only because the nodes lie on a line."""
    nodes = len(still)
    if nodes <= 2 or straight:
        return straight
    own = np.arange(nodes)
    others = [path for path in _orders(tracks, still) if not np.array_equal(path, own)]
    if not others:
        return False
    line = on_a_line(tracks)
    if line is not None and (np.abs(np.diff(line)) == 1).all():
        return True
    frame = int(np.argmax(np.isfinite(tracks[..., 0]).sum(axis=1)))
    orders = [pixels[frame, path] for path in (own, *others)]
    count = "many orders"
    if len(orders) < MAX_ORDERS:
        count = f"{len(orders)} orders"
    raise AmbiguousOrderError(
        f"the order of the nodes is not known: in {count} of the {nodes} circles all links keep their lengths; "
        "use a film in which every joint bends, or --start with the nodes' positions in the first frame",
        orders,
        frame,
    )
