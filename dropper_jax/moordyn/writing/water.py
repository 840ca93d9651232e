"""Waves and current of a scene as files beside a MoorDyn input."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dropper_jax.sea.spec import CurrentSpec

#: Heights of the table that stands for a profile given by a formula.
HEIGHTS = 61


def waves_text(amplitude: np.ndarray, omega: np.ndarray, phase: np.ndarray, direction: np.ndarray) -> str:
    """Text of the frequency file for components of ours (c,) [m], [rad/s], [rad], [rad]."""
    turn = 0.5 * np.pi - phase
    table = np.stack([omega, amplitude * np.cos(turn), amplitude * np.sin(turn), direction * np.ones_like(omega)], 1)
    return "\n".join(["0.0 0.0 0.0 0.0", *(" ".join(repr(float(x)) for x in row) for row in table)]) + "\n"


def current_text(spec: CurrentSpec, profile: Callable[[np.ndarray], np.ndarray], depth: float) -> str:
    """Text of the current file: a table as it stands, or a formula at heights that grow dense towards the bed."""
    heights = spec.heights
    if heights is None:
        heights = depth * (np.linspace(0.0, 1.0, HEIGHTS) ** 2 - 1.0)
    lines = ["----- MoorDyn steady currents file -----", "z ux uy uz", "(m) (m/s) (m/s) (m/s)"]
    for z, u in zip(heights, profile(np.asarray(heights, float)), strict=True):
        lines.append(" ".join(repr(float(x)) for x in (z, *u)))
    return "\n".join(lines) + "\n"
