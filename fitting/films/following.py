"""The nodes through the whole film: from the clearest stretch forwards and backwards, then again with hindsight.

Circles of all frames are known. The chain found where it is clearest is followed to both ends. The map to the plane of
motion and the links' lengths are then learned from the whole film, which must confirm the order. Missed circles are
searched for between the positions before and after.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.films.detection import Circles
from fitting.films.flat_map import Flat
from fitting.films.flattening import flatten
from fitting.films.identity import follow, length_errors
from fitting.films.lengths import robust_lengths
from fitting.films.marks import find_marks
from fitting.films.missed_circles import fill_missed
from fitting.films.ordering import (
    AmbiguousOrderError,
    Chain,
    changes,
    clearest_chain,
    distances,
    follow_unnamed,
    on_a_line,
    paths,
    rates,
    resting,
    turn_round,
)
from fitting.films.tracked_chain import TrackedChain, reverse_chain

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
#: Change of a length [pixel] up to which a row of markers is one line of links.
LINE_CHANGE = 1.0
#: Maximum distance of a given position from its circle [radius].
NEAR_CIRCLE = 3.0


def follow_film(
    circles: list[Circles],
    nodes: int,
    radius: float,
    fps: float,
    flat: Flat,
    first: str = "auto",
    start: Sequence[tuple[float, float]] | None = None,
) -> TrackedChain:
    """The nodes through the film.

    Args:
        circles: of all frames [pixel of the video].
        first: where node 0 is.
        start: positions (n, 2) [pixel of the video] in the first frame; they define the order.

    Raises:
        SceneError: no chain, or no circles at `start`; AmbiguousOrderError: several orders fit.
    """
    # circles beyond the horizon of the plane are not in it
    circles = [each.pick(np.all(np.isfinite(flat(each.centre)), axis=1)) for each in circles]
    centres = [each.centre for each in circles]
    mapped = map_centres(centres, flat)
    straight = False
    if start is None:
        chain = clearest_chain(mapped, nodes, radius, fps)
        if chain is None:
            chain = chain_in_line(mapped, nodes)
            straight = True
    else:
        chain = named_chain(mapped, centres, np.asarray(start, float), flat, radius, fps)
    for _ in range(3):  # usually one is enough
        found = follow(mapped, chain)
        flat = flatten(_of_nodes(centres, found), flat, fps)
        mapped = map_centres(centres, flat)
        positions = _of_nodes(mapped, found)
        chain, changed = _learn(positions, chain, resting(positions, radius, nodes), start is None and not straight)
        if not changed:
            break
    found = follow(mapped, chain)
    pixels = np.nan_to_num(_of_nodes(centres, found))
    positions = _of_nodes(mapped, found)
    still = resting(positions, radius, nodes)
    if start is None:
        straight = _check_order(positions, pixels, still, straight)
    detected = _confirmed(found, positions)
    found = np.where(detected, found, -1)
    error = _of_nodes([each.error for each in circles], found)
    result = TrackedChain(positions, pixels, error, detected, chain, flat, still, straight)
    fill_missed(result, mapped, circles, found)
    # positions of the nodes, each at its first detection
    begin = result.flat[np.argmax(result.detected, axis=0), np.arange(nodes)]
    if start is None and turn_round(begin, still, first):
        result = reverse_chain(result)
    return result


def _confirmed(found: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Which nodes (k, n) are detected without a mark, in this frame and in the one before or after.

    A single frame between gaps has no confirmation yet: with hindsight it is accepted again where it fits.
    """
    well = (found >= 0) & ~find_marks(np.nan_to_num(positions), found >= 0).nodes
    beside = np.pad(well, ((1, 1), (0, 0)))
    return well & (beside[:-2] | beside[2:])


def map_centres(centres: list[np.ndarray], to: Callable[[np.ndarray], np.ndarray]) -> list[np.ndarray]:
    """The centres of the circles (m, 2) of each frame, mapped by `to`: points (m, 2) to points (m, 2)."""
    return np.split(to(np.concatenate(centres)), np.cumsum(list(map(len, centres)))[:-1])


def _of_nodes(values: list[np.ndarray], found: np.ndarray) -> np.ndarray:
    """Values (k, n, ...) of the nodes' circles in each frame, NaN if a node is not detected."""
    result = np.full((*found.shape, *values[0].shape[1:]), np.nan)
    for row, each, numbers in zip(result, values, found, strict=True):
        row[numbers >= 0] = each[numbers[numbers >= 0]]
    return result


def _learn(tracks: np.ndarray, chain: Chain, still: np.ndarray, order: bool) -> tuple[Chain, bool]:
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


def _check_order(tracks: np.ndarray, pixels: np.ndarray, still: np.ndarray, straight: bool) -> bool:
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


def chain_in_line(centres: list[np.ndarray], nodes: int) -> Chain:
    """The chain of markers in a row, if as many circles as nodes always lie on a line.

    Raises:
        SceneError: otherwise.
    """
    counts = list(map(len, centres))
    if nodes in counts:
        at = counts.index(nodes)
        tracks = follow_unnamed(centres, at)
        line = on_a_line(tracks)
        if line is not None:
            change, mean = changes(tracks)
            pairs = (line[:-1], line[1:])
            if (change[pairs] <= LINE_CHANGE).all():
                return Chain(tracks[0, line], mean[pairs], change[pairs], at)
    raise SceneError(
        f"track: no chain of {nodes} moving markers found among {max(counts)} circles; "
        "use --start with the nodes' positions in the first frame"
    )


def named_chain(
    mapped: list[np.ndarray], centres: list[np.ndarray], named: np.ndarray, flat: Flat, radius: float, fps: float
) -> Chain:
    """The chain given by the user (n, 2) [pixel of the video] in the first frame.

    A position without a circle is that of a hidden marker, if all circles of the frame have a position, or if one
    appears there soon.

    Raises:
        SceneError: a position that is neither.
    """
    near_circle = NEAR_CIRCLE * radius
    positions = flat(named)
    apart = distances(named, centres[0])
    error = np.full(len(named), near_circle)
    for _ in range(min(apart.shape)):  # the nearest pairs first, no circle twice
        k, j = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[k, j] > near_circle:
            break
        positions[k] = mapped[0][j]
        error[k] = 0.0
        apart[k] = np.inf
        apart[:, j] = np.inf
    missing = np.flatnonzero(error)
    # a missing circle may appear within half a second
    soon = np.concatenate([centres[0][:0], *centres[1 : max(2, round(0.5 * fps))]])
    away = distances(named, soon).min(axis=1, initial=np.inf)
    for k in missing[away[missing] > near_circle]:
        if len(centres[0]) > len(named) - len(missing):
            raise SceneError(
                f"--start: no separate circle found near node {k}; allowed: positions within 3 radii of the circles"
            )
    length = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return Chain(positions, length, np.hypot(error[1:], error[:-1]), 0)
