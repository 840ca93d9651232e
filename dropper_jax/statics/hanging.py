"""The stable pose of a line under dead loads, from a convex problem in one force. Host-side NumPy.

With w_i the load on free node i, link j carries the force `T_j = T_1 - c_j`, `c_j` the sum of the loads before it. Its
direction is that of T_j, because a link in tension is stable and one in compression is not. What is left is to close
the line, sum d_j = D: the gradient of the convex function

    f(T_1) = sum_j L_j (|T_j| + |T_j|^2/(2 EA_j)) - T_1 . D    (rigid links: without the second term)

whose only minimum is the stable pose; every other equilibrium has links in compression.
"""

from __future__ import annotations

import numpy as np

from dropper_jax.statics.catenary import catenary_guess

#: The norm is smoothed by this share of the mean load at first, and less by a factor of 10 in each further round.
SMOOTHING = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)
ROUNDS = 60


def hang(
    start: np.ndarray,
    end: np.ndarray | None,
    length: np.ndarray,
    loads: np.ndarray,
    flexibility: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Free nodes and tensions of the stable pose.

    Args:
        start, end: held ends (3,) [m]; `end` None for a free end.
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
        force = _close(before, length, flexibility, end - start, _first_guess(start, end, length, loads)) - before
    size = np.linalg.norm(force, axis=1)
    down = np.array([0.0, 0.0, -1.0])
    direction = np.where(size[:, None] > 0, force / np.where(size > 0, size, 1.0)[:, None], down)
    links = (length * (1.0 + size * flexibility))[:, None] * direction
    nodes = start + np.cumsum(links, axis=0)
    return nodes[: len(loads)], size


def _first_guess(start: np.ndarray, end: np.ndarray, length: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Force in the first link of the uniform catenary of the same weight."""
    weight = -float(np.sum(loads[:, 2]))
    total = abs(weight) if weight != 0.0 else float(np.sum(np.linalg.norm(loads, axis=1)))
    nodes, tension = catenary_guess(start, end, length, total if weight >= 0 else -total)
    first = nodes[1] - nodes[0]
    return tension[0] * first / np.linalg.norm(first)


def _close(
    before: np.ndarray, length: np.ndarray, flexibility: np.ndarray, span: np.ndarray, guess: np.ndarray
) -> np.ndarray:
    """T_1 (3,) [N] that closes the line: damped Newton on f, its norms smoothed less and less."""
    scale = float(np.mean(np.linalg.norm(np.diff(before, axis=0), axis=1))) or 1.0
    force = guess
    for share in SMOOTHING:
        force = _minimise(force, before, length, flexibility, span, share * scale)
    return force


def _minimise(
    force: np.ndarray, before: np.ndarray, length: np.ndarray, flexibility: np.ndarray, span: np.ndarray, soft: float
) -> np.ndarray:
    def value(x: np.ndarray) -> float:
        size2 = np.sum((x - before) ** 2, axis=1)
        return float(np.sum(length * (np.sqrt(size2 + soft**2) + 0.5 * flexibility * size2)) - x @ span)

    for _ in range(ROUNDS):
        pull = force - before
        size = np.sqrt(np.sum(pull**2, axis=1) + soft**2)
        slope = np.sum((length * (1.0 / size + flexibility))[:, None] * pull, axis=0) - span
        if np.max(np.abs(slope)) < 1e-13 * np.sum(length):
            break
        unit = pull / size[:, None]
        curve = np.sum(length * (1.0 / size + flexibility)) * np.eye(3)
        curve -= np.einsum("j,ja,jb->ab", length / size, unit, unit)
        step = np.linalg.solve(curve, slope)
        fraction, now = 1.0, value(force)
        while fraction > 1e-6 and value(force - fraction * step) > now - 1e-4 * fraction * float(slope @ step):
            fraction *= 0.5
        force = force - fraction * step
    return force
