"""Characteristic load of a load case from the largest values of its seeds, with what chance leaves open."""

from __future__ import annotations

from typing import Any

import numpy as np

from dropper_jax.report.extremes import storm_extreme
from fitting.site.sections import RunValues

#: Fewer seeds are no final check.
ENOUGH = 10


def characteristic(maxima: np.ndarray, run: RunValues) -> dict[str, Any]:
    """Mean of the seeds' maxima (seeds,), or the most probable largest value of a storm.

    The mean's standard error is `s/sqrt(n)`; the interval of either is that of a Gumbel distribution (see
    `report.extremes.storm_extreme`), and the standard error of the most probable value half of an interval of 68 %.

    Returns:
        {value, error, interval, seeds, kind}: error None with one seed, interval None with fewer than three seeds or
        where there is no distribution; `kind` is what was computed.
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
