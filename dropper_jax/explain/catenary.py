"""The elastic catenary in closed form: forces of a uniform line between two points, on a flat bed or above it.

With H, V the horizontal and vertical force at the upper end, w the weight in water per unstretched length, L the length
and V0 = V - w L the vertical force at the lower end, a line that hangs freely spans

    x = H/w (asinh(V/H) - asinh(V0/H)) + H L/EA
    z = H/w (sqrt(1 + (V/H)^2) - sqrt(1 + (V0/H)^2)) + (V^2 - V0^2)/(2 EA w)

and one whose lower end rests on the bed (V0 < 0) has L_b = L - V/w on it and

    x = L_b + H/w asinh(V/H) + H L/EA,    z = H/w (sqrt(1 + (V/H)^2) - 1) + V^2/(2 EA w).

Where L is longer than x and the hanging length together, the line hangs straight down and H = 0. Host-side.

Source: Jonkman, Dynamics Modeling and Loads Analysis of an Offshore Floating Wind Turbine, NREL/TP-500-41958 (2007),
2.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import brentq, root

#: Largest row [m] of a solution, per metre of length.
MAX_ROW = 1e-9
#: Minimum H/(w L) of a guess.
MIN_HORIZONTAL = 1e-6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Hanging:
    """A uniform line between two points.

    Attributes:
        span, rise: horizontal and vertical distance of the upper from the lower end [m], at least 0.
        length: unstretched [m].
        weight: in water per unstretched length [N/m], above 0.
        EA: axial stiffness [N].
        on_bed: whether the lower end rests on a flat bed.
    """

    span: float
    rise: float
    length: float
    weight: float
    EA: float
    on_bed: bool


@dataclass(frozen=True)
class Shape:
    """Forces of a line in equilibrium.

    Attributes:
        horizontal, vertical: force at the upper end [N].
        upper, lower: tensions at the ends [N].
        bed: length on the bed [m].
        stiffness: change of the force at the upper end by its displacement (2, 2) [N/m], along x and z; None where the
            line hangs straight down.
    """

    horizontal: float
    vertical: float
    upper: float
    lower: float
    bed: float
    stiffness: np.ndarray | None


def solve(line: Hanging) -> Shape | None:
    """The equilibrium, or None if none is found."""
    hanging = hanging_length(line)
    if line.on_bed and line.span + hanging <= line.length:
        force = line.weight * hanging
        return Shape(0.0, force, force, 0.0, line.length - hanging, None)
    if line.span == 0.0 and line.length > line.rise:
        return None  # a fold, whose horizontal force is 0
    found = root(partial(_rows, line), _start(line), jac=True, tol=1e-13)
    row, slope = _rows(line, found.x)
    if not np.max(np.abs(row)) <= MAX_ROW * line.length:
        return None
    return _shape(line, found.x, slope)


def hanging_length(line: Hanging) -> float:
    """Unstretched length [m] that hangs straight down from the upper end to the height of the lower one."""
    flexibility = line.weight / line.EA
    return 2.0 * line.rise / (1.0 + np.sqrt(1.0 + 2.0 * flexibility * line.rise))


def offset_until_uplift(line: Hanging) -> float | None:
    """Distance [m] by which the upper end may still move away before the anchor is lifted; negative if it is lifted.

    There V = w L, and z gives H; None where even a taut line does not lift the anchor at that height.
    """
    top = line.weight * line.length

    def too_high(log_force: float) -> float:
        h = np.exp(log_force)
        rise = h / line.weight * (np.hypot(1.0, top / h) - 1.0) + top**2 / (2.0 * line.EA * line.weight)
        return rise - line.rise

    lowest = np.log(1e-9 * top)
    highest = np.log(1e9 * top)
    if too_high(lowest) <= 0.0 or too_high(highest) >= 0.0:
        return None
    h = np.exp(brentq(too_high, lowest, highest, xtol=1e-13))
    reach = h / line.weight * np.arcsinh(top / h) + h * line.length / line.EA
    return reach - line.span


def _start(line: Hanging) -> np.ndarray:
    """log(H/(w L)) and V/(w L) of the usual guess, of a straight spring where the line is taut."""
    chord = np.hypot(line.span, line.rise)
    total = line.weight * line.length
    if line.length > chord and line.span > 0.0:
        bow = np.sqrt(3.0 * ((line.length**2 - line.rise**2) / line.span**2 - 1.0))
        horizontal = 0.5 * line.span / bow / line.length
        vertical = 0.5 * (line.rise / np.tanh(bow) / line.length + 1.0)
    else:
        stretching = line.EA * (chord / line.length - 1.0) / total
        horizontal = stretching * line.span / chord
        vertical = stretching * line.rise / chord + 0.5
    return np.array([np.log(max(horizontal, MIN_HORIZONTAL)), vertical])


def _span_and_rise(x: Array, line: Hanging, rests: bool) -> Array:
    """Span and rise (2,) [m] of the forces x; differences are written so that they keep their digits in taut lines."""
    total = line.weight * line.length
    h = jnp.exp(x[0]) * total
    v = x[1] * total
    # slopes at the upper and the lower end of the part that hangs
    upper = v / h
    lower = jnp.where(rests, 0.0, upper - total / h)
    part = upper - lower
    upper_root = jnp.hypot(1.0, upper)
    lower_root = jnp.hypot(1.0, lower)
    roots = upper_root + lower_root
    rise = part * (upper + lower) / roots
    inverse = jnp.where(lower > 0.0, 1.0 / (lower + lower_root), lower_root - lower)
    across = h / line.weight * jnp.log1p((part + rise) * inverse) + h * line.length / line.EA
    up = h / line.weight * rise * (1.0 + 0.5 * h * roots / line.EA)
    bed = jnp.where(rests, line.length - v / line.weight, 0.0)
    return jnp.stack([bed + across, up])


@jax.jit
def _span_and_slopes(x: Array, line: Hanging, rests: bool) -> tuple[Array, Array]:
    """Span and rise (2,) [m], and their slopes by x (2, 2)."""
    return _span_and_rise(x, line, rests), jax.jacfwd(_span_and_rise)(x, line, rests)


def _rows(line: Hanging, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (2,) [m] that vanish at the equilibrium, and their slopes by x (2, 2)."""
    found, slope = _span_and_slopes(x, line, line.on_bed and bool(x[1] < 1.0))
    return np.asarray(found) - np.array([line.span, line.rise]), np.asarray(slope)


def _shape(line: Hanging, x: np.ndarray, slope: np.ndarray) -> Shape:
    """The forces of a solution x, with the slopes of its rows by x (2, 2)."""
    total = line.weight * line.length
    horizontal = total * np.exp(x[0])
    vertical = total * x[1]
    at_lower_end = vertical - total
    bed = 0.0
    if line.on_bed:
        at_lower_end = max(at_lower_end, 0.0)
        bed = max(line.length - vertical / line.weight, 0.0)
    stiffness = np.linalg.inv(slope / np.array([horizontal, total]))
    lower = np.hypot(horizontal, at_lower_end)
    return Shape(horizontal, vertical, np.hypot(horizontal, vertical), lower, bed, stiffness)
