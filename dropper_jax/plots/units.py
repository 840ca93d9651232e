"""Units of a figure: newtons or kilonewtons, one for all its panels."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

#: Maximum tension [N] above which a figure is in kN.
KILO = 5e3


def force_unit(*values: np.ndarray | float | Iterable[float]) -> tuple[str, float]:
    """Unit and its size [N] for all forces [N] of a figure."""
    largest = max((float(np.abs(known).max()) for v in values if (known := _finite(v)).size), default=0.0)
    return ("kN", 1e3) if largest >= KILO else ("N", 1.0)


def _finite(values: np.ndarray | float | Iterable[float]) -> np.ndarray:
    found = np.asarray(values, float)
    return found[np.isfinite(found)]
