"""From a solution to a result: errors, held-out scores, warnings."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from fitting.calibration.fit_warnings import warnings_of
from fitting.calibration.heldout import score_held_out
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult
from fitting.estimate import lyapunov as chaos
from fitting.estimate.problem import Solution
from fitting.estimate.uncertainty import degrees_of_freedom, uncertainty


def summarise(prepared: Prepared, method: str, solution: Solution) -> FitResult:
    """The result of a solution: errors, held-out scores, warnings."""
    simulator, windows = prepared.simulator, solution.windows
    rate = chaos.lyapunov(simulator, windows, solution.evaluation, solution.values)
    # held-out stretches use the same step size as the fit
    prepared = replace(prepared, windows=replace(prepared.windows, substeps=windows.substeps))
    u = uncertainty(solution)
    expected = prepared.windows.weight
    claimed = float(np.sqrt(np.mean(1 / expected[expected > 0] ** 2)))
    chi2 = float(np.sum(solution.weights * (solution.errors * expected) ** 2)) / degrees_of_freedom(solution)
    scored = prepared.noisy(solution.problem.noise)
    held = [score_held_out(scored, solution.values, span) for span in prepared.held_out]
    warnings = list(prepared.warnings) + warnings_of(prepared, solution, u, chi2)
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
        left_out=prepared.left_out,
        held_out=held,
        warnings=warnings,
    )
