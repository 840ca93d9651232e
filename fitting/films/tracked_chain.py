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
        arrays = {name: getattr(self, name)[frames, nodes] for name in ("flat", "pixels", "error", "detected")}
        return replace(self, **arrays)


def reverse_chain(found: TrackedChain) -> TrackedChain:
    """The same chain read from its other end."""
    parts = {name: getattr(found.chain, name) for name in ("positions", "length", "spread", "rate", "held")}
    chain = replace(found.chain, **{name: part[::-1] for name, part in parts.items() if part is not None})
    return replace(found.pick(nodes=slice(None, None, -1)), chain=chain, resting=found.resting[::-1])
