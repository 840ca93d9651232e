"""Sparse systems of small blocks, solved by rounds of nodes that are not neighbours.

With D the blocks of the nodes of a round, L their rows for their neighbours and U the rows of the neighbours for them,

    A' = A - U D^-1 L,    b' = b - U D^-1 b_D;    back: x_D = D^-1 (b_D - L x)

There is no pivoting between blocks: the method is for matrices like inertia plus stiffness. The order of the nodes is
found once for a graph, with NumPy (`elimination_order`). A chain of m nodes takes log2(m) rounds (every other node,
which is cyclic reduction), and lines that hang on a line are eliminated in the same rounds: a longline of 99 nodes
takes 7 rounds, one of 234 takes 10. A factorisation (`eliminate`) and a solution (`solve`) are gathers by the static
tables of the rounds and elementwise products, without library calls or scatters, so a loop around them can be one
kernel. A longline of 99 nodes takes 23 us, compared with 174 us for padded lines and a dense matrix of their points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.base.indexed_sums import gather_sums, index_table, with_zero_row

#: Row and column of a block.
Pair = tuple[int, int]
#: Maximum number of neighbours of nodes in one round if second neighbours are coupled, as by bending. A chain of 200
#: then takes 15 rounds; 69 with 4, and 101 with 2, which eliminate it from its ends.
WIDER = 5
#: The same if links alone couple nodes: an inner node of a line has two.
ALONG_LINES = 2


@dataclass(frozen=True)
class Round:
    """Nodes eliminated at once, and indices of their blocks and those of the others: static tables.

    Blocks are in one array: `width` diagonal blocks of these nodes, their rows for up to `degree` neighbours (degree,
    width), the rows of the neighbours for them (degree, width), then all other blocks. Right sides: these nodes, then
    the others. An index one past the end is a block or row of zeros.

    Attributes:
        nodes: their indices (width,).
        degree: maximum number of neighbours.
        neighbours: of each (degree, width), as indices of the right sides of the next round.
        keep: index of each block of the next round.
        change: products that are subtracted from these blocks, (most, blocks), as indices of (degree, degree, width).
        change_rows: the same for right sides, (most, rows), as indices of (degree, width).
    """

    nodes: np.ndarray
    degree: int
    neighbours: np.ndarray
    keep: np.ndarray
    change: np.ndarray
    change_rows: np.ndarray

    @property
    def width(self) -> int:
        return len(self.nodes)


@dataclass(frozen=True)
class Order:
    """The rounds; `slot` contains the source of each block (row, column), (most, blocks), see `Round`.

    `nodes` lists all nodes in the order of the rounds, `position` is the index of each in this list.
    """

    rounds: tuple[Round, ...]
    slot: np.ndarray
    nodes: np.ndarray
    position: np.ndarray


def elimination_order(
    count: int, blocks: list[Pair], after: Mapping[int, Iterable[int]] | None = None, most: int = ALONG_LINES
) -> Order:
    """The order for `count` nodes whose matrix is the sum of `blocks`, listed by (row, column).

    Args:
        blocks: several may have the same position; a row or column index >= count is not a node and is left out.
        after: for some nodes, those that must be eliminated before them.
        most: maximum number of neighbours of a node that is eliminated together with others of fewer neighbours.
    """
    nodal = {pair for pair in blocks if max(pair) < count}
    taken = _rounds(count, nodal, after or {}, most)
    present = nodal | {(i, i) for i in range(count)}
    nodes: list[int] = []
    following: list[list[Pair]] = []
    for neighbours, degree in taken:
        nodes += neighbours
        rest = {pair for pair in present if neighbours.keys().isdisjoint(pair)}
        following.append(_list_blocks(neighbours, degree) + sorted(rest))
        present = rest
        for near in neighbours.values():
            present |= set(product(near, near))
    following.append([])  # nothing is left after the last round
    rounds = []
    done = 0
    for (neighbours, degree), (now, then) in zip(taken, pairwise(following), strict=True):
        done += len(neighbours)
        rounds.append(_round(neighbours, degree, now, then, nodes[done:]))
    position = np.empty(count, int)
    position[nodes] = np.arange(count)
    where: dict[Pair, list[int]] = {}
    for number, pair in enumerate(blocks):
        where.setdefault(pair, []).append(number)
    slot = index_table([where.get(pair, []) for pair in following[0]], len(blocks))
    return Order(tuple(rounds), slot, np.array(nodes, int), position)


def _rounds(
    count: int, pairs: set[Pair], after: Mapping[int, Iterable[int]], few: int
) -> list[tuple[dict[int, list[int]], int]]:
    """Nodes of each round with their neighbours, and the maximum number of neighbours."""
    near: list[set[int]] = [set() for _ in range(count)]
    for a, b in pairs:
        if a != b:
            near[a].add(b)
            near[b].add(a)
    waiting = {i: set(others) for i, others in after.items()}
    left = list(range(count))
    rounds = []
    while left:
        ready = [i for i in left if not waiting.get(i)]
        # two neighbours do not add blocks; more neighbours add new blocks and are used only if nothing else remains
        most = max(few, min(len(near[i]) for i in ready))
        found: dict[int, list[int]] = {}
        adjacent: set[int] = set()
        for i in sorted(ready, key=lambda i: max(few, len(near[i]))):
            if len(near[i]) <= most and i not in adjacent:
                found[i] = sorted(near[i])
                adjacent |= near[i]
        for i, others in found.items():
            for a in others:
                near[a] |= near[i]
                near[a] -= {a, i}
        for others in waiting.values():
            others.difference_update(found)
        left = [i for i in left if i not in found]
        rounds.append((found, max(map(len, found.values()))))
    return rounds


#: A block of zeros, in place of that of a missing neighbour.
MISSING = (-1, -1)


def _list_blocks(neighbours: dict[int, list[int]], degree: int) -> list[Pair]:
    """The blocks of the nodes of a round in the order of `Round`; `MISSING` if a node has fewer neighbours."""
    rows = []
    for c in range(degree):
        for i, others in neighbours.items():
            row = MISSING
            if c < len(others):
                row = i, others[c]
            rows.append(row)
    return [*((i, i) for i in neighbours), *rows, *(pair[::-1] for pair in rows)]


def _round(neighbours: dict[int, list[int]], degree: int, now: list[Pair], then: list[Pair], later: list[int]) -> Round:
    """The tables of a round.

    Args:
        neighbours: of each node of the round.
        degree: maximum number of neighbours.
        now, then: the blocks of this round and of the next one.
        later: the nodes of later rounds.
    """
    width = len(neighbours)
    slot_of = {pair: number for number, pair in enumerate(now)} | {MISSING: len(now)}
    products: dict[Pair, list[int]] = {}
    rows: dict[int, list[int]] = {}
    number = {node: at for at, node in enumerate(later)}
    ends = np.full((degree, width), len(later))
    for k, others in enumerate(neighbours.values()):
        for c, a in enumerate(others):
            ends[c, k] = number[a]
            rows.setdefault(a, []).append(c * width + k)
            for d, b in enumerate(others):
                products.setdefault((a, b), []).append((c * degree + d) * width + k)
    return Round(
        nodes=np.array(list(neighbours), int),
        degree=degree,
        neighbours=ends,
        keep=np.array([slot_of.get(pair, len(now)) for pair in then], int),
        change=index_table([products.get(pair, []) for pair in then], degree * degree * width),
        change_rows=index_table([rows.get(node, []) for node in later], degree * width),
    )


Tree = TypeVar("Tree")


def optimization_barrier(tree: Tree) -> Tree:
    """The same arrays, computed once: a loop without iterations, into which the compiler does not fuse.

    Without it each block is recomputed for each element that reads it: a correction of a longline of 99 nodes takes 285
    us without and 132 us with it. (XLA's CPU compiler removes its optimization barriers before fusion.)
    """
    first = jax.tree.leaves(tree)[0]
    # true only for a NaN matrix, whose result is NaN anyway; not known at compile time
    never = jnp.any(jnp.isnan(jnp.ravel(first)[:1]))

    def changed(c: tuple[Array, Tree]) -> tuple[Array, Tree]:
        return jnp.zeros((), bool), jax.tree.map(jnp.negative, c[1])

    return jax.lax.while_loop(lambda c: c[0], changed, (never, tree))[1]


def multiply(a: Array, b: Array) -> Array:
    """Products of blocks (..., k, k) with columns (..., k, c) as one fused reduction: 8 against 60 us in a solve of 11
    rows with a library product.
    """
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def inverse(m: Array) -> Array:
    """Inverses of blocks (..., k, k), row by row without pivoting: inertia and stiffness first, a constraint last.

    Neither cofactors nor inverses of leading blocks are used, since they lose digits. A chain of links 1e6 times as
    stiff as inertia is solved to 4e-6 (LAPACK's inverses: 4e-6; cofactors: 7e-3).
    """
    for i in range(m.shape[-1]):
        own = np.arange(m.shape[-1]) == i
        row = jnp.where(own, 1.0, m[..., i : i + 1, :]) / m[..., i : i + 1, i : i + 1]
        m = jnp.where(own[:, None], row, jnp.where(own, 0.0, m) - m[..., i : i + 1] * row)
    return m


class Eliminated(NamedTuple):
    """Blocks of one round: D^-1 (width, k, k), L and U (degree, width, k, k)."""

    inverse: Array
    lower: Array
    upper: Array


class Elimination(NamedTuple):
    """A factored matrix."""

    order: Order
    rounds: tuple[Eliminated, ...]

    def transpose(self) -> Elimination:
        return self._replace(rounds=tuple(Eliminated(d.mT, up.mT, low.mT) for d, low, up in self.rounds))


def eliminate(order: Order, blocks: Array) -> Elimination:
    """Factor the matrix with blocks (blocks, k, k) in the order given to `elimination_order`."""
    rounds = []
    if order.rounds:
        blocks = gather_sums(optimization_barrier(blocks), order.slot)
    for table in order.rounds:
        done, blocks = _eliminate(table, blocks)
        rounds.append(done)
    return Elimination(order, tuple(rounds))


def _eliminate(table: Round, blocks: Array) -> tuple[Eliminated, Array]:
    """Blocks of one round, and those of the next."""
    width = table.width
    degree = table.degree
    k = blocks.shape[-1]
    adjacent = blocks[width : (1 + 2 * degree) * width].reshape(2, degree, width, k, k)
    done = Eliminated(inverse(blocks[:width]), adjacent[0], adjacent[1])
    after = with_zero_row(blocks)[table.keep]
    if table.change.size:
        products = multiply(done.upper[:, None], multiply(done.inverse, done.lower))
        after = after - gather_sums(products.reshape(-1, k, k), table.change)
    return done, after


def solve(factor: Elimination, rhs: Array) -> Array:
    """x (nodes, k) of right sides (nodes, k)."""
    order = factor.order
    left = rhs[factor.order.nodes]
    found = []
    for table, done in zip(order.rounds, factor.rounds, strict=True):
        own = left[: table.width]
        left = left[table.width :]
        found.append(own)
        if table.change_rows.size:
            moved = apply(done.upper, apply(done.inverse, own))
            left = left - gather_sums(moved.reshape(-1, rhs.shape[-1]), table.change_rows)
    x = left
    for table, done, own in zip(order.rounds[::-1], factor.rounds[::-1], found[::-1], strict=True):
        if table.degree:
            own = own - jnp.sum(apply(done.lower, with_zero_row(x)[table.neighbours]), axis=0)
        x = jnp.concatenate([apply(done.inverse, own), x])
    return x[order.position]


def apply(a: Array, x: Array) -> Array:
    """Blocks (..., k, k) times vectors (..., k)."""
    return jnp.sum(a * x[..., None, :], axis=-1)
