"""The nodes through the whole film: from the clearest stretch forwards and backwards, then once more with hindsight.

Circles of all frames are known. The chain found where it is clearest is followed to both ends; the map to the plane of
motion and the links' lengths are learned anew from the whole film, which must confirm the order; what was missed is
looked for again between the places before and after.
"""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from fitting.tracking.detection import Circles
from fitting.tracking.flattening import Flat, flatten, link_lengths
from fitting.tracking.hindsight import Followed, missed, turned
from fitting.tracking.identity import Follower, length_errors
from fitting.tracking.learning import moved
from fitting.tracking.marks import find_marks
from fitting.tracking.ordering import (
    AmbiguousOrderError,
    Chain,
    all_paths,
    changes,
    clearest_chain,
    on_a_line,
    rates,
    resting,
    turn_round,
)
from fitting.tracking.starting import chain_in_line, named_chain

#: Tolerated change of a link [pixel, share, deviations of the chain's own links] once the plane is known.
LENGTH_FLOOR, LENGTH_SHARE, OWN = 0.05, 0.0005, 2.0
#: Changes [tolerances] up to which another order is as good.
AS_GOOD = 3.0
#: Rounds in which map, lengths and order are learned from each other.
ROUNDS = 3


def follow(circles: list[Circles], chain: Chain) -> np.ndarray:
    """Number of each node's circle in each frame (k, n), -1 where not seen, followed from `chain.at` both ways."""
    found = np.full((len(circles), len(chain.places)), -1)
    for way in (1, -1):
        follower = Follower.along(chain, way)
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
    start: np.ndarray | None = None,
    settle: bool = True,
) -> Followed:
    """The nodes through the film.

    Args:
        circles: of all frames [pixel of the video].
        first: where node 0 is.
        start: places (n, 2) [pixel of the video] in the first frame; the order is theirs then.

    Raises:
        SceneError: no chain, or no circles at `start`; AmbiguousOrderError: several orders fit.
    """
    mapped = moved(circles, flat)
    chain = named_chain(mapped, circles, np.asarray(start, float), flat, radius, fps) if start is not None else None
    if chain is None:
        chain, _ = clearest_chain([each.centre for each in mapped], nodes, radius, fps)
    straight = False
    if chain is None:
        chain = chain_in_line(mapped, nodes)
        straight = chain is not None
    if chain is None:
        most = max(len(each) for each in circles)
        raise SceneError(
            f"track: no chain of {nodes} moving markers found among {most} circles; "
            "allowed: --start with the nodes' places in the first frame"
        )
    for _ in range(ROUNDS):
        found = follow(mapped, chain)
        pixels, seen = _places(circles, found)
        flat = flatten(pixels, seen, flat, fps)
        mapped = moved(circles, flat)
        places, _ = _places(mapped, found)
        still = resting(np.where(seen[..., None], places, np.nan), radius, nodes)
        chain, changed = _learn(places, seen, chain, still, start is None and not straight)
        if not changed:
            break
    found = follow(mapped, chain)
    pixels, seen = _places(circles, found)
    places, _ = _places(mapped, found)
    places = np.where(seen[..., None], places, np.nan)
    still = resting(places, radius, nodes)
    if start is None:
        straight = _check_order(places, pixels, seen, still, straight)
    error = np.full(seen.shape, np.nan)
    for i, each in enumerate(circles):
        error[i, seen[i]] = each.error[found[i, seen[i]]]
    marks = find_marks(np.where(seen[..., None], places, 0.0), seen)
    # a single frame between gaps has nothing to confirm it yet: with hindsight it is taken again where it fits
    well = seen & ~marks.swapped & ~marks.jumped
    beside = np.pad(well, ((1, 1), (0, 0)))
    dropped = seen & ~(well & (beside[:-2] | beside[2:]))
    found, seen, error = np.where(dropped, -1, found), seen & ~dropped, np.where(dropped, np.nan, error)
    result = Followed(places, pixels, error, seen, chain, flat, still, straight)
    missed(result, mapped, circles, found)
    if start is None and turn_round(_ends(result), still, first):
        result = turned(result)
    return result


