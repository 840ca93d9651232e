"""Initial guess of a hanging line: the stable equilibrium of links under dead loads, or the catenary. Host-side NumPy.

With w_i the load on free node i, link j carries the force `T_j = T_1 - c_j`, `c_j` the sum of the loads before it. Its
direction is that of T_j, because a link in tension is stable and one in compression is not. The remaining condition is
that the line closes, sum d_j = D: the gradient of the convex function

    f(T_1) = sum_j L_j (|T_j| + |T_j|^2/(2 EA_j)) - T_1 . D    (rigid links: without the second term)

whose only minimum is the stable equilibrium; every other equilibrium has links in compression.
"""

from __future__ import annotations

import numpy as np

#: Maximum number of Newton iterations, here and in each round of smoothing.
ITERATIONS = 60
#: Fractions of the mean load by which the norm of a link's force is smoothed, round by round.
SMOOTHING_SHARES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9)


def catenary_guess(
    start: np.ndarray, end: np.ndarray | None, length: np.ndarray, weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes 0..n (n + 1, 3) [m] and tensions (n,) [N] of a uniform inextensible line.

    With horizontal and vertical distance D, H of the ends and total length S, `sqrt(S^2 - H^2) = 2 a sinh(D/(2a))`
    gives a; the line is `z = a cosh((x - x0)/a)` and its tension `w sqrt(a^2 + s^2)`, s from the lowest point.

    Args:
        start, end: ends (3,) [m]; `end` None hangs the line straight down (up where the weight is negative).
        length: link lengths (n,) [m].
        weight: total weight in water [N]; a negative one floats.
    """
    arc = np.concatenate([[0.0], np.cumsum(length)])
    total = arc[-1]
    middle = 0.5 * (arc[1:] + arc[:-1])
    per_metre = abs(weight) / total
    down = -1.0 if weight >= 0 else 1.0
    if end is None:
        return start + np.outer(arc, [0.0, 0.0, down]), per_metre * (total - middle)
    rise = -down * (end[2] - start[2])  # height of the end above the start, seen along the weight
    across = (end - start)[:2]
    distance = float(np.hypot(*across))
    direction = across / distance if distance > 0 else np.array([1.0, 0.0])
    if distance < 1e-6 * total:
        x, z, carried = _fold_line(arc, middle, rise, float(np.mean(length)))
    else:
        x, z, carried = _hanging(arc, middle, distance, rise)
    nodes = start + np.column_stack([np.outer(x, direction), -down * z])
    return nodes, per_metre * carried


def _hanging(
    arc: np.ndarray, middle: np.ndarray, distance: float, rise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, z of the nodes, and the length of line whose weight is the tension at the middle of each link, all [m]."""
    total = arc[-1]
    slack = max(total**2 - rise**2, 0.0)
    ratio = max(np.sqrt(slack) / distance, 1.0 + 1e-9)  # a taut line also needs an initial shape
    a = distance / (2 * _half_span(ratio))
    # lowest point at arc s0 from the start: rise = a (cosh - cosh) with total = a (sinh + sinh)
    centre = distance / 2 - a * np.arctanh(np.clip(rise / total, -1 + 1e-12, 1 - 1e-12))
    s0 = a * np.sinh(centre / a)
    x = centre + a * np.arcsinh((arc - s0) / a)
    z = np.hypot(a, arc - s0) - np.hypot(a, s0)
    return x, z, np.hypot(a, middle - s0)


def _fold_line(
    arc: np.ndarray, middle: np.ndarray, rise: float, link: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for ends on one vertical: down and up again, opened by half a link to define the plane of the fold."""
    turn = 0.5 * (arc[-1] - rise)
    x = -0.5 * link * np.sin(2 * np.pi * arc / arc[-1])
    return x, np.abs(arc - turn) - turn, np.maximum(np.abs(middle - turn), 0.1 * link)


def _half_span(ratio: float) -> float:
    """The root `u > 0` of `sinh(u)/u = ratio`, for a ratio above 1: half the span over the catenary's parameter.

    `log(sinh(u)/u)` is convex and increasing, so Newton's method decreases to the root from any start above it. `7 + 2
    log(ratio)` is such a start for every ratio.
    """
    u = 7.0 + 2.0 * np.log(ratio)
    for _ in range(ITERATIONS):
        step = (np.log(np.sinh(u) / u) - np.log(ratio)) / (1.0 / np.tanh(u) - 1.0 / u)
        u -= step
        if abs(step) <= 1e-12 * u:
            break
    return float(u)


def hang(
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
