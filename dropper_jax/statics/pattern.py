"""Dependence of static forces on nodes: the blocks of the tangent stiffness, and directions that give them all."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from jax import Array

from dropper_jax.model import Graph, Model

if TYPE_CHECKING:
    from scipy.sparse import csc_array

AnyArray = TypeVar("AnyArray", Array, np.ndarray)


class Pattern(NamedTuple):
    """Dependence of nodal forces on nodes: entries (row, column), and a colour (free,) of each column."""

    row: np.ndarray
    column: np.ndarray
    colour: np.ndarray
    colours: int

    @property
    def seeds(self) -> np.ndarray:
        """Displacements (colours, 3, free, 3) [m] of the nodes of one colour along one axis."""
        picked = self.colour == np.arange(self.colours)[:, None]
        return 1.0 * picked[:, None, :, None] * np.eye(3)[None, :, None, :]

    def blocks(self, answer: AnyArray) -> AnyArray:
        """Blocks (entries, 3, 3) [N/m], from the forces (colours, 3, free, 3) [N] that answer the seeds."""
        return answer[self.colour[self.column], :, self.row, :].swapaxes(-1, -2)

    def sparse(self, blocks: np.ndarray) -> csc_array:
        """The matrix (3 free, 3 free) [N/m] of these blocks."""
        from scipy.sparse import csc_array  # noqa: PLC0415

        axis = np.arange(3)
        rows = np.broadcast_to(3 * self.row[:, None, None] + axis[:, None], blocks.shape)
        columns = np.broadcast_to(3 * self.column[:, None, None] + axis, blocks.shape)
        size = 3 * len(self.colour)
        return csc_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))


@lru_cache(maxsize=64)
def pattern(geometry: Graph, reach: int) -> Pattern:
    """Pattern of forces that couple nodes up to this number of links apart; columns without a common row have the same
    colour."""
    from scipy.sparse import coo_array, eye_array  # noqa: PLC0415

    free = geometry.free
    inside = (geometry.first < free) & (geometry.last < free)
    links = geometry.first[inside], geometry.last[inside]
    beside = coo_array((np.ones(len(links[0])), links), shape=(free, free))
    near = (beside + beside.T + eye_array(free)).tocsr()
    far = near
    for _ in range(reach - 1):
        far = far @ near
    meeting = (far.T @ far).tocsr()
    colour = np.full(free, -1)
    for node in range(free):
        taken = colour[meeting.indices[meeting.indptr[node] : meeting.indptr[node + 1]]]
        colour[node] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    entries = far.tocoo()
    return Pattern(entries.row, entries.col, colour, int(colour.max(initial=0)) + 1)


def pattern_of(model: Model) -> Pattern:
    """The pattern of a model's static forces."""
    return pattern(model.geometry, max(model.reach, 1))
