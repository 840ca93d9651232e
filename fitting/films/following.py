"""The nodes through the whole film: from the clearest stretch forwards and backwards, then again with hindsight.

Circles of all frames are known. The chain found where it is clearest is followed to both ends. The map to the plane of
motion and the links' lengths are then learned from the whole film, which must confirm the order. Missed circles are
searched for between the positions before and after.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.films.appearance import map_circles
from fitting.films.detection import Circles
from fitting.films.flattening import Flat, flatten, robust_lengths
from fitting.films.hindsight import TrackedChain, fill_missed, reverse_chain
from fitting.films.identity import Follower, length_errors
from fitting.films.marks import find_marks
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

#: Changes [tolerances] up to which another order is equally good.
AS_GOOD = 3.0


def follow(circles: list[Circles], chain: Chain) -> np.ndarray:
    """Number of each node's circle in each frame (k, n), -1 if not detected, followed from `chain.at` both ways."""
    found = np.full((len(circles), len(chain.positions)), -1)
    for way in (1, -1):
        follower = Follower(chain, way)
        for i in range(chain.at, len(circles) if way > 0 else -1, way):
            found[i] = follower.advance(circles[i])
    return found


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
    mapped = map_circles(circles, flat)
    if start is None:
        chain = clearest_chain([each.centre for each in mapped], nodes, radius, fps)
    else:
        chain = named_chain(mapped, circles, np.asarray(start, float), flat, radius, fps)
    straight = chain is None
    if chain is None:
        chain = chain_in_line(mapped, nodes)
    for _ in range(3):
        found = follow(mapped, chain)
        flat = flatten(_of_nodes([each.centre for each in circles], found), found >= 0, flat, fps)
        mapped = map_circles(circles, flat)
        positions = _of_nodes([each.centre for each in mapped], found)
        still = resting(positions, radius, nodes)
        chain, changed = _learn(positions, chain, still, start is None and not straight)
        if not changed:
            break
    found = follow(mapped, chain)
    detected = found >= 0
    pixels = np.nan_to_num(_of_nodes([each.centre for each in circles], found))
    positions = _of_nodes([each.centre for each in mapped], found)
    still = resting(positions, radius, nodes)
    if start is None:
        straight = _check_order(positions, pixels, still, straight)
    error = _of_nodes([each.error for each in circles], found)
    marks = find_marks(np.nan_to_num(positions), detected)
    # a single frame between gaps has no confirmation yet: with hindsight it is accepted again where it fits
    well = detected & ~marks.swapped & ~marks.jumped
    beside = np.pad(well, ((1, 1), (0, 0)))
    dropped = detected & ~(well & (beside[:-2] | beside[2:]))
    error = np.where(dropped, np.nan, error)
    result = TrackedChain(positions, pixels, error, detected & ~dropped, chain, flat, still, straight)
    fill_missed(result, mapped, circles, np.where(dropped, -1, found))
    if start is None and turn_round(_ends(result), still, first):
        result = reverse_chain(result)
    return result


