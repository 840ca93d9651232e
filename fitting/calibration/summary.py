"""From a solution to a result: errors, held-out scores, and warnings that a user must know before trusting it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from fitting.calibration.prepared import Prepared
from fitting.calibration.result import FitResult, score_held_out
from fitting.estimate import lyapunov as chaos
from fitting.estimate.problem import CHI2_RANGE, CORRELATION_FLOOR, Solution
from fitting.estimate.sandwich import FEW
from fitting.estimate.uncertainty import LARGEST_BIAS, Uncertainty, degrees_of_freedom, uncertainty

#: Standard deviations beyond which a sample is an outlier (one in 2 million of normal noise), and how many are listed.
STANDS_OUT, NAMED_SAMPLES = 5.0, 5

#: Warnings for noise that is not white.
NAMED = {
    "correlated": "the noise is correlated: a sample keeps part of the previous one; weights and errors allow for it",
    "jitter": "frame times have random errors, the same for all links; weights and errors allow for it",
}


def warnings_of(prepared: Prepared, solution: Solution, u: Uncertainty, chi2: float) -> list[str]:
    """One line each: active bounds, parameters that are not identifiable, correlated residuals, failed steps."""
    names = [p.name for p in prepared.parameters]
    found = [
        f"{name} is at its bound {value:g}"
        for name, value, on in zip(names, solution.values, u.at_bound, strict=True)
        if on
    ]
    for direction in u.undetermined:
        text = ", ".join(f"{share:+.2g} {name}" for name, share in direction.items())
        found.append(f"not identifiable from the data: direction ({text}) in relative changes")
    correlation = np.abs(np.triu(u.correlation, 1))
    # absolute correlation of two estimates above which they are reported as hard to distinguish
    for i, j in zip(*np.nonzero(correlation > 0.98), strict=True):
        found.append(f"{names[i]} and {names[j]} are hard to distinguish (correlation {u.correlation[i, j]:.3f})")
    for name, value, error, on in zip(names, solution.values, u.std_error, u.at_bound, strict=True):
        if not on and error > abs(value) and name.startswith("effects."):
            found.append(f"{name} is not determined: {value:.3g} with standard error {error:.2g}")
    found += [
        f"left out: {prepared.traces[run].name} {low:.3f} to {high:.3f} s, no start of this window explains its samples"
        for run, low, high in prepared.left_out
    ]
    found += [
        f"the motion of {prepared.traces[run].name} jumps at {time:.3f} s, as after a kick, a contact or lost frames; "
        "windows are not joined there"
        for run, time in prepared.breaks
    ]
    if u.inflation > 1 or abs(u.correlation_1) > 4 * CORRELATION_FLOOR:
        found.append(
            f"residuals are not noise: neighbours correlate by {u.correlation_1:.2f}; standard errors were multiplied "
            f"by up to {u.inflation:.2g}"
        )
    if 0 < u.blocks < FEW:
        found.append(
            f"standard errors come from the scatter of {u.blocks} blocks of time, fewer than {FEW}. Use longer "
            "traces for more reliable errors"
        )
    noise = solution.problem.noise
    if noise is not None and noise.kind != "white":
        found.append(NAMED[noise.kind])
    elif chi2 > CHI2_RANGE[1]:
        found.append(
            f"chi-square per degree of freedom is {chi2:.3g}: the noise of the samples does not explain the residuals"
        )
    elif chi2 < CHI2_RANGE[0] and any(trace.se is not None for trace in prepared.traces):
        found.append(f"chi-square per degree of freedom is {chi2:.3g}: the stated standard errors are too large")
    found += outliers(prepared, solution)
    if solution.step_bias is not None:
        for name, bias in zip(names, solution.step_bias, strict=True):
            if abs(bias) > LARGEST_BIAS:
                found.append(f"the time step shifts {name} by {bias:+.2g} standard errors. Use a smaller dt")
    failed = int(solution.evaluation.failed.sum())
    if failed:
        found.append(f"{failed} steps of the final simulation are above the solver's tolerance or have no derivative")
    if solution.status != "ok":
        found.append(f"not converged: {solution.message}; the best point found is reported")
    elif solution.message:
        found.append(f"the cost is non-smooth here: {solution.message}")
    return found


def outliers(prepared: Prepared, solution: Solution) -> list[str]:
    """A line on outlying samples, with run, link and time, if there are any."""
    windows = solution.windows
    size = np.where(windows.weight > 0, np.abs(solution.evaluation.residual), 0.0)
    # relative to the residuals' own spread, which outliers do not widen
    scale = np.array(
        [max(np.median(size[..., j][windows.weight[..., j] > 0]) / 0.6745, 1e-300) for j in range(size.shape[2])]
    )
    window, slot, link = np.nonzero(size > STANDS_OUT * scale)
    if not len(window):
        return []
    largest = np.argsort(-(size / scale)[window, slot, link])[:NAMED_SAMPLES]
    times = windows.times()
    positions = [
        f"{prepared.traces[windows.run[window[i]]].name} link {link[i]} at {times[window[i], slot[i]]:.3f} s"
        for i in largest
    ]
    more = f" and {len(window) - len(positions)} more" if len(window) > len(positions) else ""
    advice = "" if solution.problem.loss.redescends else ". Use --student to reduce their weight"
    return [
        f"{len(window)} samples stand out by more than {STANDS_OUT:g} standard deviations: "
        f"{', '.join(positions)}{more}{advice}"
    ]


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
