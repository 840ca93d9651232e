"""First guess of a hanging line: the continuous catenary, sampled at the links. Host-side NumPy."""

from __future__ import annotations

import numpy as np


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
        nodes = start + np.outer(arc, [0.0, 0.0, down])
        return nodes, per_metre * (total - middle)
    rise = -down * (end[2] - start[2])  # height of the end above the start, seen along the weight
    across = (end - start)[:2]
    distance = float(np.hypot(*across))
    direction = across / distance if distance > 0 else np.array([1.0, 0.0])
    if distance < 1e-6 * total:
        x, z, tension = _folded(arc, total, rise, float(np.mean(length)), per_metre)
    else:
        x, z, tension = _hanging(arc, middle, total, distance, rise, per_metre)
    nodes = start + np.column_stack([x * direction[0], x * direction[1], -down * z])
    return nodes, tension


def _hanging(
    arc: np.ndarray, middle: np.ndarray, total: float, distance: float, rise: float, per_metre: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    slack = max(total**2 - rise**2, 0.0)
    ratio = max(np.sqrt(slack) / distance, 1.0 + 1e-9)  # a taut line still gets a shape to start from
    a = distance / (2 * _half_span(ratio))
    # lowest point at arc s0 from the start: rise = a (cosh - cosh) with total = a (sinh + sinh)
    centre = distance / 2 - a * np.arctanh(np.clip(rise / total, -1 + 1e-12, 1 - 1e-12))
    s0 = a * np.sinh(centre / a)
    x = centre + a * np.arcsinh((arc - s0) / a)
    z = np.hypot(a, arc - s0) - np.hypot(a, s0)
    return x, z, per_metre * np.hypot(a, middle - s0)


def _folded(
    arc: np.ndarray, total: float, rise: float, link: float, per_metre: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both ends above one another: down and up again, opened by half a link so that the fold has a side."""
    turn = 0.5 * (total - rise)
    z = np.where(arc < turn, -arc, -turn + (arc - turn))
    x = -0.5 * link * np.sin(2 * np.pi * arc / total)
    middle = 0.5 * (arc[1:] + arc[:-1])
    return x, z, per_metre * np.maximum(np.abs(middle - turn), 0.1 * link)


def _half_span(ratio: float) -> float:
    """The root `u > 0` of `sinh(u)/u = ratio`, for a ratio above 1: half the span over the catenary's parameter.

    `log(sinh(u)/u)` is convex and increasing, so Newton's steps come down to the root from any start above it;
    `7 + 2 log(ratio)` is one for every ratio.
    """
    u = 7.0 + 2.0 * np.log(ratio)
    for _ in range(60):
        step = (np.log(np.sinh(u) / u) - np.log(ratio)) / (1.0 / np.tanh(u) - 1.0 / u)
        u -= step
        if abs(step) <= 1e-12 * u:
            break
    return float(u)
