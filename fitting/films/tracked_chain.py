"""The nodes of a chain in all frames of a film."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fitting.films.flat_map import Flat
from fitting.films.ordering import Chain


@dataclass
class TrackedChain:
    """The nodes in all frames.

    Attributes:
        flat: (k, n, 2) flat pixels, bridged if not detected; pixels: the same in the video's own.
        error: (k, n) standard errors of the circles' fits [pixel]; detected: (k, n).
        chain: the links, as the whole film shows them; chain.at is the frame from which it was followed.
        map: from pixels to the plane, by the whole film.
        resting: (n,) which nodes rest; straight: the order is known only from lying on a line.
        exposure: [frame] that the lengths show, 0 if none; its effect on `flat` is corrected.
    """

    flat: np.ndarray
    pixels: np.ndarray
    error: np.ndarray
    detected: np.ndarray
    chain: Chain
    map: Flat
    resting: np.ndarray
    straight: bool = False
    exposure: float = 0.0

    def where_detected(self, positions: np.ndarray) -> np.ndarray:
        """`flat` or `pixels`, NaN if not detected."""
        return np.where(self.detected[..., None], positions, np.nan)

    def pick(self, frames: slice = slice(None), nodes: slice = slice(None)) -> TrackedChain:
        """Some frames or nodes of its samples."""
        return replace(
            self,
            flat=self.flat[frames, nodes],
            pixels=self.pixels[frames, nodes],
            error=self.error[frames, nodes],
            detected=self.detected[frames, nodes],
        )


def reverse_chain(found: TrackedChain) -> TrackedChain:
    """The same chain read from its other end."""
    chain = found.chain
    rate = None if chain.rate is None else chain.rate[::-1]
    held = None if chain.held is None else chain.held[::-1]
    reverse = Chain(chain.positions[::-1], chain.length[::-1], chain.spread[::-1], chain.at, rate, held)
    return replace(found.pick(nodes=slice(None, None, -1)), chain=reverse, resting=found.resting[::-1])
