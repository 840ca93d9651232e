"""Rows of the list of hard cases."""

from collections.abc import Callable
from typing import Any

import numpy as np

#: Significant digits of what a run is compared with: rounding is far below the limits, of 1e-4 and more.
DIGITS = 9


def row(
    name: str,
    claim: str,
    limit: float,
    unit: str,
    measure: str,
    scene: Any,
    dt: float,
    duration: float,
    short: float | None = None,
    **more: Any,
) -> dict[str, Any]:
    """A row; `scene` is one, or the name of a packaged one, and `short` [s] the shortened run, otherwise as long.

    Further values are fields of `dropper_jax.stability.case.Case`.
    """
    head = {"name": name, "claim": claim, "limit": limit, "unit": unit, "measure": measure, "scene": scene}
    return {**head, "dt": dt, "duration": duration, "short": duration if short is None else short, **more}


def path(name: str, claim: str, limit: float, unit: str, measure: str, scene: Any, *run: float, **more: Any):
    """A row about the path of a point, the weight unless given."""
    return row(name, claim, limit, unit, measure, scene, *run, **{"point": "weight", **more})


def steps(dt: float, duration: float) -> np.ndarray:
    """Times of a run [s]."""
    return dt * np.arange(round(duration / dt) + 1)


def exact(
    times: np.ndarray, values: Callable[[np.ndarray], np.ndarray] | np.ndarray, digits: int = DIGITS
) -> dict[str, Any]:
    """What a run is compared with, at these times [s]; those of equal steps from 0 on are their step alone."""
    found = values(times) if callable(values) else values
    rounded = np.vectorize(lambda x: float(f"{x:.{digits}g}"), otypes=[float])(np.asarray(found, float)).tolist()
    if len(times) > 1 and np.allclose(times, times[1] * np.arange(len(times)), rtol=1e-12):
        return {"every": float(times[1]), "values": rounded}
    return {"times": times.tolist(), "values": rounded}