def _ends(found: TrackedChain) -> np.ndarray:
    """Positions of the nodes, each at its first detection."""
    when = np.argmax(found.detected, axis=0)
    return found.flat[when, np.arange(len(when))]


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
    """
    path = np.arange(len(still))
    changed = False
    if order and len(still) > 2:
        found = _orders(tracks, still)
        line = on_a_line(tracks) if len(found) > 1 else None
        best = found[0] if found else path
        if line is not None:
            best = line
        if not np.array_equal(best, path) and not np.array_equal(best[::-1], path):
            path = best
            changed = True
    tracks = tracks[:, path]
    detected = np.isfinite(tracks[..., 0])
    length, new, spread = robust_lengths(tracks, detected)
    known = np.isfinite(length).any(axis=0)
    new = np.where(known, new, chain.length)
    spread = np.where(known, spread, 3.0)
    # from the frame that shows all nodes with the best-fitting lengths
    off = np.where(np.isfinite(length), np.abs(length - new) / np.hypot(0.3, spread), np.inf).max(axis=1)
    at = chain.at
    if np.isfinite(off.min()):
        at = int(np.argmin(off))
    if not detected[at].all():
        return chain, False
    changed = changed or bool((np.abs(new - chain.length) > length_errors(chain)).any()) or at != chain.at
    # a node that is hidden most of the time may have been mistaken for a resting reflection
    held = still[path] & (detected.mean(axis=0) > 0.5)
    changed = changed or (held.any() and chain.held is None)
    return Chain(tracks[at], new, 2 * spread, at, rates(tracks, at), held), changed


def _orders(tracks: np.ndarray, still: np.ndarray) -> list[np.ndarray]:
    """The best orders of all nodes in which links keep their lengths as well as those of the chain, at most 50."""
    change, mean = changes(tracks)
    own = float(np.median(np.diagonal(change, 1)))
    # tolerance [pixel, fraction, deviations of the chain's own links] once the plane is known
    ratio = change / np.maximum(2.0 * min(own, 1.0), np.hypot(0.05, 0.0005 * mean))
    return [path for _, path in paths(ratio, still, len(still), AS_GOOD, 50)]


def _check_order(tracks: np.ndarray, pixels: np.ndarray, still: np.ndarray, straight: bool) -> bool:
    """Reject an ambiguous order; returns whether the order is known only because the nodes lie on a line."""
    nodes = len(still)
    if nodes <= 2 or straight:
        return straight
    others = [path for path in _orders(tracks, still) if not np.array_equal(path, np.arange(nodes))]
    if not others:
        return False
    line = on_a_line(tracks)
    if line is not None and (np.abs(np.diff(line)) == 1).all():
        return True
    frame = int(np.argmax(np.isfinite(tracks[..., 0]).sum(axis=1)))
    orders = [pixels[frame, path] for path in [np.arange(nodes), *others]]
    count = "many orders"
    if len(orders) < 50:
        count = f"{len(orders)} orders"
    raise AmbiguousOrderError(
        f"the order of the nodes is not known: in {count} of the {nodes} circles all links keep their lengths; "
        "use a film in which every joint bends, or --start with the nodes' positions in the first frame",
        orders,
        frame,
    )


def chain_in_line(circles: list[Circles], nodes: int) -> Chain:
    """The chain of markers in a row, if as many circles as nodes always lie on a line.

    Raises:
        SceneError: otherwise.
    """
    counts = [len(each) for each in circles]
    if nodes in counts:
        at = counts.index(nodes)
        tracks = follow_unnamed([each.centre for each in circles[at:]], 0)
        line = on_a_line(tracks)
        if line is not None:
            change, mean = changes(tracks)
            pairs = line[:-1], line[1:]
            # change of a length [pixel] up to which a row of markers is one line of links
            if (change[pairs] <= 1.0).all():
                return Chain(tracks[0, line], mean[pairs], change[pairs], at)
    raise SceneError(
        f"track: no chain of {nodes} moving markers found among {max(counts)} circles; "
        "use --start with the nodes' positions in the first frame"
    )


def named_chain(
    mapped: list[Circles], circles: list[Circles], named: np.ndarray, flat: Flat, radius: float, fps: float
) -> Chain:
    """The chain given by the user (n, 2) [pixel of the video] in the first frame.

    A position without a circle is that of a hidden marker, if all circles of the frame have a position, or if one
    appears there soon.

    Raises:
        SceneError: a position that is neither.
    """
    # distance of a given position from its circle [radius]
    near_circle = 3.0
    nodes = len(named)
    first = circles[0].centre
    positions = flat(named)
    error = np.zeros(nodes)
    apart = distances(named, first)
    own = np.full(nodes, -1)
    for _ in range(min(apart.shape)):  # the nearest pairs first, no circle twice
        k, j = np.unravel_index(np.argmin(apart), apart.shape)
        if apart[k, j] > near_circle * radius:
            break
        own[k], positions[k] = j, mapped[0].centre[j]
        apart[k], apart[:, j] = np.inf, np.inf
    spare = len(first) - int((own >= 0).sum())
    # a missing circle may appear within half a second
    soon = circles[1 : max(2, round(0.5 * fps))]
    for k in np.flatnonzero(own < 0):
        comes = any(
            np.linalg.norm(each.centre - named[k], axis=1).min(initial=np.inf) <= near_circle * radius for each in soon
        )
        if spare and not comes:
            raise SceneError(
                f"--start: no separate circle found near node {k}; allowed: positions within 3 radii of the circles"
            )
        error[k] = near_circle * radius
    length = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return Chain(positions, length, np.hypot(error[1:], error[:-1]), 0)
