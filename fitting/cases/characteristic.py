"""Characteristic load of a load case from the maxima of its seeds, with its sampling error."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.extremes import storm_extreme
from fitting.site.sections import RunValues

#: Minimum number of seeds for a final check.
ENOUGH = 10


def characteristic(maxima: np.ndarray, run: RunValues) -> dict[str, Any]:
    """Mean of the seeds' maxima (seeds,), or the most probable maximum of a storm.

    The standard error of the mean is `s/sqrt(n)`. The interval of either is that of a Gumbel distribution (see
    `report.extremes.storm_extreme`). The standard error of the most probable value is half of a 68 % interval.

    Returns:
        {value, error, interval, seeds, kind}: error: None with one seed; interval: None with fewer than three seeds
        or without a distribution; `kind` is the computed quantity.
    """
    maxima = np.asarray(maxima, float)
    n, counted = len(maxima), run.duration - run.skip
    error = float(maxima.std(ddof=1) / np.sqrt(n)) if n > 1 else None
    found = {"value": float(maxima.mean()), "error": error, "interval": None, "seeds": n, "kind": "mean"}
    whole = storm_extreme(maxima, counted, counted, run.confidence)
    if "skipped" in whole:
        return found
    if run.characteristic == "mean":
        return {**found, "interval": whole["mean_interval"]}
    storm = storm_extreme(maxima, counted, run.storm, run.confidence)
    low, high = storm_extreme(maxima, counted, run.storm, 0.6827)["most_probable_interval"]
    return {
        "value": storm["most_probable"],
        "error": 0.5 * (high - low),
        "interval": storm["most_probable_interval"],
        "seeds": n,
        "kind": "most_probable",
    }
