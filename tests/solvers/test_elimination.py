"""Rounds of elimination against dense solves, on graphs and matrices that are awkward."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dropper_jax.model import Graph, Member
from dropper_jax.solvers.elimination import eliminate, elimination_order, solve
from dropper_jax.solvers.saddle import find_nodes_before_last_link

GRAPHS = {
    "one node": (1, []),
    "no couplings": (4, []),
    "chain": (11, [(i, i + 1) for i in range(10)]),
    "ring": (9, [(i, (i + 1) % 9) for i in range(9)]),
    "star": (8, [(7, i) for i in range(7)]),
    "all": (6, [(i, j) for j in range(6) for i in range(j)]),
    "grid": (20, [(i, i + 1) for i in range(20) if i % 5 < 4] + [(i, i + 5) for i in range(15)]),
    "double": (5, [(i, i + 1) for i in range(4)] * 2),
}


def system(graph, ratio=1.0, stiff=100.0, dtype=jnp.float64):
    """Order, blocks and dense matrix of inertia (alternating by `ratio`) plus unsymmetric stiffness of couplings."""
    count, edges = GRAPHS[graph]
    rng = np.random.default_rng(0)
    inertia = np.where(np.arange(count) % 2, ratio, 1.0)
    axes = rng.standard_normal((len(edges), 3, 1))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    coupling = stiff * axes @ np.swapaxes(axes, 1, 2) + 0.1 * rng.standard_normal((len(edges), 3, 3))
    pairs = [(i, i) for i in range(count)] + edges + [(j, i) for i, j in edges]
    diagonal = inertia[:, None, None] * np.eye(3)
    for (i, j), block in zip(edges, coupling, strict=True):
        diagonal[i] += block
        diagonal[j] += block
    blocks = np.concatenate([diagonal, -coupling, -coupling])
    dense = np.zeros((count, 3, count, 3))
    for (i, j), block in zip(pairs, blocks, strict=True):
        dense[i, :, j] += block
    return elimination_order(count, pairs), jnp.asarray(blocks, dtype), dense.reshape(3 * count, 3 * count)


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("graph", GRAPHS)
def test_rounds_solve_as_a_dense_matrix_does(graph, transposed):
    order, blocks, dense = system(graph)
    rhs = np.random.default_rng(1).standard_normal((len(dense) // 3, 3))

    def run(blocks, rhs):
        factor = eliminate(order, blocks)
        return solve(factor.transpose() if transposed else factor, rhs)

    expected = np.linalg.solve(dense.T if transposed else dense, rhs.ravel()).reshape(rhs.shape)
    np.testing.assert_allclose(jax.jit(run)(blocks, rhs), expected, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize(("ratio", "stiff"), [(1e4, 1e2), (1e-4, 1e2), (1.0, 1e3), (1e4, 1e6), (1.0, 1e-3)])
def test_masses_of_1_to_10000_taut_and_slack_lines_are_solved_as_exactly_as_their_condition_allows(ratio, stiff, dtype):
    order, blocks, dense = system("chain", ratio, stiff, dtype)
    rhs = np.random.default_rng(1).standard_normal((11, 3)).astype(dtype)
    x = np.asarray(jax.jit(lambda b, r: solve(eliminate(order, b), r))(blocks, jnp.asarray(rhs)), float).ravel()
    expected = np.linalg.solve(dense, rhs.astype(float).ravel())
    allowed = 100 * float(jnp.finfo(dtype).eps) * np.linalg.cond(dense)
    assert np.abs(x - expected).max() < allowed * np.abs(expected).max()


def test_a_chain_takes_rounds_of_every_other_node():
    order = elimination_order(1000, [(i, i) for i in range(1000)] + [(i, i + 1) for i in range(999)])
    assert len(order.rounds) == 10
    assert order.rounds[0].width == 500


def test_nodes_wait_for_those_that_go_before_them():
    pairs = [(i, i) for i in range(5)] + [(i, i + 1) for i in range(4)]
    order = elimination_order(5, pairs, {0: {1}, 2: {3, 4}})
    assert order.position[0] > order.position[1]
    assert order.position[2] > max(order.position[3], order.position[4])


@pytest.mark.parametrize("word", ["scatter", "custom_call"])
def test_programs_have_no_scatter_and_no_library_call(word):
    order, blocks, dense = system("grid")
    run = jax.jit(lambda b, r: solve(eliminate(order, b), r))
    assert word not in run.lower(blocks, np.ones((len(dense) // 3, 3))).as_text()


def test_each_of_a_thousand_lines_in_a_row_waits_for_a_point_of_its_own():
    """From a fixed point, and listed so that each line takes the point of the one before it: only one choice is left.

    The lines' points move on along paths that are longer than the stack of Python.
    """
    count = 1100
    lines = tuple(Member(f"line-{i}", 1, i, i + 1) for i in range(count))
    before = find_nodes_before_last_link(Graph(lines, (True, *[False] * count)))
    assert before == {count + i: {i} for i in range(count)}
