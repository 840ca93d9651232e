"""Catenary of a uniform inextensible line as an initial guess of a hanging line. Host-side NumPy."""

from __future__ import annotations

import numpy as np

#: Maximum number of Newton iterations.
ITERATIONS = 60


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
