"""What pictures need of a solution, without the samples that no picture can show."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dropper_jax.build import build_model

#: Nodes further out than this many sizes of the first pose belong to a run that has blown up.
FARTHEST = 100.0


@dataclasses.dataclass(frozen=True)
class Run:
    """Arrays of a solution as in `dropper_jax.solution.Solution`, k samples; all but the tension are finite.

    `surface` gives the elevation (q, n) [m] at places (n, 3) and times (q,); None without water.
    """

    name: str
    integrator: str
    dt: float
    status: str
    t: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    tension: np.ndarray
    t_tension: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    work_names: tuple[str, ...]
    surface: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


def readable(solution: Any) -> Run:
    """The run up to where it blew up or stopped being finite, its first sample at least."""
    moved = [np.asarray(getattr(solution, name), float) for name in ("positions", "velocities", "kinetic", "potential")]
    work = np.asarray(solution.work, float).reshape(len(solution.t), -1)
    finite = np.all([np.isfinite(a).reshape(len(a), -1).all(axis=1) for a in (*moved, work)], axis=0)
    first = moved[0][0]
    far = FARTHEST * max(float(np.ptp(first, axis=0).max()), np.finfo(float).tiny)
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(moved[0] - first).max(axis=(1, 2)) <= far
    good = np.append(finite & near, False)
    last = max(1, int(np.argmin(good)))
    positions, velocities, kinetic, potential = (a[:last] for a in moved)
    return Run(
        name=solution.scene.name,
        integrator=str(solution.settings["integrator"]),
        dt=float(solution.settings["dt"]),
        status=str(solution.status),
        t=np.asarray(solution.t, float)[:last],
        positions=positions,
        velocities=velocities,
        tension=np.asarray(solution.tension, float)[:last],
        t_tension=np.asarray(solution.t_tension, float)[:last],
        kinetic=kinetic,
        potential=potential,
        work=work[:last],
        work_names=tuple(solution.work_names),
        surface=None if getattr(solution.scene, "sea", None) is None else partial(elevations, solution.scene),
    )


def elevations(scene: Any, places: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Elevation (q, n) [m] of a scene's sea at places (n, 3) and times (q,)."""
    sea = build_model(scene, "float64").sea
    return np.asarray(jax.jit(jax.vmap(sea.elevation, (None, 0)))(jnp.asarray(places), jnp.asarray(times)))
