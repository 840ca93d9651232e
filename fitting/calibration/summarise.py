"""From a solution to a result: errors, held-out scores, and warnings that a user must know before trusting it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from fitting.calibration.disagreement import disagreement_warnings, disagreements
from fitting.calibration.held_out import score_held_out
from fitting.calibration.result import FitResult, chi2_per_dof, direction_text
from fitting.estimate.error_growth import lyapunov, transitions
from fitting.estimate.scene_fit import common_warnings
from fitting.estimate.solution import Solution
from fitting.estimate.uncertainty import Uncertainty, uncertainty
from fitting.estimate.window_problem import CORRELATION_FLOOR, UNEXPLAINED_CHI_SQUARE
from fitting.laws.law_score_tests import score_tests
from fitting.laws.law_tests import law_warnings
from fitting.windows.outliers import outlier_warnings
from fitting.windows.prepared import Prepared

#: Warnings for noise that is not white.
NOISE_WARNINGS = {
    "correlated": "the noise is correlated: a sample keeps part of the previous one; weights and errors allow for it",
    "jitter": "frame times have random errors, the same for all links; weights and errors allow for it",
}


#: chi-square per degree of freedom below which stated standard errors are too large.
OVERSTATED_CHI_SQUARE = 0.5
#: Absolute correlation of two estimates above which they are reported as hard to distinguish.
INDISTINCT_CORRELATION = 0.98


def warnings_of(prepared: Prepared, solution: Solution, u: Uncertainty, chi2: float) -> list[str]:
    """One line each: active bounds, parameters that are not identifiable, correlated residuals, failed steps."""
    values = solution.by_name
    names = list(values)
    found = common_warnings(solution, u)
    for direction in u.undetermined:
        found.append(f"not identifiable from the data: direction ({direction_text(direction)}) in relative changes")
    close = np.argwhere(np.abs(np.triu(u.correlation, 1)) > INDISTINCT_CORRELATION)
    for i, j in close:
        found.append(f"{names[i]} and {names[j]} are hard to distinguish (correlation {u.correlation[i, j]:.3f})")
    for name, error, at_bound in zip(names, u.std_error, u.at_bound, strict=True):
        if not at_bound and error > abs(values[name]) and name.startswith("effects."):
            found.append(f"{name} is not determined: {values[name]:.3g} with standard error {error:.2g}")
    for run, low, high in prepared.left_out:
        found.append(
            f"left out: {prepared.traces[run].name} {low:.3f} to {high:.3f} s, no start of this window explains "
            "its samples"
        )
    for run, at in prepared.breaks:
        found.append(
            f"the motion of {prepared.traces[run].name} jumps at {at:.3f} s, as after a kick, a contact or lost frames"
            "; windows are not joined there"
        )
    found += _noise_warnings(prepared, solution, u, chi2)
    found += outlier_warnings(prepared, solution)
    failed = solution.evaluation.failed.sum()
    if failed:
        found.append(f"{failed} steps of the final simulation are above the solver's tolerance or have no derivative")
    if solution.status != "ok":
        found.append(f"not converged: {solution.message}; the best point found is reported")
    elif solution.message:
        found.append(f"the cost is non-smooth here: {solution.message}")
    return found


def _noise_warnings(prepared: Prepared, solution: Solution, u: Uncertainty, chi2: float) -> list[str]:
    """Lines on residuals that are not the claimed white noise."""
    found = []
    correlation = u.correlation_1[0]
    if u.inflation > 1 or abs(correlation) > 4 * CORRELATION_FLOOR:
        reason = f"neighbours correlate by {correlation:.2f}"
        if abs(correlation) < CORRELATION_FLOOR:
            reason = "they exceed that of the samples"
        found.append(f"residuals are not noise: {reason}; standard errors were multiplied by up to {u.inflation:.2g}")
    noise = solution.problem.noise
    if noise is not None and noise.kind != "white":
        found.append(NOISE_WARNINGS[noise.kind])
    elif chi2 > UNEXPLAINED_CHI_SQUARE:
        found.append(
            f"chi-square per degree of freedom is {chi2:.3g}: the noise of the samples does not explain the residuals"
        )
    elif chi2 < OVERSTATED_CHI_SQUARE and any(trace.se is not None for trace in prepared.traces):
        found.append(f"chi-square per degree of freedom is {chi2:.3g}: the stated standard errors are too large")
    return found


def summarise(prepared: Prepared, method: str, solution: Solution) -> FitResult:
    """The result of a solution: errors, held-out scores, warnings."""
    simulator = prepared.simulator
    windows = solution.windows
    rate = lyapunov(windows, transitions(simulator, solution.evaluation, solution.values))
    u = uncertainty(solution)
    expected = prepared.windows.weight
    claimed = float(np.sqrt(np.mean(1 / expected[expected > 0] ** 2)))
    chi2 = chi2_per_dof(prepared, solution)
    # held-out stretches use the same step size as the fit
    finer = replace(prepared, windows=replace(prepared.windows, substeps=windows.substeps))
    scored = finer.with_noise(solution.problem.noise)
    laws = score_tests(prepared, solution, u)
    rows = disagreements(prepared, solution)
    compiled = simulator.compile_s - prepared.compiled_before
    return FitResult(
        scene=prepared.scene,
        method=method,
        uncertainty=u,
        noise=claimed,
        chi2_per_dof=chi2,
        seconds={"compile": compiled, "run": time.perf_counter() - prepared.started - compiled},
        solution=solution,
        traces=prepared.traces,
        lyapunov=rate,
        laws=laws,
        recordings=rows,
        prepared=prepared,
        left_out=prepared.left_out,
        held_out=[score_held_out(scored, solution.values, span) for span in prepared.held_out],
        warnings=[
            *prepared.warnings,
            *warnings_of(prepared, solution, u, chi2),
            *law_warnings(laws),
            *disagreement_warnings(rows),
        ],
    )
