"""Bayesian information criterion of damping laws.

BIC = `N_eff log(chi2/N) + k log N_eff` (Schwarz 1978), with `N_eff = N (1 - rho)/(1 + rho)` for correlated samples; rho
is that of the law that fits best, because its residuals are nearest to the noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fitting.estimate.neighbour_correlation import lag_one
from fitting.estimate.windows import Windows
from fitting.laws.laws import Law

#: Maximum correlation of neighbours that is used [-]: above it a trace would count as almost no sample at all.
MAX_CORRELATION = 0.999


def with_bic(rows: list[Law], residuals: list[np.ndarray], windows: Windows) -> list[Law]:
    """The laws with their BIC, all by the effective number of samples of the law with the smallest chi-square."""
    chi2 = np.array([np.sum(r**2) for r in residuals])
    samples = windows.samples
    rho = lag_one(residuals[np.argmin(chi2)], windows.known)[0]
    rho = np.clip(rho, 0.0, MAX_CORRELATION)
    effective = samples * (1 - rho) / (1 + rho)
    scores = effective * np.log(chi2 / samples) + np.array([row.free for row in rows]) * np.log(effective)
    return [replace(row, bic=score) for row, score in zip(rows, scores, strict=True)]
