"""Characteristic load of a load case from the maxima of its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dropper_jax.evaluation.extremes import storm_extreme
from fitting.farm.site.sections import RunValues


@dataclass(frozen=True)
class CharacteristicLoad:
    """Characteristic load of a case.

    Attributes:
        error: standard error; None with one seed.
        interval: None with fewer than three seeds or without a distribution.
        kind: the computed quantity, `mean` or `most_probable`.
    """

    value: float
    error: float | None
    interval: tuple[float, float] | None
    seeds: int
    kind: str

    def error_of(self, scale: float) -> float | None:
        """The standard error of the load times a scale."""
        if self.error is None:
            return None
        return scale * self.error


def characteristic_load(maxima: Sequence[float] | np.ndarray, run: RunValues) -> CharacteristicLoad:
    """Mean of the seeds' maxima (seeds,), or the most probable maximum of a storm.

    The standard error of the mean is `s/sqrt(n)`. The interval of either is that of a Gumbel distribution (see
    `evaluation.extremes.storm_extreme`). The standard error of the most probable value is half of a 68 % interval.
    """
    maxima = np.asarray(maxima, float)
    n = len(maxima)
    counted = run.duration - run.skip
    error = maxima.std(ddof=1) / np.sqrt(n) if n > 1 else None
    mean = CharacteristicLoad(maxima.mean(), error, None, n, "mean")
    whole = storm_extreme(maxima, counted, counted, run.confidence)
    if "skipped" in whole:
        return mean
    if run.characteristic == "mean":
        return replace(mean, interval=whole["mean_interval"])
    storm = storm_extreme(maxima, counted, run.storm, run.confidence)
    low, high = storm_extreme(maxima, counted, run.storm, 0.6827)["most_probable_interval"]
    error = 0.5 * (high - low)
    return CharacteristicLoad(storm["most_probable"], error, storm["most_probable_interval"], n, "most_probable")
