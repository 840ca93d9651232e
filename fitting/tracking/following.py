"""The nodes through the whole film: from the clearest stretch forwards and backwards, then once more with hindsight.

Circles of all frames are known. The chain found where it is clearest is followed to both ends; the map to the plane of
motion and the links' lengths are learned anew from the whole film, which must confirm the order; what was missed is
looked for again between the places before and after.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from dropper_jax.base.errors import SceneError
from fitting.tracking.detection import Circles
from fitting.tracking.exposure import exposure_share, second_differences
from fitting.tracking.flattening import Flat, flatten, link_lengths
from fitting.tracking.identity import Follower, bridge, length_errors
from fitting.tracking.learning import moved
from fitting.tracking.ordering import (
    AmbiguousOrderError,
    Chain,
    all_paths,
    changes,
    clearest_chain,
    follow_unnamed,
    on_a_line,
    rates,
    resting,
    turn_round,
)

#: Tolerated change of a link [pixel, share, deviations of the chain's own links] once the plane is known.
LENGTH_FLOOR, LENGTH_SHARE, OWN = 0.05, 0.0005, 2.0
#: Changes [tolerances] up to which another order is as good.
AS_GOOD = 3.0
#: Rounds in which map, lengths and order are learned from each other.
ROUNDS = 3
#: Expected places between samples: error [pixel] there, and per frame from the nearest one, at most so many.
HINDSIGHT, PER_FRAME, FRAMES = 2.0, 1.0, 12
#: Departures [standard deviations] of place and length up to which a circle is the node that was missed.
GATE = 3.0


@dataclass
class Followed:
    """The nodes in all frames.

    Attributes:
        flat: (k, n, 2) flat pixels, bridged where not seen; pixels: the same in the video's own.
        error: (k, n) standard errors of the circles' fits [pixel]; seen: (k, n).
        chain, map: what was learned; chain.at is the frame from which it was followed.
        resting: (n,) which nodes rest; straight: the order is known only from lying on a line.
        exposure: [frame] that the lengths show, 0 where none; its effect on `flat` is taken back.
    """

    flat: np.ndarray
    pixels: np.ndarray
    error: np.ndarray
    seen: np.ndarray
    chain: Chain
    map: Flat
    resting: np.ndarray
    straight: bool = False
    exposure: float = 0.0


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
    chain = _start(mapped, circles, np.asarray(start, float), flat, radius, fps) if start is not None else None
    if chain is None:
        chain, _ = clearest_chain([each.centre for each in mapped], nodes, radius, fps)
    straight = False
    if chain is None:
        chain = _in_line(mapped, nodes)
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
    result = Followed(places, pixels, error, seen, chain, flat, still, straight)
    missed(result, mapped, circles, found)
    if start is None and turn_round(_ends(result), still, first):
        result = turned(result)
    return result


def turned(found: Followed) -> Followed:
    """The same chain read from its other end."""
    old = found.chain
    rate = None if old.rate is None else old.rate[::-1]
    held = None if old.held is None else old.held[::-1]
    chain = Chain(old.places[::-1], old.length[::-1], old.spread[::-1], old.at, rate, held)
    arrays = (a[:, ::-1] for a in (found.flat, found.pixels, found.error, found.seen))
    return Followed(*arrays, chain, found.map, found.resting[::-1], found.straight, found.exposure)


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


def _in_line(circles: list[Circles], nodes: int) -> Chain | None:
    """The chain of markers in a row, where as many circles as nodes lie on a line all the time."""
    counts = np.array([len(each) for each in circles])
    if not (counts == nodes).any():
        return None
    at = int(np.argmax(counts == nodes))
    tracks = follow_unnamed([each.centre for each in circles[at:]], 0)
    line = on_a_line(tracks)
    if line is None:
        return None
    change, mean = changes(tracks)
    if (change[line[:-1], line[1:]] > 1.0).any():
        return None
    return Chain(tracks[0, line], mean[line[:-1], line[1:]], change[line[:-1], line[1:]], at)


def _start(
    mapped: list[Circles], circles: list[Circles], named: np.ndarray, flat: Flat, radius: float, fps: float
) -> Chain:
    """The chain named by the user; a circle that is missing in the first frame may come within half a second."""
    nodes = len(named)
    places, length_error = flat(named), np.zeros(nodes)
    taken: dict[int, int] = {}
    for k in range(nodes):
        for i in range(min(len(circles), max(1, round(0.5 * fps)))):
            apart = np.linalg.norm(circles[i].centre - named[k], axis=1)
            if len(apart) and apart.min() <= 3 * radius and (j := int(np.argmin(apart))) is not None:
                if i == 0 and j in taken.values():
                    break
                if i == 0:
                    places[k], taken[k] = mapped[0].centre[j], j
                else:
                    length_error[k] = 3 * radius
                break
        else:
            taken[k] = -1
        if taken.get(k, 0) == -1 or (k not in taken and length_error[k] == 0):
            raise SceneError(
                f"--start: no circle of its own near node {k}; allowed: places within 3 radii of the circles"
            )
    length = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return Chain(places, length, np.hypot(length_error[1:], length_error[:-1]), 0)


def missed(found: Followed, mapped: list[Circles], circles: list[Circles], which: np.ndarray) -> None:
    """Fill in circles that are there and were not taken, and bridge the rest, in place."""
    bridged(found)
    _take(found, lambda i: _left(mapped[i], circles[i], which[i]))
    bridged(found)


def look_again(found: Followed, looked: Callable[[int, np.ndarray], Circles]) -> None:
    """Look for nodes that are not seen where they are expected; `looked` gives the circles there [pixel, video's]."""

    def there(i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        circles = looked(i, found.pixels[i, ~found.seen[i]])
        flat = found.map(circles.centre) if len(circles) else np.zeros((0, 2))
        free = np.ones(len(circles), bool)
        for place in found.pixels[i, found.seen[i]]:
            free &= np.linalg.norm(circles.centre - place, axis=1) > 3.0
        return flat[free], circles.centre[free], circles.error[free]

    _take(found, there)
    bridged(found)


def _left(mapped: Circles, circles: Circles, which: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    free = np.setdiff1d(np.arange(len(mapped)), which)
    return mapped.centre[free], circles.centre[free], circles.error[free]


def _take(found: Followed, there: Callable[[int], tuple[np.ndarray, np.ndarray, np.ndarray]]) -> None:
    """Give nodes that are not seen the circles that fit where they are expected and the lengths of their links."""
    error = length_errors(found.chain)
    expected, away = found.flat.copy(), _frames_away(found.seen)
    for i in np.flatnonzero((~found.seen).any(axis=1)):
        flat, pixels, scatter = there(i)
        for k in np.flatnonzero(~found.seen[i]):
            if not len(flat):
                break
            size = HINDSIGHT + PER_FRAME * min(away[i, k], FRAMES)
            price = np.linalg.norm(flat - expected[i, k], axis=1) / size
            for j, other in ((k - 1, k - 1), (k, k + 1)):
                if 0 <= other < found.seen.shape[1] and found.seen[i, other]:
                    miss = np.linalg.norm(flat - found.flat[i, other], axis=1) - found.chain.length[j]
                    price = np.maximum(price, np.abs(miss) / error[j])
            best = int(np.argmin(price))
            if price[best] < GATE:
                found.flat[i, k], found.pixels[i, k] = flat[best], pixels[best]
                found.error[i, k], found.seen[i, k] = scatter[best], True
                flat, pixels, scatter = (np.delete(a, best, axis=0) for a in (flat, pixels, scatter))


def _frames_away(seen: np.ndarray) -> np.ndarray:
    """Frames (k, n) to the nearest one in which the node is seen."""
    away = np.full(seen.shape, len(seen))
    for way in (slice(None), slice(None, None, -1)):
        run = np.full(seen.shape[1], len(seen))
        for i, row in enumerate(seen[way]):
            run = np.where(row, 0, run + 1)
            away[way][i] = np.minimum(away[way][i], run)
    return away


def bridged(found: Followed) -> None:
    """Put nodes that are not seen between the places before and after, drawn to their links; in place."""
    frames = np.arange(len(found.seen))
    for k in range(found.seen.shape[1]):
        known = found.seen[:, k]
        if known.all():
            continue
        if known.sum() < 2:
            found.flat[~known, k] = found.flat[known, k][0] if known.any() else found.chain.places[k]
            continue
        # no overshoot in long gaps; beyond the first and last sample the place stays
        inside = np.clip(frames[~known], frames[known][0], frames[known][-1])
        found.flat[~known, k] = PchipInterpolator(frames[known], found.flat[known, k])(inside)
    error = length_errors(found.chain)
    rows = np.flatnonzero((~found.seen).any(axis=1))
    for i in rows:
        found.flat[i] = bridge(found.flat[i], ~found.seen[i], found.chain.length, error)
    if len(rows):
        hidden = ~found.seen
        found.pixels[hidden] = found.map.back(found.flat[hidden])


def unblurred(found: Followed) -> Followed:
    """The places without what a long exposure does to them."""
    share = exposure_share(found.flat, found.seen)
    flat = found.flat - share * second_differences(found.flat, found.seen)
    return replace(found, flat=flat, exposure=float(np.sqrt(24 * share)))
