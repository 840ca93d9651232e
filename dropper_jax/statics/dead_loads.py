"""Stable equilibrium of one line of links under dead loads, in closed form but for its first force. Host-side NumPy.

With w_i the load on free node i, link j carries the force `T_j = T_1 - c_j`, `c_j` the sum of the loads before it. Its
direction is that of T_j, because a link in tension is stable and one in compression is not. The remaining condition is
that the line closes, sum d_j = D: the gradient of the convex function

    f(T_1) = sum_j L_j (|T_j| + |T_j|^2/(2 EA_j)) - T_1 . D    (rigid links: without the second term)

whose only minimum is the stable equilibrium; every other equilibrium has links in compression.
"""

from __future__ import annotations

import numpy as np

from dropper_jax.statics.catenary import catenary_guess

#: Maximum number of Newton iterations in each round of smoothing.
ITERATIONS = 60
#: Fractions of the mean load by which the norm of a link's force is smoothed, round by round.
SMOOTHING_SHARES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)


def hang_under_loads(
    start: np.ndarray,
    end: np.ndarray | None,
    length: np.ndarray,
    loads: np.ndarray,
    flexibility: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Free nodes and tensions of the stable equilibrium.

    Args:
        start, end: fixed ends (3,) [m]; `end` None for a free end.
        length: (n,) [m].
        loads: on the free nodes (nodes, 3) [N].
        flexibility: 1/EA per link (n,) [1/N], zero for rigid links.

    Returns:
        Free nodes (nodes, 3) [m] and tensions (n,) [N].
    """
    if end is None:
        force = np.cumsum(loads[::-1], axis=0)[::-1]
    else:
        before = np.concatenate([np.zeros((1, 3)), np.cumsum(loads, axis=0)])
        # decreasing smoothing of the norms, over the mean load
        scale = float(np.mean(np.linalg.norm(loads, axis=1))) or 1.0
        first = _first_guess(start, end, length, loads)
        for share in SMOOTHING_SHARES:
            first = _minimise(first, before, length, flexibility, end - start, share * scale)
        force = first - before
    size = np.linalg.norm(force, axis=1)
    direction = np.where(size[:, None] > 0, force, [0.0, 0.0, -1.0]) / np.where(size > 0, size, 1.0)[:, None]
    links = (length * (1.0 + size * flexibility))[:, None] * direction
    nodes = start + np.cumsum(links, axis=0)
    return nodes[: len(loads)], size


def _first_guess(start: np.ndarray, end: np.ndarray, length: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Force in the first link of the uniform catenary of the same weight."""
    weight = -float(np.sum(loads[:, 2])) or float(np.sum(np.linalg.norm(loads, axis=1)))
    nodes, tension = catenary_guess(start, end, length, weight)
    first = nodes[1] - nodes[0]
    return tension[0] * first / np.linalg.norm(first)


def _minimise(
    force: np.ndarray, before: np.ndarray, length: np.ndarray, flexibility: np.ndarray, span: np.ndarray, soft: float
) -> np.ndarray:
    """T_1 (3,) [N] that closes the line: damped Newton from `force` on f, whose norms are smoothed by `soft` [N]."""

    def value(x: np.ndarray) -> float:
        size2 = np.sum((x - before) ** 2, axis=1)
        return float(np.sum(length * (np.sqrt(size2 + soft**2) + 0.5 * flexibility * size2)) - x @ span)

    for _ in range(ITERATIONS):
        link_force = force - before
        size = np.sqrt(np.sum(link_force**2, axis=1) + soft**2)
        slope = np.sum((length * (1.0 / size + flexibility))[:, None] * link_force, axis=0) - span
        if np.max(np.abs(slope)) < 1e-13 * np.sum(length):
            break
        unit = link_force / size[:, None]
        curve = np.sum(length * (1.0 / size + flexibility)) * np.eye(3)
        curve -= np.einsum("j,ja,jb->ab", length / size, unit, unit)
        step = np.linalg.solve(curve, slope)
        fraction = 1.0
        now = value(force)
        while fraction > 1e-6 and value(force - fraction * step) > now - 1e-4 * fraction * float(slope @ step):
            fraction *= 0.5
        force = force - fraction * step
    return force
