"""Time convergence as in the thesis (Fig. 5.4, C.1, C.2): each step compared with its half, per link."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.analysis.angles import link_angles
from dropper_jax.base.errors import SceneError
from dropper_jax.model import Model, State
from dropper_jax.study.errors import link_vectors
from dropper_jax.study.march import grid_run, status_of
from dropper_jax.study.schemes import Scheme

SCHEMES = (Scheme("energy_momentum"), Scheme("thesis_angles", 0.51))


def convergence(
    model: Model, s: State, grid: float, saves: int, dts: list[float], schemes: tuple[Scheme, ...] = SCHEMES
) -> list[dict[str, Any]]:
    """RMS difference of each link's angles [rad] between a step and half of it, over the first `saves * grid` seconds.

    Returns:
        one {label, dts, polar (steps, n), azimuth (steps, n) or None in a plane, status (steps,)} per scheme that
        runs the model; NaN if either run failed.
    """
    found = []
    for scheme in schemes:
        try:
            stepper = scheme.stepper(model)
        except SceneError:
            continue
        everies = sorted({max(1, round(grid / dt)) for dt in dts})
        motions, states = [], []
        for every in [*everies, 2 * everies[-1]]:
            run = grid_run(stepper, model, s, grid, every, saves)
            states.append(status_of(run, stepper))
            motions.append(_angles(model, run.r, grid) if states[-1] == "ok" else None)
        found.append(_differences(scheme.label, [grid / e for e in everies], motions, states))
    return found


def _angles(model: Model, r: np.ndarray, grid: float) -> np.ndarray:
    """Polar and azimuth (2, k, n) [rad]."""
    links = link_vectors(model, r, grid * np.arange(1, len(r) + 1))
    nodes = np.concatenate([np.zeros((len(r), 1, 3)), np.cumsum(links, axis=1)], axis=1)
    return np.stack(link_angles(nodes))


def _differences(label: str, dts: list[float], motions: list[Any], states: list[str]) -> dict[str, Any]:
    count = next((m.shape[-1] for m in motions if m is not None), 0)
    nothing = np.full((2, count), np.nan)
    pairs = zip(motions[:-1], motions[1:], strict=True)
    rows = np.array([nothing if a is None or b is None else _rms_turn(a - b) for a, b in pairs])
    polar, azimuth = rows[:, 0], rows[:, 1]
    flat = bool(np.nanmax(azimuth, initial=0.0) < 1e-12)
    return {"label": label, "dts": dts, "polar": polar, "azimuth": None if flat else azimuth, "status": states[:-1]}


def _rms_turn(difference: np.ndarray) -> np.ndarray:
    """RMS over time (2, n) of angle differences, modulo full turns."""
    turn = np.angle(np.exp(1j * difference))
    return np.sqrt(np.mean(turn**2, axis=1))
