"""The characteristic value of seeds' maxima as a weighted sum of them, so that it has a derivative.

    sum_i w_i x_(i),    x_(1) <= ... <= x_(n)

The mean has w = 1/n. The most probable maximum of a storm of duration D is the mode of a Gumbel distribution by
probability-weighted moments (see `evaluation.extremes`), shifted by scale log(D/T), with T the counted time
of a run: mode = b0 - gamma s, s = (2 b1 - b0)/ln 2, b1 = sum (i - 1)/(n - 1) x_(i)/n, all linear in the ordered
maxima:

    w_i = 1/n + (log(D/T) - gamma) (2 (i - 1)/(n - 1) - 1)/(n ln 2)
"""

from __future__ import annotations

import numpy as np

from dropper_jax.base.errors import SceneError
from dropper_jax.evaluation.extremes import EULER_CONSTANT, MIN_RUNS
from fitting.farm.site.sections import RunValues


def maxima_weights(maxima: np.ndarray, run: RunValues) -> np.ndarray:
    """Weights (n, q) of maxima (n, q), in the order of the seeds; for a signal without spread, those of the mean.

    A load that is absent for some seeds has no single distribution of maxima, and also uses the mean, as in
    `evaluation.extremes.storm_extreme`.
    """
    maxima = np.asarray(maxima, float)
    n = len(maxima)
    mean = np.full_like(maxima, 1.0 / n)
    if run.characteristic == "mean":
        return mean
    slope = (2.0 * np.arange(n) / (n - 1) - 1.0) / (n * np.log(2.0))
    ordered = 1.0 / n + (np.log(run.storm / (run.duration - run.skip)) - EULER_CONSTANT) * slope
    rank = np.argsort(np.argsort(maxima, axis=0, kind="stable"), axis=0)
    largest = np.abs(maxima).max(axis=0)
    spread = np.abs(slope @ np.sort(maxima, axis=0)) > 1e-9 * largest
    known = np.min(np.abs(maxima), axis=0) > 1e-9 * largest
    return np.where(spread & known, ordered[rank], mean)


def check_seeds(run: RunValues) -> None:
    """Reject a most probable value with too few seeds.

    Raises:
        SceneError: with the given and the required number.
    """
    if run.characteristic == "most_probable" and run.seeds < MIN_RUNS:
        raise SceneError(
            f"run.seeds: {run.seeds} for the most probable largest value of a storm. Use {MIN_RUNS} or more, or "
            'run.characteristic = "mean"'
        )
