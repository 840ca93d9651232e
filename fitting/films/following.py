"""The nodes through the whole film: from the clearest stretch forwards and backwards, then again with hindsight.

Circles of all frames are known. The chain found where it is clearest is followed to both ends. The map to the plane of
motion and the links' lengths are then learned from the whole film, which must confirm the order. Missed circles are
searched for between the positions before and after.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fitting.films.detection import Circles
from fitting.films.first_chain import chain_in_line, named_chain
from fitting.films.flat_map import Flat
from fitting.films.flattening import flatten
from fitting.films.identity import follow
from fitting.films.learned_chain import check_order, learn_chain
from fitting.films.marks import find_marks
from fitting.films.missed_circles import fill_missed
from fitting.films.ordering import Chain, clearest_chain, resting, turn_round
from fitting.films.tracked_chain import TrackedChain, reverse_chain


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
    if start is None:
        chain = clearest_chain(mapped, nodes, radius, fps)
        straight = chain is None
        if chain is None:
            chain = chain_in_line(mapped, nodes)
    else:
        chain = named_chain(mapped, centres, np.asarray(start, float), flat, radius, fps)
        straight = False
    chain, flat = _learn_from_film(centres, chain, flat, radius, fps, start is None and not straight)
    mapped = map_centres(centres, flat)
    found = follow(mapped, chain)
    pixels = np.nan_to_num(_of_nodes(centres, found))
    positions = _of_nodes(mapped, found)
    still = resting(positions, radius, nodes)
    if start is None:
        straight = check_order(positions, pixels, still, straight)
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


#: Maximum number of times that the chain and the map are learned: usually one is enough.
MAX_LEARNED = 3


def _learn_from_film(
    centres: list[np.ndarray], chain: Chain, flat: Flat, radius: float, fps: float, order: bool
) -> tuple[Chain, Flat]:
    """The chain and the map to the plane of motion as the whole film shows them.

    Args:
        order: whether the order of the nodes is learned too.
    """
    for _ in range(MAX_LEARNED):
        found = follow(map_centres(centres, flat), chain)
        flat = flatten(_of_nodes(centres, found), flat, fps)
        positions = _of_nodes(map_centres(centres, flat), found)
        still = resting(positions, radius, found.shape[1])
        chain, changed = learn_chain(positions, chain, still, order)
        if not changed:
            break
    return chain, flat


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
