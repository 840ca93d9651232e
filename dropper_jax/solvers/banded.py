"""The exact Jacobian as a block-tridiagonal matrix: `jacfwd` over a few colours, block elimination in a scan. O(n).

A block is a node with the link before it: 3 positions and 1 tension. If forces couple second neighbours, a block
contains two nodes. A block is inverted row by row: the node's mass first, then the link's reaction. In this order a
free-ended chain of i links is always solvable, so no pivoting is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.model import Model
from dropper_jax.residual import Implicit, Solver, StepProblem, Unknowns
from dropper_jax.solvers.elimination import apply, inverse, multiply


class Layout:
    """Packing of unknowns into blocks: block i contains node i and link i, with `width` nodes per block."""

    def __init__(self, nodes: int, links: int, width: int) -> None:
        self.nodes = nodes
        self.links = links
        self.width = width
        self.blocks = -(-links // width)
        self.size = 4 * width
        used = np.zeros((self.blocks * width, 4), bool)
        used[:nodes, :3] = True
        used[:links, 3] = True
        self.padding = ~used.reshape(self.blocks, self.size)

    def pack(self, u: Unknowns) -> Array:
        """The unknowns as blocks (blocks, size); unused entries are zero."""
        rows = self.blocks * self.width
        x = jnp.pad(u.x, ((0, rows - self.nodes), (0, 0)))
        y = jnp.pad(u.y, (0, rows - self.links))
        return jnp.concatenate([x, y[:, None]], axis=1).reshape(self.blocks, self.size)

    def unpack(self, packed: Array) -> Unknowns:
        """The inverse of `pack`."""
        rows = packed.reshape(self.blocks * self.width, 4)
        return Unknowns(rows[: self.nodes, :3], rows[: self.links, 3])


class Blocks(NamedTuple):
    """A factored block-tridiagonal matrix: lower blocks, inverses of the eliminated diagonal, upper blocks, each
    (blocks, b, b)."""

    layout: Layout
    lower: Array
    inverse: Array
    upper: Array

    @classmethod
    def of(cls, layout: Layout, lower: Array, diagonal: Array, upper: Array) -> Blocks:
        """Block elimination from the first block."""

        def eliminate(ahead: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
            low, mid, up = row
            own = inverse(mid - multiply(low, ahead))
            return multiply(own, up), own

        _, own = jax.lax.scan(eliminate, jnp.zeros_like(upper[0]), (lower, diagonal, upper))
        return cls(layout, lower, own, upper)

    def apply(self, rows: Unknowns) -> Unknowns:
        y = _substitute(self.lower, self.inverse, self.layout.pack(rows))
        ahead = multiply(self.inverse, self.upper)
        return self.layout.unpack(_substitute(ahead, None, y, reverse=True))

    def transpose(self) -> Blocks:
        none = jnp.zeros_like(self.lower[:1])
        lower = jnp.concatenate([none, self.upper[:-1]]).mT
        upper = jnp.concatenate([self.lower[1:], none]).mT
        return Blocks(self.layout, lower, self.inverse.mT, upper)


@dataclass(frozen=True)
class Banded(Solver):
    """Block-tridiagonal elimination of the exact Jacobian."""

    name: str = "banded"

    def refuse(self, model: Model, integrator: Implicit) -> str | None:
        if not model.geometry.is_path:
            return "it follows one line, but the scene is a system of lines; use network or dense"
        if model.laws:
            return f"effect {model.laws[0].name!r} has its own unknowns; use dense"
        if not integrator.local_rows:
            return f"integrator {integrator.name!r} couples all links in each row; use dense"
        return None

    def linearise(self, problem: StepProblem, u: Unknowns) -> Blocks:
        model = problem.model
        layout = Layout(model.free_nodes, model.line.links, max(1, model.reach))
        return Blocks.of(layout, *_bands(problem, u, layout))


def _substitute(coupling: Array, inverse: Array | None, rhs: Array, reverse: bool = False) -> Array:
    """x_i = D_i (b_i - B_i x_(i-1)) block by block, from the last one if `reverse`; D = 1 without an `inverse`."""

    def one(x: Array, row: tuple[Array, Array | None, Array]) -> tuple[Array, Array]:
        block, own, b = row
        x = b - apply(block, x)
        if own is not None:
            x = apply(own, x)
        return x, x

    return jax.lax.scan(one, jnp.zeros_like(rhs[0]), (coupling, inverse, rhs), reverse=reverse)[1]


def _bands(problem: StepProblem, u: Unknowns, layout: Layout) -> tuple[Array, Array, Array]:
    """Lower, diagonal and upper blocks (blocks, b, b) of the Jacobian, from 3 colours of `b` directions each."""
    index = np.arange(layout.blocks)
    colours = 3
    picked = index % colours == np.arange(colours)[:, None]
    seeds = picked[:, None, :, None] * np.eye(layout.size)[:, None, :]
    packed = layout.pack(u)

    def push(seed: Array) -> Array:
        return jax.jvp(lambda p: layout.pack(problem.residual(layout.unpack(p))), (packed,), (seed,))[1]

    answer = jax.vmap(jax.vmap(push))(jnp.asarray(seeds, packed.dtype))

    def coupling(offset: int) -> Array:
        return answer[(index + offset) % colours, :, index, :].mT

    diagonal = coupling(0) + jnp.asarray(np.eye(layout.size) * layout.padding[:, None, :], packed.dtype)
    # no aliases of missing neighbours if there are fewer blocks than colours
    none = jnp.zeros_like(diagonal[:1])
    lower = jnp.concatenate([none, coupling(-1)[1:]])
    return lower, diagonal, jnp.concatenate([coupling(1)[:-1], none])
