"""From a solution to a result: errors, held-out scores, warnings."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from fitting.calibration.caveats import warnings_of
from fitting.calibration.heldout import score_held_out
from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult
from fitting.estimate import lyapunov as chaos
from fitting.estimate.gauss_newton import Solution
from fitting.estimate.uncertainty import uncertainty
from fitting.estimate.windows import Windows


def summarise(prepared: Prepared, method: str, solution: Solution, windows: Windows) -> FitResult:
    """The result of a solution: errors, held-out scores, warnings."""
    simulator = prepared.simulator
    rate = chaos.lyapunov(simulator, windows, solution.evaluation, solution.values)
    # held-out stretches are simulated as finely as the fit was
    prepared = replace(prepared, lyapunov=rate, windows=replace(prepared.windows, substeps=windows.substeps))
    u = uncertainty(solution, windows, prepared.parameters, simulator.freedoms)
    known = windows.weight > 0
    raw = np.where(known, solution.evaluation.residual / np.where(known, windows.weight, 1.0), 0.0)
    claimed = float(np.sqrt(np.mean(1 / prepared.windows.weight[known] ** 2)))
    used = float(np.sqrt(np.mean(1 / windows.weight[known] ** 2)))
    chi2 = u.noise**2 * (used / claimed) ** 2
    held = [score_held_out(prepared, solution.values, span) for span in prepared.held_out]
    rms = float(np.sqrt(np.sum(raw**2) / known.sum()))
    warnings = list(prepared.warnings) + warnings_of(prepared, solution, u, chi2)
    compiled = simulator.compile_s - prepared.compiled_before
    total = time.perf_counter() - prepared.begun
    return FitResult(
        scene=prepared.scene,
        method=method,
        parameters=prepared.parameters,
        values=solution.values,
        uncertainty=u,
        status=solution.status,
        message=solution.message,
        rms=rms,
        noise=claimed,
        chi2_per_dof=chi2,
        iterations=solution.iterations,
        seconds={"compile": compiled, "run": total - compiled},
        solution=solution,
        windows=windows,
        traces=prepared.traces,
        simulator=simulator,
        lyapunov=rate,
        held_out=held,
        warnings=warnings,
    )