def _ends(found: Followed) -> np.ndarray:
    """Places of the nodes, each where it is first seen."""
    when = np.argmax(found.seen, axis=0)
    return found.flat[when, np.arange(len(when))]


def _places(circles: list[Circles], found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (k, n, 2), zero where not seen, and which are seen (k, n)."""
    seen = found >= 0
    places = np.zeros((*found.shape, 2))
    for i, each in enumerate(circles):
        places[i, seen[i]] = each.centre[found[i, seen[i]]]
    return places, seen


def _learn(places: np.ndarray, seen: np.ndarray, chain: Chain, still: np.ndarray, order: bool) -> tuple[Chain, bool]:
    """The chain as the whole film shows it, and whether it changed so that it must be followed anew."""
    path, changed = np.arange(len(still)), False
    tracks = np.where(seen[..., None], places, np.nan)
    if order and len(still) > 2:
        ratio = _ratio(tracks)
        found = all_paths(ratio, still, AS_GOOD)
        line = on_a_line(tracks) if len(found) > 1 else None
        best = line if line is not None else found[0] if found else path
        if not np.array_equal(best, path) and not np.array_equal(best[::-1], path):
            path, changed = best, True
    tracks, seen = tracks[:, path], seen[:, path]
    both = seen[:, 1:] & seen[:, :-1]
    length = np.where(both, link_lengths(tracks), np.nan)
    new = np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else old for c, old in _pairs(length, chain)])
    spread = np.array([_deviation(c[np.isfinite(c)]) for c in length.T])
    # from the frame that shows all nodes with lengths that fit best
    off = np.where(np.isfinite(length), np.abs(length - new) / np.hypot(0.3, spread), np.inf).max(axis=1)
    at = int(np.argmin(off)) if np.isfinite(off.min()) else chain.at
    if not seen[at].all():
        return chain, False
    changed = changed or bool((np.abs(new - chain.length) > length_errors(chain)).any()) or at != chain.at
    # a node hidden most of the time may have been taken for a reflection that rests
    held = still[path] & (seen.mean(axis=0) > 0.5)
    changed = changed or (held.any() and chain.held is None)
    return Chain(tracks[at], new, 2 * spread, at, rates(tracks, at), held), changed


def _pairs(length: np.ndarray, chain: Chain) -> list[tuple[np.ndarray, float]]:
    return list(zip(length.T, chain.length, strict=True))


def _deviation(values: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else 3.0


def _ratio(tracks: np.ndarray) -> np.ndarray:
    """Changes (n, n) of the distances of all pairs over the film, in what the chain's own links change [tolerances]."""
    change, mean = changes(tracks)
    own = float(np.median(np.diagonal(change, 1)))
    return change / np.maximum(OWN * min(own, 1.0), np.hypot(LENGTH_FLOOR, LENGTH_SHARE * mean))


def _check_order(tracks: np.ndarray, pixels: np.ndarray, seen: np.ndarray, still: np.ndarray, straight: bool) -> bool:
    """Refuse an order beside which the film allows others; returns whether it is known from lying on a line only."""
    nodes = len(still)
    if nodes <= 2 or straight:
        return straight
    found = all_paths(_ratio(tracks), still, AS_GOOD)
    others = [path for path in found if not np.array_equal(path, np.arange(nodes))]
    if not others:
        return False
    line = on_a_line(tracks)
    if line is not None and (np.diff(line) == 1).all() | (np.diff(line) == -1).all():
        return True
    frame = int(np.argmax(seen.sum(axis=1)))
    orders = [pixels[frame, path] for path in [np.arange(nodes), *others]]
    count = f"{len(orders)} orders" if len(orders) < 50 else "many orders"
    raise AmbiguousOrderError(
        f"the order of the nodes is not known: in {count} of the {nodes} circles all links keep their lengths; "
        "allowed: a film in which every joint bends, or --start with the nodes' places in the first frame",
        orders,
        frame,
    )
