"""Where a fit of windows starts: angles and rates at the start of every window, by cubics through its samples."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from dropper_jax.backend.programs import cached_jit
from dropper_jax.model import Model
from fitting.estimate.windows import Starts, Windows
from fitting.traces import planar
from fitting.traces.noise import DEGREE, without_spikes
from fitting.traces.trace import Trace

#: Maximum reach of a start's polynomial, as a fraction of the shortest link's period.
LONGEST_REACH_PERIODS = 0.3
#: Multiple of the starts closed in one call, so that one program serves most traces.
STARTS_AT_ONCE = 128


def first_starts(model: Model, traces: Sequence[Trace], windows: Windows, sigma: Sequence[np.ndarray]) -> Starts:
    """Starts from the traces: value and slope of local polynomials, with the width that the noise `sigma` allows."""
    traces = [without_spikes(trace) for trace in traces]
    longest = LONGEST_REACH_PERIODS * planar.pendulum_period(model.line.length)
    sigma = [size[: len(trace.theta.T)] for size, trace in zip(sigma, traces, strict=True)]
    at = zip(windows.run, windows.begin, strict=True)
    value = np.array([local_motion(traces[i].t, traces[i].theta, t0, sigma[i], longest) for i, t0 in at])
    padded = np.pad(value, [(0, -len(value) % STARTS_AT_ONCE), (0, 0), (0, 0)], mode="edge")
    found = _close(model, padded[..., 0], padded[..., 1])
    return Starts(*(np.asarray(a)[: len(value)] for a in found))


@cached_jit()
def _close(model: Model, theta: ArrayLike, omega: ArrayLike) -> tuple[Array, Array]:
    """`close_chain` of many angles and rates (k, n)."""
    return jax.vmap(partial(planar.close_chain, model))(jnp.asarray(theta), jnp.asarray(omega))


#: Standard deviations of chi-square by which a polynomial may miss its samples, so that they still count as noise.
NOISE_DEVIATIONS = 2.0
#: Ratio of one reach that is tried to the next.
REACH_RATIO = 1.3


def local_motion(t: np.ndarray, theta: np.ndarray, at: float, sigma: np.ndarray, longest: float) -> np.ndarray:
    """Angle and rate (n, 2) of every link at `at` [s], from the least-squares cubics through the samples around it.

    Each cubic has the largest reach of at least five samples, at most `longest` [s], at which it misses the samples by
    no more than the noise `sigma` (n,). On uniform samples this is the smoother of Savitzky and Golay (1964). Missing
    samples (NaN) are skipped.
    """
    found = np.full((theta.shape[1], 2), np.nan)
    known = np.isfinite(theta)
    for seen in np.unique(known, axis=1).T:
        # links that were seen in the same frames
        columns = np.flatnonzero((known == seen[:, None]).all(axis=0))
        frames = np.flatnonzero(seen)
        x = t[frames] - at
        distance = np.sort(np.abs(x))
        shortest = distance[min(DEGREE + 1, len(x) - 1)] * (1 + 1e-9)
        reach = max(longest, shortest)
        while len(columns):  # those links whose cubic may still need a smaller reach
            near = np.abs(x) <= reach
            degree = min(DEGREE, near.sum() - 1)
            basis = np.vander(x[near] / reach, degree + 1, increasing=True)
            y = theta[np.ix_(frames[near], columns)]
            c = np.linalg.lstsq(basis, y, rcond=None)[0]
            left = np.sum((basis @ c - y) ** 2, axis=0) / sigma[columns] ** 2
            freedom = near.sum() - degree - 1
            highest = freedom + NOISE_DEVIATIONS * np.sqrt(2 * freedom)
            fits = (left <= highest) | (reach <= shortest)
            found[columns[fits], 0] = c[0, fits]
            found[columns[fits], 1] = 0.0
            if degree:
                found[columns[fits], 1] = c[1, fits] / reach
            columns = columns[~fits]
            reach = max(reach / REACH_RATIO, shortest)
    return found
