"""What a user must know before trusting a fit."""

from __future__ import annotations

import numpy as np

from fitting.calibration.prepared import Prepared
from fitting.estimate.loss import StudentT
from fitting.estimate.problem import CHI2_RANGE, CORRELATION_FLOOR, Solution
from fitting.estimate.refinement import LARGEST_BIAS
from fitting.estimate.sandwich import FEW
from fitting.estimate.uncertainty import Uncertainty

#: Correlation of two estimates from which on they are called hard to tell apart.
HARD = 0.98

#: Deviations beyond which a sample stands out (one in 2 million of normal noise), and how many are named.
STANDS_OUT, NAMED_SAMPLES = 5.0, 5

#: What is said of noise that is not white.
NAMED = {
    "correlated": "the noise is correlated: samples keep a part of the one before, which weights and errors count",
    "jitter": "frames are late or early by chance, all links of a frame alike, which weights and errors count",
}


def warnings_of(prepared: Prepared, solution: Solution, u: Uncertainty, chi2: float) -> list[str]:
    """One line each: bounds, parameters that cannot be told apart, residuals that are not noise, failed steps."""
    names = [p.name for p in prepared.parameters]
    found = [
        f"{name} sits on its bound {value:g}"
        for name, value, on in zip(names, solution.values, u.at_bound, strict=True)
        if on
    ]
    for direction in u.undetermined:
        text = ", ".join(f"{share:+.2g} {name}" for name, share in direction.items())
        found.append(f"not told apart by the data: changes along ({text}) in parts of their size")
    correlation = np.abs(np.triu(u.correlation, 1))
    for i, j in zip(*np.nonzero(correlation > HARD), strict=True):
        found.append(f"{names[i]} and {names[j]} are hard to tell apart (correlation {u.correlation[i, j]:.3f})")
    for name, value, error, on in zip(names, solution.values, u.std_error, u.at_bound, strict=True):
        if not on and error > abs(value) and name.startswith("effects."):
            found.append(f"{name} is not determined: {value:.3g} with standard error {error:.2g}")
    found += [
        f"left out: {prepared.traces[run].name} {low:.3f} to {high:.3f} s, no start of this window explains its samples"
        for run, low, high in prepared.left_out
    ]
    found += [
        f"the motion of {prepared.traces[run].name} jumps at {time:.3f} s, as by a kick, a touch or lost frames; "
        "windows are not joined there"
        for run, time in prepared.breaks
    ]
    if u.inflation > 1 or abs(u.correlation_1) > 4 * CORRELATION_FLOOR:
        found.append(
            f"residuals are not noise: neighbours correlate by {u.correlation_1:.2f}; standard errors were widened "
            f"by up to {u.inflation:.2g}"
        )
    if 0 < u.blocks < FEW:
        found.append(
            f"standard errors come from the scatter of {u.blocks} blocks of time, fewer than {FEW}: longer traces "
            "tell them better"
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
                found.append(f"the time step moves {name} by {bias:+.2g} standard errors; a smaller dt mends it")
    failed = int(solution.evaluation.failed.sum())
    if failed:
        found.append(f"{failed} steps of the final simulation are above the solver's tolerance or have no derivative")
    if solution.status != "ok":
        found.append(f"not converged: {solution.message}; the best point found is reported")
    elif solution.message:
        found.append(f"the cost is rough here: {solution.message}")
    return found


def outliers(prepared: Prepared, solution: Solution) -> list[str]:
    """A line on samples that stand out, with run, link and time, where there are any."""
    windows = solution.windows
    size = np.where(windows.weight > 0, np.abs(solution.evaluation.residual), 0.0)
    # against the residuals' own spread, which outliers do not widen
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
    advice = "" if isinstance(solution.problem.loss, StudentT) else "; --student lets them pull less"
    return [
        f"{len(window)} samples stand out by more than {STANDS_OUT:g} deviations: {', '.join(positions)}{more}{advice}"
    ]
